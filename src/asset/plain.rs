//! A model as it goes from one format to another: geometry, one set of texture coordinates, colours, material names.
//!
//! Texture coordinates count from the upper left corner of the picture, as in glTF.

use super::model::Source;
use super::remade::{Base, Carried, Recipes, Remade, Run};
use super::{Error, Format, Geometry, Model, Primitive, gltf, obj, off, ply};
use glam::{DAffine3, DVec3, Vec3};

/// A model free of its format.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Plain {
    pub geometry: Geometry,
    /// For each primitive of the geometry what else it has.
    pub parts: Vec<Part>,
    /// One per vertex, or empty when no part has any.
    pub uv: Vec<[f32; 2]>,
    /// One per vertex, or empty when no part has any.
    pub colours: Vec<[f32; 4]>,
}

/// What a primitive has beyond its geometry.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Part {
    pub has_uv: bool,
    pub has_colours: bool,
    /// The name of its material.
    pub material: Option<String>,
}

/// What one run of an edited model has, as its format's module reads it from the files.
#[derive(Debug, Clone, Default)]
pub(super) struct Extras {
    /// Per vertex of the run; empty when there are none.
    pub uv: Vec<[f32; 2]>,
    /// Per vertex of the run; empty when there are none.
    pub colours: Vec<[f32; 4]>,
    pub material: Option<String>,
}

/// A run whose corners at one vertex may differ, parted so that they do not.
#[derive(Debug, Clone, Default)]
pub(super) struct Seamed {
    /// For each vertex the vertex of the run that it is a copy of.
    pub copy_of: Vec<u32>,
    /// As [`Extras::uv`] and per vertex.
    pub uv: Vec<[f32; 2]>,
    /// Empty, or one per vertex; zero where there is none.
    pub normals: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub material: Option<String>,
}

/// The whole of an edited model.
pub(super) fn of_remade(remade: &Remade<'_>, positions: &[DVec3], format: Format) -> Result<Plain, Error> {
    let mut plain = Plain::default();
    for base in 0..remade.bases.len() {
        plain.add_base(remade, base, positions, format)?;
    }
    Ok(plain)
}

/// What comes from one base of an edited model.
pub(super) fn of_base(remade: &Remade<'_>, base: usize, positions: &[DVec3], format: Format) -> Result<Plain, Error> {
    let mut plain = Plain::default();
    plain.add_base(remade, base, positions, format)?;
    Ok(plain)
}

/// A model that no edit has changed, at new positions.
pub(super) fn of_model(model: &Model, positions: &[DVec3], format: Format) -> Result<Plain, Error> {
    let geometry = &model.geometry;
    let mut first_triangle = 0;
    let one = |(i, primitive): (usize, &Primitive)| {
        let run = Run {
            base: 0,
            primitive: i as u32,
            first_vertex: primitive.first_vertex,
            vertex_count: primitive.vertex_count,
            first_triangle,
            triangle_count: primitive.index_count / 3,
        };
        first_triangle += run.triangle_count;
        run
    };
    let runs: Vec<Run> = geometry.primitives.iter().enumerate().map(one).collect();
    let recipes = Recipes::identity(geometry.positions.len() as u32);
    let bases = [Base {
        model,
        world_from_model: DAffine3::IDENTITY,
    }];
    let remade = Remade {
        bases: &bases,
        runs: &runs,
        recipes: &recipes,
        triangles: &geometry.triangles,
        origins: &[],
        bare: &[],
    };
    of_remade(&remade, positions, format)
}

impl Plain {
    /// A geometry that has nothing else.
    pub fn of(geometry: Geometry) -> Self {
        Self {
            parts: vec![Part::default(); geometry.primitives.len()],
            geometry,
            ..Self::default()
        }
    }

    fn add_base(&mut self, remade: &Remade<'_>, base: usize, positions: &[DVec3], format: Format) -> Result<(), Error> {
        let runs: Vec<&Run> = remade
            .runs
            .iter()
            .filter(|r| r.base as usize == base && r.triangle_count > 0)
            .collect();
        let Some(held) = remade.bases.get(base).filter(|_| !runs.is_empty()) else {
            return Ok(());
        };
        if let (Source::Obj(_), Format::Glb | Format::Gltf) = (&held.model.source, format) {
            for run in runs {
                for seamed in obj::seamed(remade, run, positions)? {
                    self.check_room(seamed.copy_of.len(), format)?;
                    self.add_seamed(remade, run, positions, seamed);
                }
            }
            return Ok(());
        }
        let extras = match &held.model.source {
            Source::Gltf(source) => gltf::extras(&held.model.files, source, remade, &runs)?,
            Source::Obj(_) => obj::extras(remade, &runs)?,
            Source::Ply(_) => ply::extras(remade, &runs)?,
            Source::Off(_) => off::extras(remade, &runs)?,
            Source::Stl(_) => Vec::new(),
        };
        let mut extras = extras.into_iter();
        for run in runs {
            self.check_room(run.vertex_count as usize, format)?;
            self.add(remade, run, positions, extras.next().unwrap_or_default());
        }
        Ok(())
    }

    /// Parting vertices at seams may make more than 32-bit numbers count.
    fn check_room(&self, more: usize, format: Format) -> Result<(), Error> {
        let count = self.geometry.positions.len() as u64 + more as u64;
        if count > u64::from(u32::MAX) {
            return Err(Error::unwritable(format, format!("there would be {count} vertices")));
        }
        Ok(())
    }

    fn begin(&mut self, name: &str, positions: impl Iterator<Item = DVec3>, normals: &[Vec3], triangles: &[[u32; 3]]) {
        let geometry = &mut self.geometry;
        let first = geometry.positions.len();
        geometry.positions.extend(positions);
        if !normals.is_empty() {
            geometry.normals.resize(first, Vec3::ZERO);
            geometry.normals.extend_from_slice(normals);
        } else if !geometry.normals.is_empty() {
            geometry.normals.resize(geometry.positions.len(), Vec3::ZERO);
        }
        geometry
            .triangles
            .extend(triangles.iter().map(|t| t.map(|v| v + first as u32)));
        geometry.primitives.push(Primitive {
            name: name.to_owned(),
            first_vertex: first as u32,
            vertex_count: (geometry.positions.len() - first) as u32,
            index_count: (triangles.len() * 3) as u32,
            has_normals: !normals.is_empty(),
            ..Primitive::default()
        });
    }

    fn finish(&mut self, uv: Vec<[f32; 2]>, colours: Vec<[f32; 4]>, material: Option<String>) {
        let count = self.geometry.positions.len();
        let added = self.geometry.primitives.last().map_or(0, |p| p.vertex_count as usize);
        self.parts.push(Part {
            has_uv: !uv.is_empty(),
            has_colours: !colours.is_empty(),
            material,
        });
        if !uv.is_empty() || !self.uv.is_empty() {
            self.uv.resize(count - added, [0.0; 2]);
            self.uv.extend(uv);
            self.uv.resize(count, [0.0; 2]);
        }
        if !colours.is_empty() || !self.colours.is_empty() {
            self.colours.resize(count - added, [1.0; 4]);
            self.colours.extend(colours);
            self.colours.resize(count, [1.0; 4]);
        }
    }

    fn add(&mut self, remade: &Remade<'_>, run: &Run, positions: &[DVec3], extras: Extras) {
        let primitive = remade.primitive(run);
        let carried = Carried::new(remade, run, positions);
        let normals = if primitive.has_normals {
            carried.normals()
        } else {
            Vec::new()
        };
        let here = positions[run.vertices()].iter().copied();
        self.begin(&primitive.name, here, &normals, &carried.triangles);
        self.finish(extras.uv, extras.colours, extras.material);
    }

    fn add_seamed(&mut self, remade: &Remade<'_>, run: &Run, positions: &[DVec3], seamed: Seamed) {
        let own = &positions[run.vertices()];
        let here = seamed.copy_of.iter().map(|&v| own[v as usize]);
        self.begin(&remade.primitive(run).name, here, &seamed.normals, &seamed.triangles);
        self.finish(seamed.uv, Vec::new(), seamed.material);
    }
}
