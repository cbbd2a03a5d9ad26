//! Where the stored vertices of a primitive stand in the world: all by one transform, or each by its own joints.

use super::buffers::BufferBytes;
use super::document::GltfDocument;
use super::influences::{VertexInfluences, influence_accessors};
use super::schema::MeshPrimitive;
use super::skin::SkinPose;
use crate::asset::Error;
use glam::{DAffine3, DMat3, DVec3};
use std::sync::Arc;

/// How a primitive's vertices are placed.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Placement {
    /// By one transform: that of its node, or the one that all joints of its skin agree on.
    Whole(DAffine3),
    /// By the joints of its skin in their rest pose, each vertex by its own blend of them.
    Blended(Arc<SkinPose>),
}

/// The transforms from mesh space to the world, or back, of the vertices of one primitive.
#[derive(Debug, Clone)]
pub(super) enum VertexTransforms {
    /// One for all.
    Whole(DAffine3),
    /// One for each vertex.
    Each(Vec<DAffine3>),
}

/// How different the transforms of joints may be, in units of the size of the mesh, and still count as one. Below it lies
/// what rounding to 32 bits leaves of a skin that was bound in its rest pose.
const SAME: f64 = 2.5e-7;

/// The largest condition number (Frobenius) of a blend of joints through which positions are written back. Ordinary
/// skins have some tens; at this limit, rounding to 32 bits costs three digits.
const WORST_CONDITION: f64 = 1e4;

impl Placement {
    /// How the joints of a skin place a primitive of which `stored` are the positions; or, for a warning, why it stays in bind coordinates.
    pub(super) fn of_skin(
        pose: &Arc<SkinPose>,
        influences: &VertexInfluences,
        stored: &[f32],
    ) -> Result<(Self, VertexTransforms), String> {
        if influences.len() != stored.len() / 3 {
            return Err(format!(
                "{} vertices have joints, there are {}",
                influences.len(),
                stored.len() / 3
            ));
        }
        let of_joint = &pose.world_from_bind;
        let used = influences.joints_in_use();
        for &joint in &used {
            if !of_joint[joint as usize].is_finite() {
                return Err(format!("the transform of joint {joint} is not finite"));
            }
        }
        if let Some(one) = common_transform(of_joint, &used, stored) {
            return match invert(&one) {
                Some(_) => Ok((Self::Whole(one), VertexTransforms::Whole(one))),
                None => Err("its joints flatten it (a scale of zero)".into()),
            };
        }
        let mut each = Vec::with_capacity(influences.len());
        let mut sign = 0.0;
        for vertex in 0..influences.len() {
            let blend = influences.blend(vertex, of_joint);
            if !is_writable(&blend) {
                return Err(format!(
                    "the joints of vertex {vertex} pull it into a line or a point, which cannot be written back"
                ));
            }
            let side = blend.matrix3.determinant().signum();
            if sign == -side {
                return Err("some of its joints mirror and others do not".into());
            }
            sign = side;
            each.push(blend);
        }
        Ok((Self::Blended(Arc::clone(pose)), VertexTransforms::Each(each)))
    }

    /// The transforms of the vertices of a primitive, whose accessors must be decoded.
    pub(super) fn transforms(
        &self,
        doc: &GltfDocument<'_>,
        buffers: &BufferBytes,
        primitive: &MeshPrimitive,
    ) -> Result<VertexTransforms, Error> {
        match self {
            Self::Whole(one) => Ok(VertexTransforms::Whole(*one)),
            Self::Blended(pose) => {
                let of_joint = &pose.world_from_bind;
                let influences = VertexInfluences::read(doc, buffers, primitive, of_joint.len())
                    .map_err(|problem| doc.fault.unwritable(problem))?;
                Ok(VertexTransforms::of_influences(&influences, of_joint))
            }
        }
    }

    /// The accessors that [`Placement::transforms`] reads.
    pub(super) fn accessors(&self, primitive: &MeshPrimitive) -> Vec<usize> {
        match self {
            Self::Whole(_) => Vec::new(),
            Self::Blended(_) => influence_accessors(primitive)
                .into_iter()
                .flat_map(|(j, w)| [j, w])
                .collect(),
        }
    }
}

impl VertexTransforms {
    /// The blend of the joints of each vertex.
    pub(super) fn of_influences(influences: &VertexInfluences, of_joint: &[DAffine3]) -> Self {
        Self::Each((0..influences.len()).map(|v| influences.blend(v, of_joint)).collect())
    }

    /// That of one vertex.
    pub(super) fn at(&self, vertex: usize) -> &DAffine3 {
        match self {
            Self::Whole(one) => one,
            // There is one for each vertex; a missing one would be a fault of this module, and moves nothing.
            Self::Each(each) => each.get(vertex).unwrap_or(&DAffine3::IDENTITY),
        }
    }

    /// Whether they turn the surface inside out; all do or none.
    pub(super) fn is_mirrored(&self) -> bool {
        self.at(0).matrix3.determinant() < 0.0
    }

    /// The transforms back; `None` when one flattens space, up to rounding.
    pub(super) fn inverse(&self) -> Option<Self> {
        Some(match self {
            Self::Whole(one) => Self::Whole(invert(one)?),
            Self::Each(each) => Self::Each(each.iter().map(invert).collect::<Option<_>>()?),
        })
    }
}

/// The inverse of a transform; `None` when it flattens space, up to rounding.
pub(super) fn invert(transform: &DAffine3) -> Option<DAffine3> {
    let m = &transform.matrix3;
    let size = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    (m.determinant().abs() > 1e-12 * size)
        .then(|| transform.inverse())
        .filter(DAffine3::is_finite)
}

/// Whether positions can be written back through a blend of joints without losing their digits.
pub(super) fn is_writable(transform: &DAffine3) -> bool {
    transform.is_finite() && condition(&transform.matrix3) < WORST_CONDITION
}

/// The condition number of a matrix in the Frobenius norm; not finite for a singular one.
fn condition(m: &DMat3) -> f64 {
    let norm = |m: &DMat3| (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt();
    if m.determinant() == 0.0 {
        return f64::INFINITY;
    }
    norm(m) * norm(&m.inverse())
}

/// The one transform that all used joints agree on for a mesh with these stored positions, up to rounding: the case of a
/// skin that was bound in its rest pose. It is the identity when it can be.
fn common_transform(of_joint: &[DAffine3], used: &[u32], stored: &[f32]) -> Option<DAffine3> {
    let points = stored
        .as_chunks::<3>()
        .0
        .iter()
        .map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()));
    let (low, high) = points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| {
        (low.min(p), high.max(p))
    });
    let first = *of_joint.get(*used.first()? as usize)?;
    let corners: [DVec3; 8] = std::array::from_fn(|i| {
        let pick = |lane: usize| if i >> lane & 1 == 0 { low[lane] } else { high[lane] };
        DVec3::new(pick(0), pick(1), pick(2))
    });
    let size = (first.transform_vector3(high - low)).length();
    // An affine difference is largest at a corner.
    let is_same = |a: &DAffine3, b: &DAffine3| {
        let off = corners.map(|c| (a.transform_point3(c) - b.transform_point3(c)).length());
        off.iter().all(|&off| off <= SAME * size)
    };
    if !used.iter().all(|&joint| is_same(&first, &of_joint[joint as usize])) {
        return None;
    }
    Some(if is_same(&first, &DAffine3::IDENTITY) {
        DAffine3::IDENTITY
    } else {
        first
    })
}
