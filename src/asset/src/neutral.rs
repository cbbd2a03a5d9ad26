//! A model as it goes from one format to another: geometry, one set of texture coordinates, colours, materials.
//!
//! Texture coordinates count from the upper left corner of the picture, as in glTF.

use super::edited::{CarriedAttributes, EditedModel, PrimitiveRun, RunFaces};
use super::files::counted;
use super::look::{BaseLook, MaterialPicture, NamedMaterial, PicturePlacing};
use super::{Error, Format, Geometry, Primitive};
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// A model free of its format.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct NeutralModel {
    pub geometry: Geometry,
    /// What rest positions of the model that it comes from are relative to where they become single precision.
    pub origin: DVec3,
    /// For each primitive of the geometry what else it has.
    pub attributes: Vec<PrimitiveAttributes>,
    /// One per vertex, or empty when no primitive has any.
    pub uv: Vec<[f32; 2]>,
    /// One per vertex, or empty when no primitive has any.
    pub colours: Vec<[f32; 4]>,
    /// One per corner of a triangle, or empty when no primitive has any: where they differ around a vertex.
    pub corner_uv: Vec<[f32; 2]>,
    /// For each vertex of added runs the one of the edited model that it is or is a copy of.
    pub copy_of: Vec<u32>,
    /// For each triangle of added runs the one of the edited model that it is.
    pub source_triangles: Vec<u32>,
    /// What files beside the model are named after; may be empty.
    pub stem: String,
    /// Whether its numbers are metres, as those of glTF are; other formats do not say.
    pub in_metres: bool,
}

/// What a primitive has beyond its geometry.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct PrimitiveAttributes {
    pub has_uv: bool,
    pub has_colours: bool,
    /// Whether it has texture coordinates by corner.
    pub has_corner_uv: bool,
    /// Its material.
    pub material: Option<Arc<NamedMaterial>>,
    /// Its faces, where some have more than three corners.
    pub faces: Option<RunFaces>,
    /// The first triangle of the object that it is a part of: parts of one run are, and primitives of one mesh at one node.
    pub of_object: u32,
}

/// What files of a format hold of how a model looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct HeldLooks {
    /// Materials and their pictures.
    pub materials: bool,
    /// Texture coordinates.
    pub coordinates: bool,
    /// Colours of vertices.
    pub colours: bool,
}

impl HeldLooks {
    pub const ALL: Self = Self {
        materials: true,
        coordinates: true,
        colours: true,
    };
    pub const NONE: Self = Self {
        materials: false,
        coordinates: false,
        colours: false,
    };
}

/// What one run of an edited model has beyond its geometry, as its format reads it from the files.
#[derive(Debug, Clone, Default)]
pub(super) struct RunAttributes {
    /// Per vertex of the run; empty when there are none.
    pub uv: Vec<[f32; 2]>,
    /// Per vertex of the run; empty when there are none.
    pub colours: Vec<[f32; 4]>,
    /// Per corner of the run's triangles, where they differ around a vertex; empty when there are none.
    pub corner_uv: Vec<[f32; 2]>,
    /// Its material.
    pub material: Option<Arc<NamedMaterial>>,
    /// Its faces, where some have more than three corners.
    pub faces: Option<RunFaces>,
}

/// The colour of caps with a material of their own, as a glTF's base colour.
pub(super) const CAP_COLOUR: [f32; 4] = [0.8, 0.8, 0.8, 1.0];

impl RunAttributes {
    /// Those of a cap with a material of its own.
    pub fn of_cap(material: &str, uv: &[[f32; 2]]) -> Self {
        let look = BaseLook {
            colour: CAP_COLOUR,
            ..BaseLook::default()
        };
        Self {
            uv: uv.to_vec(),
            material: Some(Arc::new(NamedMaterial {
                name: material.to_owned(),
                look: Some(look),
            })),
            ..Self::default()
        }
    }
}

/// A run of an edited model, or a part of it: its vertices, some of which may be copied so that all corners at one are alike.
#[derive(Debug, Clone, Default)]
pub(super) struct RunPart {
    /// For each vertex the vertex of the run that it is or is a copy of.
    pub copy_of: Vec<u32>,
    /// Empty, or one per vertex; zero where there is none.
    pub normals: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// For each of these triangles the one of the run that it is.
    pub source_triangles: Vec<u32>,
    /// Per vertex of this part.
    pub attributes: RunAttributes,
}

impl RunPart {
    /// All of a run, no vertex of it copied.
    pub fn of_run(
        edited: &EditedModel<'_>,
        run: &PrimitiveRun,
        positions: &[DVec3],
        attributes: RunAttributes,
    ) -> Self {
        let carried = CarriedAttributes::new(edited, run, positions);
        let has_normals = edited.primitive(run).has_normals;
        Self {
            copy_of: (0..run.vertex_count).collect(),
            normals: if has_normals { carried.normals() } else { Vec::new() },
            triangles: carried.triangles,
            source_triangles: (0..run.triangle_count).collect(),
            attributes,
        }
    }

    /// Divides it by its texture coordinates at corners: each vertex keeps those of its first corner, and for each other pair
    /// around it there is one copy, after all vertices.
    pub fn divide(&mut self) {
        let corner_uv = std::mem::take(&mut self.attributes.corner_uv);
        let mut uv: Vec<Option<[f32; 2]>> = vec![None; self.copy_of.len()];
        let mut copies: BTreeMap<(u32, [u32; 2]), u32> = BTreeMap::new();
        for (vertex, corner) in self.triangles.as_flattened_mut().iter_mut().zip(0..) {
            let here = corner_uv.get(corner).copied().unwrap_or_default();
            let bits = here.map(f32::to_bits);
            if uv[*vertex as usize].get_or_insert(here).map(f32::to_bits) != bits {
                *vertex = *copies.entry((*vertex, bits)).or_insert_with(|| {
                    self.copy_of.push(*vertex);
                    uv.push(Some(here));
                    self.copy_of.len() as u32 - 1
                });
            }
        }
        let copied = self.copy_of.iter().skip(self.normals.len());
        let normals: Vec<Vec3> = copied.filter_map(|v| self.normals.get(*v as usize).copied()).collect();
        self.normals.extend(normals);
        let colours = &mut self.attributes.colours;
        let copied = self.copy_of.iter().skip(colours.len());
        let more: Vec<[f32; 4]> = copied.filter_map(|v| colours.get(*v as usize).copied()).collect();
        colours.extend(more);
        self.attributes.uv = uv.into_iter().map(Option::unwrap_or_default).collect();
    }
}

/// One primitive of a neutral model and everything it has.
pub(super) struct NeutralPrimitive<'a> {
    pub primitive: &'a Primitive,
    pub attributes: &'a PrimitiveAttributes,
    /// Triangles over the vertices of the whole model.
    pub triangles: &'a [[u32; 3]],
    /// Its vertices.
    pub vertices: Range<usize>,
    /// The place of its first triangle in the whole model.
    pub first_triangle: usize,
}

impl NeutralPrimitive<'_> {
    /// How many faces it has.
    pub fn face_count(&self) -> usize {
        let faces = self.attributes.faces.as_ref();
        faces.map_or(self.triangles.len(), RunFaces::face_count)
    }

    /// Hands out the corners of every face: 3 × triangle + place.
    pub fn each_face(&self, face: impl FnMut(&[u32])) {
        RunFaces::each_or_triangles(self.attributes.faces.as_ref(), self.triangles.len(), face);
    }

    /// The vertex of a corner, counted in the whole model.
    pub fn vertex_at(&self, corner: u32) -> u32 {
        self.triangles[corner as usize / 3][corner as usize % 3]
    }
}

impl NeutralModel {
    /// The model of a geometry that has nothing else.
    pub fn from_geometry(geometry: Geometry) -> Self {
        Self {
            attributes: vec![PrimitiveAttributes::default(); geometry.primitives.len()],
            geometry,
            ..Self::default()
        }
    }

    /// The primitives in order.
    pub fn primitives(&self) -> impl Iterator<Item = NeutralPrimitive<'_>> {
        let pairs = self.geometry.triangles_of_primitives().zip(&self.attributes);
        let mut next = 0;
        pairs.map(move |((primitive, triangles), attributes)| {
            let first_triangle = next;
            next += triangles.len();
            NeutralPrimitive {
                primitive,
                attributes,
                triangles,
                vertices: primitive.vertices(),
                first_triangle,
            }
        })
    }

    /// Adds a part of a run; `positions` are those of the whole edited model.
    ///
    /// # Errors
    /// When 32-bit numbers do not count that many vertices, as copies may make; they would be those of a file of `format`.
    pub fn push_part(
        &mut self,
        edited: &EditedModel<'_>,
        run: &PrimitiveRun,
        positions: &[DVec3],
        part: RunPart,
        format: Format,
    ) -> Result<(), Error> {
        let count = self.geometry.positions.len() as u64 + part.copy_of.len() as u64;
        if count > u64::from(u32::MAX) {
            return Err(Error::unwritable(format, format!("there would be {count} vertices")));
        }
        let own = &positions[run.vertices()];
        let here = part.copy_of.iter().map(|&v| own[v as usize]);
        self.push_primitive(&edited.primitive(run).name, here, &part.normals, &part.triangles);
        self.copy_of.extend(part.copy_of.iter().map(|v| run.first_vertex + v));
        let triangles = part.source_triangles.iter();
        self.source_triangles.extend(triangles.map(|t| run.first_triangle + t));
        self.push_attributes(part.attributes);
        Ok(())
    }

    /// Which vertices of the edited model those of a primitive are or are copies of, as runs of a first one and a count; `None` where
    /// they are those of the same numbers.
    pub fn source_runs(&self, vertices: Range<usize>) -> Option<Vec<[u32; 2]>> {
        let sources = self.copy_of.get(vertices.clone())?;
        if sources
            .iter()
            .zip(vertices)
            .all(|(&source, own)| source as usize == own)
        {
            return None;
        }
        let mut runs: Vec<[u32; 2]> = Vec::new();
        for &source in sources {
            match runs.last_mut() {
                Some([first, count]) if *first + *count == source => *count += 1,
                _ => runs.push([source, 1]),
            }
        }
        Some(runs)
    }

    /// What of its looks files that hold these do not hold, in words.
    pub fn looks_beyond(&self, held: HeldLooks) -> Vec<String> {
        let mut materials: Vec<&NamedMaterial> = Vec::new();
        let mut pictures: Vec<&MaterialPicture> = Vec::new();
        for material in self.attributes.iter().filter_map(|own| own.material.as_deref()) {
            if !materials.contains(&material) {
                materials.push(material);
            }
            let own = material.look.as_ref();
            for picture in own
                .into_iter()
                .flat_map(|look| look.picture.iter().chain(&look.normals))
            {
                if !pictures.contains(&picture) {
                    pictures.push(picture);
                }
            }
        }
        let has_uv = !self.uv.is_empty() || !self.corner_uv.is_empty();
        let lost = [
            counted(materials.len(), "material", "materials").filter(|_| !held.materials),
            counted(pictures.len(), "picture", "pictures").filter(|_| !held.materials),
            (has_uv && !held.coordinates).then(|| "texture coordinates".to_owned()),
            (!self.colours.is_empty() && !held.colours).then(|| "colours of vertices".to_owned()),
        ];
        lost.into_iter().flatten().collect()
    }

    /// The texture coordinates of a corner of a primitive, by corner or by vertex; `None` where it has none.
    pub fn uv_at(&self, own: &NeutralPrimitive<'_>, corner: u32) -> Option<[f32; 2]> {
        if own.attributes.has_corner_uv {
            return self.corner_uv.get(3 * own.first_triangle + corner as usize).copied();
        }
        let has_uv = own.attributes.has_uv;
        self.uv.get(own.vertex_at(corner) as usize).copied().filter(|_| has_uv)
    }

    fn push_primitive(
        &mut self,
        name: &str,
        positions: impl Iterator<Item = DVec3>,
        normals: &[Vec3],
        triangles: &[[u32; 3]],
    ) {
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

    /// Adds what the last primitive has beyond its geometry.
    fn push_attributes(&mut self, attributes: RunAttributes) {
        let RunAttributes {
            mut uv,
            colours,
            mut corner_uv,
            material,
            faces,
        } = attributes;
        let material = material.map(|material| {
            let placing = material
                .look
                .as_ref()
                .map_or(PicturePlacing::PLAIN, |look| look.placing);
            let pairs = uv.iter_mut().chain(&mut corner_uv);
            pairs.for_each(|pair| *pair = placing.place(*pair));
            material.with_placed_coordinates()
        });
        let count = self.geometry.positions.len();
        let added = self.geometry.primitives.last().map_or(0, |p| p.vertex_count as usize);
        self.attributes.push(PrimitiveAttributes {
            has_uv: !uv.is_empty(),
            has_colours: !colours.is_empty(),
            has_corner_uv: !corner_uv.is_empty(),
            material,
            faces,
            of_object: 0,
        });
        if !corner_uv.is_empty() || !self.corner_uv.is_empty() {
            let corners = 3 * self.geometry.triangles.len();
            let own = self.geometry.primitives.last().map_or(0, |p| p.index_count as usize);
            self.corner_uv.resize(corners - own, [0.0; 2]);
            self.corner_uv.extend(corner_uv.into_iter().map(finite_or_zero));
            self.corner_uv.resize(corners, [0.0; 2]);
        }
        if !uv.is_empty() || !self.uv.is_empty() {
            self.uv.resize(count - added, [0.0; 2]);
            self.uv.extend(uv.into_iter().map(finite_or_zero));
            self.uv.resize(count, [0.0; 2]);
        }
        if !colours.is_empty() || !self.colours.is_empty() {
            self.colours.resize(count - added, [1.0; 4]);
            self.colours.extend(colours.into_iter().map(finite_or_zero));
            self.colours.resize(count, [1.0; 4]);
        }
    }
}

/// What no format can hold, and no program draws, is zero.
fn finite_or_zero<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|v| if v.is_finite() { v } else { 0.0 })
}
