//! Edits of a model made by hand: which vertices are made of which, without the edit operations.

use glam::{DAffine3, DVec3};
use pliant::asset::{
    BaseModel, EditedModel, Error, FileSet, Format, Limits, Model, PrimitiveRun, VertexBlends, WrittenFiles,
    write_edited_model,
};
use std::collections::BTreeMap;

/// The parts of a [`EditedModel`] of one base.
pub struct Edited {
    pub runs: Vec<PrimitiveRun>,
    pub recipes: VertexBlends,
    pub triangles: Vec<[u32; 3]>,
    pub positions: Vec<DVec3>,
}

impl Edited {
    /// Every triangle cut into four at the middles of its edges where `subdivide`; else the first triangle of every
    /// primitive put last, which changes nothing but makes everything be written again.
    pub fn of(model: &Model, subdivide: bool) -> Self {
        let mut edited = Self {
            runs: Vec::new(),
            recipes: VertexBlends::default(),
            triangles: Vec::new(),
            positions: Vec::new(),
        };
        let mut rest = &model.triangles[..];
        for (i, primitive) in model.primitives.iter().enumerate() {
            let (own, after) = rest.split_at(primitive.index_count as usize / 3);
            rest = after;
            let first_vertex = edited.positions.len() as u32;
            let first_triangle = edited.triangles.len() as u32;
            let shift = |v: u32| v - primitive.first_vertex + first_vertex;
            for v in primitive.first_vertex..primitive.first_vertex + primitive.vertex_count {
                edited.recipes.push_vertex(v);
                edited.positions.push(model.positions[v as usize]);
            }
            if own.is_empty() {
                // Points and lines.
            } else if subdivide {
                let mut middles = BTreeMap::new();
                for &t in own {
                    let mut middle = |a: u32, b: u32| {
                        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                            edited.recipes.push_blend(&[(a, 0.5), (b, 0.5)]);
                            edited
                                .positions
                                .push((model.positions[a as usize] + model.positions[b as usize]) * 0.5);
                            edited.positions.len() as u32 - 1
                        })
                    };
                    let [a, b, c] = t;
                    let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                    let [a, b, c] = t.map(shift);
                    edited
                        .triangles
                        .extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
                }
            } else {
                edited
                    .triangles
                    .extend(own[1..].iter().chain(&own[..1]).map(|t| t.map(shift)));
            }
            edited.runs.push(PrimitiveRun {
                base: 0,
                primitive: i as u32,
                first_vertex,
                vertex_count: edited.positions.len() as u32 - first_vertex,
                first_triangle,
                triangle_count: edited.triangles.len() as u32 - first_triangle,
            });
        }
        edited
    }

    /// Adds another edited model behind this one, as its next base.
    pub fn merge(&mut self, other: &Self) {
        let base = self.runs.iter().map(|r| r.base + 1).max().unwrap_or(0);
        let (vertices, triangles) = (self.positions.len() as u32, self.triangles.len() as u32);
        self.runs.extend(other.runs.iter().map(|run| PrimitiveRun {
            base,
            first_vertex: run.first_vertex + vertices,
            first_triangle: run.first_triangle + triangles,
            ..*run
        }));
        for v in 0..other.positions.len() {
            self.recipes.push_composed(&other.recipes, &[(v as u32, 1.0)]);
        }
        self.triangles
            .extend(other.triangles.iter().map(|t| t.map(|v| v + vertices)));
        self.positions.extend(&other.positions);
    }

    /// Positions and triangles in the order of a file: points and lines come behind all that has triangles.
    pub fn as_read(&self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        let (faces, others): (Vec<&PrimitiveRun>, Vec<&PrimitiveRun>) =
            self.runs.iter().partition(|run| run.triangle_count > 0);
        for run in faces.into_iter().chain(others) {
            let first = positions.len() as u32;
            let own = &self.triangles[run.triangles()];
            triangles.extend(own.iter().map(|t| t.map(|v| v - run.first_vertex + first)));
            positions.extend_from_slice(&self.positions[run.vertices()]);
        }
        (positions, triangles)
    }

    /// The description over these models.
    pub fn remade<'a>(&'a self, bases: &'a [BaseModel<'a>]) -> EditedModel<'a> {
        EditedModel {
            bases,
            runs: &self.runs,
            blends: &self.recipes,
            triangles: &self.triangles,
            origins: &[],
            bare: &[],
            caps: Default::default(),
        }
    }

    pub fn write(&self, model: &Model, format: Format) -> Result<WrittenFiles, Error> {
        let bases = [at_rest(model)];
        write_edited_model(&self.remade(&bases), &self.positions, format)
    }
}

/// A base where it was uploaded.
pub fn at_rest(model: &Model) -> BaseModel<'_> {
    BaseModel {
        model,
        world_from_model: DAffine3::IDENTITY,
    }
}

/// What was written, read again.
pub fn read_back(written: &WrittenFiles, format: Format) -> Model {
    let files = file_set("written", written.clone());
    Model::read(files, Some(format), &Limits::default()).expect("what was written is read again")
}

/// What was written, as files to be read.
pub fn file_set(name: &str, written: WrittenFiles) -> FileSet {
    FileSet {
        name: name.into(),
        main: written.main.into(),
        companions: written
            .companions
            .into_iter()
            .map(|(name, b)| (name, b.into()))
            .collect(),
    }
}

/// The largest extent of points.
pub fn size(points: &[DVec3]) -> f64 {
    let low = points.iter().fold(DVec3::INFINITY, |a, &p| a.min(p));
    let high = points.iter().fold(DVec3::NEG_INFINITY, |a, &p| a.max(p));
    (high - low).max_element().max(low.abs().max(high.abs()).max_element())
}
