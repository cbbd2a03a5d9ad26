//! Writes the objects of a 3MF again after an edit; everything else of the model part stays as written.

use super::build::push_neutral;
use super::identities::{Identities, attributes_of_build};
use super::looks::{RunOrigins, UseProperties};
use super::model_text::{MeshText, PartText, WrittenProperty, name_attribute};
use super::package::{FORMAT, Package};
use super::part::PropertyGroup;
use super::scene::{MeshUse, PrintNotes, stale_parts, unwritable, uses_of_objects};
use crate::codec::EditedOutput;
use crate::edited::{EditedModel, PrimitiveRun, VertexBlend, with_whole_model};
use crate::files::{ReadWatch, counted};
use crate::neutral::{CAP_COLOUR, NeutralModel};
use crate::{Error, Limits, Model, WrittenFiles, WrittenWarning};
use glam::DVec3;
use pliant_exec::progress::Silent;
use pliant_mesh::NONE;
use std::collections::{BTreeMap, BTreeSet};

/// A model whose uses of one mesh have moved apart, as an edited one that keeps all of its triangles.
pub(super) fn write_whole(model: &Model, positions: &[DVec3]) -> Result<WrittenFiles, Error> {
    with_whole_model(model, |edited| Rewrite::new(edited, positions)?.finish(|_| Ok(None)))
}

/// An edited model.
pub(super) fn write_edited(output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
    let EditedOutput { edited, positions, .. } = *output;
    Rewrite::new(edited, positions)?.finish(|base| (output.neutral_base)(base).map(Some))
}

/// Writes the objects of the first base's model part again.
struct Rewrite<'a> {
    edited: &'a EditedModel<'a>,
    positions: &'a [DVec3],
    model: &'a Model,
    notes: &'a PrintNotes,
    text: PartText,
    /// Groups of other parts, by their new numbers.
    moved_groups: BTreeMap<(usize, u32), u32>,
    caps: Option<u32>,
    /// Objects that have been written under their own numbers or with their own attributes.
    written: BTreeSet<(usize, u32)>,
}

impl<'a> Rewrite<'a> {
    fn new(edited: &'a EditedModel<'a>, positions: &'a [DVec3]) -> Result<Self, Error> {
        let model = edited.bases.first().map(|base| base.model);
        let model = model.ok_or_else(|| unwritable("there is no base"))?;
        let notes: &PrintNotes = model.notes_or_refuse(FORMAT)?;
        let root = notes.scene.parts.first();
        let largest = root.map_or(0, |root| root.largest_id);
        let mut text = PartText::new(largest.saturating_add(1));
        if let Some(root) = root {
            let (limits, mut package) = (Limits::UNLIMITED, Package::open(&model.files.main)?);
            if let Some(bytes) = package.part(&root.name, &ReadWatch::new(&limits, &Silent, 0))? {
                text.identities = Identities::of_part(&bytes, &bytes[..root.head]);
            }
        }
        Ok(Self {
            edited,
            positions,
            model,
            notes,
            text,
            moved_groups: BTreeMap::new(),
            caps: None,
            written: BTreeSet::new(),
        })
    }

    fn finish(
        mut self,
        neutral_base: impl Fn(u32) -> Result<Option<NeutralModel>, Error>,
    ) -> Result<WrittenFiles, Error> {
        let by_item: BTreeMap<(Option<usize>, usize), Vec<usize>> =
            self.notes
                .uses
                .iter()
                .enumerate()
                .fold(BTreeMap::new(), |mut all, (i, one)| {
                    // What no item builds stands alone.
                    let alone = if one.item.is_none() { i } else { 0 };
                    all.entry((one.item, alone)).or_insert_with(Vec::new).push(i);
                    all
                });
        for ((item, _), uses) in by_item {
            self.push_built(item, &uses)?;
        }
        for base in 1..self.edited.bases.len() as u32 {
            if let Some(neutral) = neutral_base(base)? {
                push_neutral(&mut self.text, &neutral, false)?;
            }
        }
        if let Some(id) = self.caps {
            let names = self.edited.cap_materials();
            self.text
                .push_materials(id, names.into_iter().map(|name| (name, CAP_COLOUR)));
        }
        self.pack()
    }

    /// Writes what one item builds: one object, or an object of several.
    fn push_built(&mut self, item: Option<usize>, uses: &[usize]) -> Result<(), Error> {
        let mut objects = Vec::new();
        let is_one = uses.len() == 1;
        for &i in uses {
            let one = &self.notes.uses[i];
            let Some(mesh) = self.mesh_of(i)? else { continue };
            let built = self.notes.scene.item(one).map(|item| item.of.object);
            let keeps_id = is_one && one.part == 0 && built.is_none_or(|id| id == one.object);
            let id = match keeps_id && !self.written.contains(&(0, one.object)) {
                true => one.object,
                false => self.text.take_id()?,
            };
            let attributes = self.attributes_of(one);
            self.text.push_mesh(id, &attributes, &mesh);
            objects.push(id);
        }
        let root = &self.notes.scene.parts[0];
        let item = item.and_then(|item| root.items.get(item));
        let attributes = item.map_or("", |item| &item.attributes);
        match objects[..] {
            [] => {}
            [one] => self.text.push_item(one, attributes),
            _ => {
                let own = item.map(|item| item.of.object);
                let known = own
                    .and_then(|id| root.objects.get(&id))
                    .filter(|object| object.mesh.is_none());
                let is_new = own.is_some_and(|id| self.written.insert((0, id)));
                let id = match own.filter(|_| known.is_some() && is_new) {
                    Some(id) => id,
                    None => self.text.take_id()?,
                };
                let words = known.filter(|_| is_new).map_or("", |object| &object.attributes);
                let words = self.text.identities.with_uuid(words);
                self.text
                    .objects
                    .extend(format!("<object id=\"{id}\"{words}><components>").bytes());
                for object in objects {
                    let words = self.text.identities.with_uuid("");
                    self.text
                        .objects
                        .extend(format!("<component objectid=\"{object}\"{words}/>").bytes());
                }
                self.text.objects.extend_from_slice(b"</components></object>\n");
                self.text.push_item(id, attributes);
            }
        }
        Ok(())
    }

    /// The attributes of the object of a use: as written the first time, its name alone for copies.
    fn attributes_of(&mut self, one: &MeshUse) -> String {
        let own = self.notes.scene.object(one).map(|object| object.attributes.clone());
        match self.written.insert((one.part, one.object)) {
            true => own.unwrap_or_default(),
            false => name_attribute(&one.name),
        }
    }

    /// The mesh of a use with what caps it; `None` where nothing is left of it.
    fn mesh_of(&mut self, primitive: usize) -> Result<Option<MeshText>, Error> {
        let edited = self.edited;
        let of_use = |run: &&PrimitiveRun| run.primitive as usize == primitive;
        let runs: Vec<_> = edited.runs_with_triangles(0).filter(of_use).collect();
        let properties = UseProperties::new(self.notes, self.model, primitive as u32);
        let mut mesh = MeshText::default();
        for run in runs {
            let cap = match edited.cap_number(run) {
                Some(place) => Some((self.cap_group()?, [place as u32; 3])),
                None => None,
            };
            let known = properties.as_ref().filter(|p| cap.is_none() && !p.are_none());
            let known = known.map(|p| (p, RunOrigins::new(edited, run, p)));
            let number_of = |v: usize| {
                let old = match edited.blend(v) {
                    VertexBlend::Vertex(old) => old,
                    VertexBlend::Blend(_) => NONE,
                };
                mesh.vertex(self.positions[v], old)
            };
            let numbers: Vec<u32> = run.vertices().map(number_of).collect();
            for (i, triangle) in run.triangles().enumerate() {
                let property = match &known {
                    Some((properties, origins)) => self.property_of(properties, origins, i)?,
                    None => cap,
                };
                let corners = edited.triangles[triangle].map(|v| numbers[v as usize - run.first_vertex as usize]);
                mesh.triangle(corners, property);
            }
        }
        Ok((!mesh.is_empty()).then_some(mesh))
    }

    /// The property of a triangle of a run: that of the old triangle that it lies on, at corners that are new of the nearest old one.
    fn property_of(
        &mut self,
        properties: &UseProperties<'_>,
        origins: &RunOrigins<'_>,
        triangle: usize,
    ) -> Result<WrittenProperty, Error> {
        let Some((part, group, places)) = origins.of(triangle).and_then(|t| properties.of_triangle(t)) else {
            return Ok(None);
        };
        let nearest = |k: usize| {
            let of = origins.corner(triangle, k).into_iter();
            let (corner, _) = of.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))?;
            let there = properties.of_triangle(corner / 3)?;
            (there.1 == group).then(|| there.2[corner as usize % 3])
        };
        let is_even = places == [places[0]; 3];
        let places = [0, 1, 2].map(|k| match is_even {
            true => places[k],
            false => nearest(k).unwrap_or(places[0]),
        });
        Ok(self.group_of(part, group)?.map(|group| (group, places)))
    }

    fn cap_group(&mut self) -> Result<u32, Error> {
        let id = match self.caps {
            Some(id) => id,
            None => self.text.take_id()?,
        };
        self.caps = Some(id);
        Ok(id)
    }

    /// The number of a group in the part that is written; groups of other parts are copied into it.
    fn group_of(&mut self, part: usize, id: u32) -> Result<Option<u32>, Error> {
        if part == 0 {
            return Ok(Some(id));
        }
        if let Some(known) = self.moved_groups.get(&(part, id)) {
            return Ok(Some(*known));
        }
        let Some(group) = self.notes.scene.group(part, id) else {
            return Ok(None);
        };
        if matches!(group, PropertyGroup::Picture(..)) {
            self.text.lost.insert("pictures of objects in other parts".into());
            return Ok(None);
        }
        let new = self.text.take_id()?;
        match group {
            PropertyGroup::Materials(all) => {
                self.text
                    .push_materials(new, all.iter().map(|(name, colour)| (name.as_str(), *colour)));
            }
            PropertyGroup::Colours(all) => self.text.push_colours(new, all.iter().copied()),
            PropertyGroup::Picture(..) => {}
        }
        self.moved_groups.insert((part, id), new);
        Ok(Some(new))
    }

    /// The package with the new part.
    fn pack(mut self) -> Result<WrittenFiles, Error> {
        let limits = Limits::UNLIMITED;
        let watch = ReadWatch::new(&limits, &Silent, 0);
        let mut package = Package::open(&self.model.files.main)?;
        let parts = &self.notes.scene.parts;
        let mut replaced = BTreeMap::new();
        for (i, part) in parts.iter().enumerate() {
            let Some(bytes) = package.part(&part.name, &watch)? else {
                return Err(unwritable(format!("the part {} is gone", part.name)));
            };
            let mut out = bytes[..part.head].to_vec();
            if i == 0 {
                let keep = |out: &mut Vec<u8>, range: &std::ops::Range<usize>| {
                    out.extend_from_slice(b"\n");
                    out.extend_from_slice(&bytes[range.clone()]);
                };
                part.metadata.iter().for_each(|range| keep(&mut out, range));
                out.extend_from_slice(b"\n<resources>");
                part.resources.iter().for_each(|range| keep(&mut out, range));
                out.push(b'\n');
                out.extend_from_slice(&self.text.groups);
                out.extend_from_slice(&self.text.objects);
                let words = self.text.identities.with_uuid(&attributes_of_build(&bytes));
                out.extend(format!("</resources>\n<build{words}>\n").bytes());
                out.extend_from_slice(&self.text.items);
                out.extend_from_slice(b"</build>");
            } else {
                let words = Identities::of_part(&bytes, &bytes[..part.head]).with_uuid(&attributes_of_build(&bytes));
                out.extend(format!("\n<resources></resources>\n<build{words}></build>").bytes());
            }
            out.extend(format!("\n</{}>\n", model_name(&bytes[..part.head])).bytes());
            replaced.insert(part.name.clone(), out);
        }
        let stale = stale_parts(&package, self.notes);
        let lost = self.lost();
        Ok(WrittenFiles {
            warnings: stale.into_iter().chain(lost).collect(),
            ..WrittenFiles::single(package.rewritten(replaced)?)
        })
    }

    /// Says what of the parts is not written again.
    fn lost(&self) -> Option<WrittenWarning> {
        let scene = &self.notes.scene;
        let counts = uses_of_objects(&self.notes.uses);
        let objects = || {
            scene
                .parts
                .iter()
                .enumerate()
                .flat_map(|(i, p)| p.objects.iter().map(move |(id, o)| ((i, *id), o)))
        };
        let idle = objects()
            .filter(|(key, o)| o.mesh.is_some() && !counts.contains_key(key))
            .count();
        let painted = objects()
            .filter_map(|(_, o)| o.mesh.as_ref())
            .map(|mesh| mesh.painted)
            .sum();
        let shared: usize = counts.values().filter(|n| **n > 1).count();
        let counts = [
            counted(idle, "object that is not built", "objects that are not built"),
            counted(painted, "triangle's paint of a slicer", "triangles' paint of a slicer"),
            counted(
                shared,
                "mesh shared by several places (each has its own now)",
                "meshes shared by several places (each has its own now)",
            ),
        ];
        let foreign = scene
            .parts
            .iter()
            .flat_map(|part| &part.foreign)
            .map(|name| format!("`{name}` of meshes"));
        let all: Vec<String> = counts
            .into_iter()
            .flatten()
            .chain(foreign)
            .chain(self.text.lost.iter().cloned())
            .collect();
        let message = format!("objects are written again, without: {}", all.join(", "));
        (!all.is_empty()).then(|| WrittenWarning::new("extension-dropped", message, ""))
    }
}

/// The name of the element `model` with its prefix.
fn model_name(head: &[u8]) -> String {
    let begin = head.iter().rposition(|b| *b == b'<').map_or(0, |at| at + 1);
    let name = head[begin..]
        .split(|b| b.is_ascii_whitespace() || *b == b'>')
        .next()
        .unwrap_or_default();
    String::from_utf8_lossy(name).into_owned()
}
