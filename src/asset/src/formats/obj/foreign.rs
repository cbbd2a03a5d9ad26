//! What bases of other formats give to an edited OBJ: faces, and materials in a library of their own.

use super::super::text::NumberPrecision;
use super::library::write_library;
use super::statements::{ObjStatements, name_in, printable, push_corner, push_line, push_numbers};
use crate::Error;
use crate::codec::EditedOutput;
use crate::look::{MaterialPicture, NamedMaterial};
use crate::neutral::NeutralModel;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The bases of other formats, and their materials under names that the OBJ does not have.
pub(super) struct ForeignBases {
    /// Each with its number.
    pub bases: Vec<(u32, NeutralModel)>,
    materials: Vec<(String, Arc<NamedMaterial>)>,
    /// The names of files that are there already.
    files: BTreeSet<String>,
}

impl ForeignBases {
    pub fn of_output(output: &EditedOutput<'_>, all: &[Option<ObjStatements<'_>>]) -> Result<Self, Error> {
        let numbers = (0u32..).zip(all).filter(|(_, own)| own.is_none());
        let bases = numbers.map(|(base, _)| Ok((base, (output.neutral_base)(base)?)));
        let bases: Vec<(u32, NeutralModel)> = bases.collect::<Result<_, Error>>()?;
        let states = all.iter().flatten().flat_map(|own| &own.states);
        let mut taken: BTreeSet<String> = states.filter_map(|state| state.material).map(name_in).collect();
        taken.extend(output.edited.cap_materials().into_iter().map(printable));
        let own_files = output.edited.bases.iter().zip(all).filter(|(_, own)| own.is_some());
        let files: BTreeSet<String> = own_files
            .flat_map(|(base, _)| base.model.files.companions.keys().cloned())
            .collect();
        let mut materials: Vec<(String, Arc<NamedMaterial>)> = Vec::new();
        let attributes = bases.iter().flat_map(|(_, neutral)| &neutral.attributes);
        for material in attributes.filter_map(|own| own.material.as_ref()) {
            if materials.iter().any(|(_, known)| known == material) {
                continue;
            }
            let name = free_name(&printable(&material.name), |name| taken.contains(name));
            taken.insert(name.clone());
            materials.push((name, Arc::clone(material)));
        }
        Ok(Self {
            bases,
            materials,
            files,
        })
    }

    /// Names a library of these materials, where more than their names is known; returns it with its pictures, all under names that
    /// no other file has.
    pub fn write_library(&self, out: &mut Vec<u8>) -> BTreeMap<String, Vec<u8>> {
        if self.materials.iter().all(|(_, material)| material.look.is_none()) {
            return BTreeMap::new();
        }
        let free = |picture: &mut MaterialPicture| {
            picture.name = free_name(&picture.name, |name| self.files.contains(name));
        };
        let materials: Vec<(String, Arc<NamedMaterial>)> = (self.materials.iter())
            .map(|(name, material)| {
                let mut material = material.as_ref().clone();
                if let Some(look) = &mut material.look {
                    look.picture.as_mut().map(free);
                    look.normals.as_mut().map(free);
                }
                (name.clone(), Arc::new(material))
            })
            .collect();
        let (library, mut files) = write_library(&materials);
        let name = free_name("merged.mtl", |name| {
            self.files.contains(name) || files.contains_key(name)
        });
        out.extend(format!("mtllib {name}\n").bytes());
        files.insert(name, library);
        files
    }

    /// Writes the faces of a base, whose vertices stand already.
    pub fn write_base(
        &self,
        out: &mut Vec<u8>,
        output: &EditedOutput<'_>,
        base: u32,
        neutral: &NeutralModel,
        written: &mut WrittenLines,
    ) {
        for (run, own) in output.edited.runs_with_triangles(base).zip(neutral.primitives()) {
            let (primitive, has_uv) = (own.primitive, own.attributes.has_uv);
            if has_uv {
                for [u, v] in &neutral.uv[own.vertices.clone()] {
                    out.extend_from_slice(b"vt ");
                    push_numbers(out, &[f64::from(*u), 1.0 - f64::from(*v)]);
                    out.push(b'\n');
                }
            }
            if primitive.has_normals {
                for normal in &neutral.geometry.normals[own.vertices.clone()] {
                    push_line(out, b"vn ", normal.as_dvec3(), NumberPrecision::Single, b"\n");
                }
            }
            let mut name = printable(&primitive.name);
            if name.is_empty() {
                name = format!("merged{base}");
            }
            out.extend(format!("o {name}\n").bytes());
            let material = own.attributes.material.as_ref();
            if let Some((name, _)) = material.and_then(|m| self.materials.iter().find(|(_, known)| known == m)) {
                out.extend(format!("usemtl {name}\n").bytes());
            }
            own.each_face(|corners| {
                out.push(b'f');
                for &corner in corners {
                    let local = u64::from(own.vertex_at(corner) - primitive.first_vertex) + 1;
                    let texture = has_uv.then_some(written.textures + local);
                    let normal = primitive.has_normals.then_some(written.normals + local);
                    push_corner(out, local + u64::from(run.first_vertex), texture, normal);
                }
                out.push(b'\n');
            });
            let count = own.vertices.len() as u64;
            written.textures += if has_uv { count } else { 0 };
            written.normals += if primitive.has_normals { count } else { 0 };
        }
    }
}

/// A name that is not taken: the wanted one, or with a number before its ending.
fn free_name(wanted: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let (stem, ending) = match wanted.rfind('.') {
        Some(at) if at > 0 => wanted.split_at(at),
        _ => (wanted, ""),
    };
    let mut name = wanted.to_owned();
    let mut number = 0;
    while is_taken(&name) {
        number += 1;
        name = format!("{stem}.{number}{ending}");
    }
    name
}

/// How many lines of texture coordinates and normals are written.
#[derive(Default)]
pub(super) struct WrittenLines {
    /// `vt` lines.
    pub textures: u64,
    /// `vn` lines.
    pub normals: u64,
}
