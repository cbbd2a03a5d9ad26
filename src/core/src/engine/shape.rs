//! Shapes: their names, so that a deformer recognises what it has made, their digests, and their normals and tangents.

use crate::asset::{Geometry, Primitive};
use crate::deform::PoseStats;
use crate::mesh::carry::LocalGradients;
use crate::mesh::shading;
use glam::{DVec3, Vec3, Vec4};
use std::sync::Arc;

/// Names a state of a deformer's topology. Numbers are given in the order in which a deformer reaches new states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct TopologyId(pub(super) u64);

impl TopologyId {
    /// The name after this one.
    pub(super) fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// Names a shape of one deformer. Two shapes that it made and that have one name have the same positions; all others share a
/// name that no deformer remembers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShapeId {
    topology: TopologyId,
    /// Solutions are counted from 1; 0 is the rest shape.
    solution: u64,
}

/// A shape of a deformer's model. Cheap to clone.
#[derive(Debug, Clone)]
pub struct ModelShape {
    /// Its name.
    pub id: ShapeId,
    /// Where the render vertices are, model space. Where nothing moves, the bits of the rest pose.
    pub positions: Arc<Vec<DVec3>>,
    /// How it was solved; the default where it was not.
    pub stats: PoseStats,
    /// The rotations that were found for handles that turn freely.
    pub turns: Arc<[FoundTurn]>,
    /// How space around the render vertices has turned and stretched, of a drag that was asked for it.
    pub gradients: Option<Arc<LocalGradients>>,
}

/// The rotation that a solve has found for a handle with [`HandlePose::free_rotation`](super::HandlePose::free_rotation).
#[derive(Debug, Clone, PartialEq)]
pub struct FoundTurn {
    /// The handle's name.
    pub id: String,
    /// Axis times angle in radians; any number of turns counts.
    pub rotation: DVec3,
}

impl ModelShape {
    /// Makes a shape that no deformer remembers.
    pub fn from_positions(positions: Arc<Vec<DVec3>>) -> Self {
        Self {
            id: ShapeId::solution(TopologyId::default(), u64::MAX),
            positions,
            stats: PoseStats::default(),
            turns: Arc::default(),
            gradients: None,
        }
    }
}

impl std::ops::Deref for ModelShape {
    type Target = [DVec3];

    fn deref(&self) -> &[DVec3] {
        &self.positions
    }
}

impl ShapeId {
    /// Names the rest shape of a topology.
    pub(super) fn rest(topology: TopologyId) -> Self {
        Self { topology, solution: 0 }
    }

    /// Names a solution on a topology; `solution` is above 0 and never given twice.
    pub(super) fn solution(topology: TopologyId, solution: u64) -> Self {
        Self { topology, solution }
    }
}

/// Digest of positions: `xxh3:` and 16 hexadecimal digits of the 64-bit XXH3 of x, y, z of each vertex as
/// little-endian 64-bit floats.
pub fn digest(positions: &[DVec3]) -> String {
    let mut hasher = xxhash_rust::xxh3::Xxh3::new();
    let mut block = [0u8; 24 * 64];
    for run in positions.chunks(64) {
        for (at, number) in block.chunks_exact_mut(8).zip(run.iter().flat_map(|p| p.to_array())) {
            at.copy_from_slice(&number.to_le_bytes());
        }
        hasher.update(&block[..run.len() * 24]);
    }
    format!("xxh3:{:016x}", hasher.digest())
}

/// Normals and tangents of a shape, one per render vertex.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Shading {
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// Unit tangents with handedness; zero where the model has none.
    pub tangents: Vec<Vec4>,
}

/// What is needed of a model to shade its deformed shapes, apart from the model, so that it can be used while the
/// model is being solved.
#[derive(Debug, Clone, Default)]
pub struct Shader {
    rest: Arc<Vec<DVec3>>,
    triangles: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    tangents: Vec<Vec4>,
    primitives: Vec<Primitive>,
    /// Vertices in no triangle with normals, each with the corner whose turn it takes.
    beside: Vec<(u32, u32)>,
}

impl Shader {
    /// Copies what shading needs.
    pub fn from_geometry(model: &Geometry, rest: &Arc<Vec<DVec3>>) -> Self {
        Self {
            rest: Arc::clone(rest),
            triangles: model.triangles.clone(),
            normals: model.normals.clone(),
            tangents: model.tangents.clone(),
            primitives: model.primitives.clone(),
            beside: beside(&model.triangles, &model.normals, &model.primitives, rest),
        }
    }

    /// Normals and tangents of a deformed shape. See [`shading()`].
    pub fn shade(&self, positions: &[DVec3]) -> Shading {
        let Self {
            triangles,
            normals,
            tangents,
            primitives,
            rest,
            beside,
        } = self;
        let authored = Authored {
            triangles,
            normals,
            tangents,
            primitives,
            rest,
            beside,
        };
        authored.shade(positions)
    }

    /// Bytes held, without the rest positions, which are shared.
    pub fn byte_size(&self) -> u64 {
        let bytes = size_of_val(self.triangles.as_slice())
            + size_of_val(self.normals.as_slice())
            + size_of_val(self.tangents.as_slice())
            + size_of_val(self.primitives.as_slice())
            + size_of_val(self.beside.as_slice());
        bytes as u64
    }
}

/// Normals and tangents of a model's deformed shape, one each per render vertex.
///
/// Authored normals and tangents follow the deformation. Primitives that came without normals get the smooth normals of the
/// deformed shape; without tangents, zeros.
pub fn shading(model: &Geometry, rest: &[DVec3], positions: &[DVec3]) -> Shading {
    let authored = Authored {
        triangles: &model.triangles,
        normals: &model.normals,
        tangents: &model.tangents,
        primitives: &model.primitives,
        rest,
        beside: &beside(&model.triangles, &model.normals, &model.primitives, rest),
    };
    authored.shade(positions)
}

/// Vertices in no triangle with normals, each with the corner nearest to it.
fn beside(triangles: &[[u32; 3]], normals: &[Vec3], primitives: &[Primitive], rest: &[DVec3]) -> Vec<(u32, u32)> {
    if normals.len() != rest.len() {
        return Vec::new();
    }
    let authored = primitives.iter().filter(|p| p.has_normals);
    shading::nearest_corners(rest, triangles, authored.flat_map(Primitive::vertices))
}

/// Normals and tangents as they are authored.
pub(super) struct Authored<'a> {
    pub triangles: &'a [[u32; 3]],
    pub normals: &'a [Vec3],
    pub tangents: &'a [Vec4],
    pub primitives: &'a [Primitive],
    /// The shape that they are of.
    pub rest: &'a [DVec3],
    /// Vertices in no triangle, each with the corner whose turn it takes.
    pub beside: &'a [(u32, u32)],
}

impl Authored<'_> {
    /// Those of a deformed shape.
    pub fn shade(&self, positions: &[DVec3]) -> Shading {
        let Self {
            triangles,
            primitives,
            rest,
            ..
        } = self;
        let count = positions.len();
        let mut gradients = if self.normals.len() == count && rest.len() == count {
            shading::gradients(rest, positions, triangles, triangles, count)
        } else {
            vec![None; count]
        };
        for &(vertex, corner) in self.beside {
            if (vertex as usize) < count {
                gradients[vertex as usize] = gradients[corner as usize];
            }
        }
        let authored = marked_vertices(primitives, count, |p| p.has_normals && self.normals.len() == count);
        let mut normals = if authored.iter().all(|&a| a) && !authored.is_empty() {
            vec![Vec3::Z; count]
        } else {
            shading::smooth_normals(positions, triangles)
        };
        for v in (0..count).filter(|&v| authored[v]) {
            let normal = self.normals[v];
            normals[v] = gradients[v]
                .as_ref()
                .map_or(normal, |g| shading::carry_normal(g, normal));
        }
        let with_tangents = marked_vertices(primitives, count, |p| p.has_tangents && self.tangents.len() == count);
        let mut tangents = vec![Vec4::ZERO; count];
        for v in (0..count).filter(|&v| with_tangents[v]) {
            let tangent = self.tangents[v];
            tangents[v] = gradients[v]
                .as_ref()
                .map_or(tangent, |g| shading::carry_tangent(g, tangent, normals[v]));
        }
        Shading { normals, tangents }
    }
}

/// For every vertex, whether it lies in a primitive for which `holds` is true.
fn marked_vertices(primitives: &[Primitive], count: usize, holds: impl Fn(&Primitive) -> bool) -> Vec<bool> {
    let mut marks = vec![false; count];
    for p in primitives.iter().filter(|p| holds(p)) {
        let first = (p.first_vertex as usize).min(count);
        let end = first.saturating_add(p.vertex_count as usize).min(count);
        marks[first..end].fill(true);
    }
    marks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shading_turns_with_the_shape_where_it_was_authored() {
        let rest = Arc::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ZERO, DVec3::X, DVec3::Y]);
        let primitive = |first_vertex, authored| Primitive {
            first_vertex,
            vertex_count: 3,
            index_count: 3,
            has_normals: authored,
            has_tangents: authored,
            ..Primitive::default()
        };
        let bent = Vec3::new(0.6, 0.0, 0.8);
        let shader = Shader {
            rest: Arc::clone(&rest),
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            normals: [[bent; 3], [Vec3::ZERO; 3]].concat(),
            tangents: [[Vec4::new(0.0, 1.0, 0.0, -1.0); 3], [Vec4::ZERO; 3]].concat(),
            primitives: vec![primitive(0, true), primitive(3, false)],
            beside: Vec::new(),
        };
        let still = shader.shade(&rest);
        assert_eq!(
            (still.normals[0], still.normals[4]),
            (bent, Vec3::Z),
            "in the rest pose the authored bits stay"
        );
        // A quarter turn about x takes y to z.
        let turned: Vec<DVec3> = rest.iter().map(|p| DVec3::new(p.x, -p.z, p.y)).collect();
        let shading = shader.shade(&turned);
        assert!((shading.normals[1] - Vec3::new(0.6, -0.8, 0.0)).length() < 1e-6);
        assert!((shading.tangents[1] - Vec4::new(0.0, 0.0, 1.0, -1.0)).length() < 1e-6);
        assert!((shading.normals[5] - Vec3::NEG_Y).length() < 1e-6);
        assert_eq!(shading.tangents[5], Vec4::ZERO);
    }
}
