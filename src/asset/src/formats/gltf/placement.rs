//! Where the stored vertices of a primitive stand in the world: all by one transform, or each by the joints of its skin.

use super::accessors::ComponentType;
use super::document::GltfDocument;
use super::schema::{GltfSkin, MeshPrimitive};
use crate::Error;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet};
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

    /// The transforms of the vertices of a primitive.
    pub(super) fn transforms(
        &self,
        doc: &GltfDocument<'_>,
        primitive: &MeshPrimitive,
    ) -> Result<VertexTransforms, Error> {
        match self {
            Self::Whole(one) => Ok(VertexTransforms::Whole(*one)),
            Self::Blended(pose) => {
                let of_joint = &pose.world_from_bind;
                let influences = VertexInfluences::read(doc, primitive, of_joint.len())
                    .map_err(|problem| doc.fault.unwritable(problem))?;
                Ok(VertexTransforms::of_influences(&influences, of_joint))
            }
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

/// One skin with its joints where the nodes of the file put them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SkinPose {
    /// The nodes that are its joints.
    pub(super) joints: Vec<usize>,
    /// For each joint the transform from the space of the mesh, as it was bound, to the world: the joint's world transform
    /// times its inverse bind matrix.
    pub(super) world_from_bind: Vec<DAffine3>,
}

impl SkinPose {
    /// Reads a skin of which the nodes stand at `world_from_node`; or says, for a warning, why its rest pose is not known.
    pub(super) fn read(doc: &GltfDocument<'_>, skin: usize, world_from_node: &[DAffine3]) -> Result<Self, String> {
        if skin >= doc.skins.len() {
            return Err("the skin does not exist".into());
        }
        let skin = doc
            .read_skin(skin)
            .map_err(|e| format!("the skin cannot be read ({e})"))?;
        let joints: Vec<usize> = skin.joints.iter().map(|j| j.index()).collect();
        if joints.is_empty() {
            return Err("the skin has no joints".into());
        }
        let nodes = world_from_node.len();
        if let Some(joint) = joints.iter().find(|&&j| j >= nodes) {
            return Err(format!(
                "the skin names node {joint} as a joint, there are {nodes} nodes"
            ));
        }
        let bind = match skin.inverse_bind_matrices {
            None => vec![DAffine3::IDENTITY; joints.len()],
            Some(accessor) => inverse_bind_matrices(doc, accessor.index(), joints.len())?,
        };
        let place = |(&joint, bind): (&usize, &DAffine3)| world_from_node[joint] * *bind;
        let world_from_bind: Vec<DAffine3> = joints.iter().zip(&bind).map(place).collect();
        Ok(Self {
            joints,
            world_from_bind,
        })
    }
}

impl GltfDocument<'_> {
    /// Reads a skin.
    pub(super) fn read_skin(&self, skin: usize) -> serde_json::Result<GltfSkin> {
        serde_json::from_str(self.item(&self.skins, skin))
    }
}

/// The nodes that are joints of any skin that can be read.
pub(super) fn joint_nodes(doc: &GltfDocument<'_>) -> BTreeSet<usize> {
    let skins = (0..doc.skins.len()).filter_map(|skin| doc.read_skin(skin).ok());
    let joints = skins.flat_map(|skin| skin.joints);
    joints
        .map(|joint| joint.index())
        .filter(|&joint| joint < doc.nodes.len())
        .collect()
}

/// The inverse bind matrices of so many joints.
fn inverse_bind_matrices(doc: &GltfDocument<'_>, accessor: usize, joints: usize) -> Result<Vec<DAffine3>, String> {
    let described = doc.accessors.get(accessor);
    let described =
        described.ok_or_else(|| format!("the inverse bind matrices name accessor {accessor}, which does not exist"))?;
    let layout = doc
        .layout(accessor)
        .filter(|l| l.component == ComponentType::F32 && described.shape == "MAT4")
        .ok_or("the inverse bind matrices are not a MAT4 of floats")?;
    let count = described.count.index();
    if count < joints {
        return Err(format!(
            "there are {joints} joints and only {count} inverse bind matrices"
        ));
    }
    doc.read_values(accessor, layout)
        .map_err(|e| e.to_string())?
        .as_chunks::<16>()
        .0
        .iter()
        .take(joints)
        .enumerate()
        .map(|(i, m)| {
            affine_of(m).ok_or_else(|| format!("inverse bind matrix {i} is {m:?}, which is not an affine transform"))
        })
        .collect()
}

/// An affine transform from a matrix in columns; `None` when it is not finite or its last row is not 0 0 0 1.
pub(super) fn affine_of(m: &[f32; 16]) -> Option<DAffine3> {
    let last = [m[3], m[7], m[11], m[15] - 1.0];
    if !m.iter().all(|v| v.is_finite()) || last.iter().any(|v| v.abs() > 1e-5) {
        return None;
    }
    let column = |c: usize| DVec3::new(m[4 * c].into(), m[4 * c + 1].into(), m[4 * c + 2].into());
    Some(DAffine3 {
        matrix3: DMat3::from_cols(column(0), column(1), column(2)),
        translation: column(3),
    })
}

/// Joints and weights of the vertices of one primitive. Of each vertex the joints ascend, and the weights are above
/// zero and sum to 1.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct VertexInfluences {
    /// For each vertex where its entries begin; one more than there are vertices.
    starts: Vec<u32>,
    entries: Vec<(u32, f64)>,
    /// Vertices without any weight, which the first joint that they name holds.
    pub(super) weightless: usize,
    /// Vertices whose stored weights are negative, not finite, or sum to something else than 1.
    pub(super) uneven: usize,
}

/// How far from 1 stored weights may sum without a word: two hundredths, four 8-bit weights that were rounded badly.
const UNEVEN: f64 = 0.02;

/// The accessors of the sets of joints and weights that a primitive has, from set 0 on.
pub(super) fn influence_accessors(primitive: &MeshPrimitive) -> Vec<(usize, usize)> {
    let set = |kind: &str, n: usize| primitive.attribute(&format!("{kind}_{n}"));
    (0..).map_while(|n| set("JOINTS", n).zip(set("WEIGHTS", n))).collect()
}

impl VertexInfluences {
    /// Reads all sets of a primitive; or says, for a warning, why they mean nothing.
    pub(super) fn read(doc: &GltfDocument<'_>, primitive: &MeshPrimitive, joint_count: usize) -> Result<Self, String> {
        let sets = influence_accessors(primitive);
        if sets.is_empty() {
            return Err("it has no JOINTS_0 and WEIGHTS_0".into());
        }
        let mut joints = Vec::with_capacity(sets.len());
        let mut weights = Vec::with_capacity(sets.len());
        for (set, (joint, weight)) in sets.into_iter().enumerate() {
            joints.push(read_set(doc, joint, &format!("JOINTS_{set}"))?);
            weights.push(read_set(doc, weight, &format!("WEIGHTS_{set}"))?);
        }
        Self::from_sets(&joints, &weights, joint_count)
    }

    /// Of sets of four joints and four weights for each vertex.
    pub(super) fn from_sets(joints: &[Vec<f32>], weights: &[Vec<f32>], joint_count: usize) -> Result<Self, String> {
        let count = joints.iter().chain(weights).map(|set| set.len() / 4).min().unwrap_or(0);
        let mut all = Self {
            starts: Vec::with_capacity(count + 1),
            ..Self::default()
        };
        all.starts.push(0);
        let mut own: Vec<(u32, f64)> = Vec::with_capacity(4 * joints.len());
        for vertex in 0..count {
            own.clear();
            let (mut first, mut total, mut is_bad) = (None, 0.0, false);
            for (joints, weights) in joints.iter().zip(weights) {
                let elements = joints[4 * vertex..4 * vertex + 4]
                    .iter()
                    .zip(&weights[4 * vertex..4 * vertex + 4]);
                for (&joint, &weight) in elements {
                    first = first.or(Some(joint as u32));
                    is_bad |= !(weight >= 0.0 && weight.is_finite());
                    if weight > 0.0 && weight.is_finite() {
                        if joint as usize >= joint_count {
                            return Err(format!(
                                "vertex {vertex} follows joint {joint}, the skin has {joint_count}"
                            ));
                        }
                        own.push((joint as u32, f64::from(weight)));
                        total += f64::from(weight);
                    }
                }
            }
            if own.is_empty() {
                all.weightless += 1;
                own.push((first.filter(|&j| (j as usize) < joint_count).unwrap_or(0), 1.0));
                total = 1.0;
            }
            all.uneven += usize::from(is_bad || (total - 1.0).abs() > UNEVEN);
            // In one order whatever the file's, so that the two sides of a seam get the same bits.
            own.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
            own.iter_mut().for_each(|(_, weight)| *weight /= total);
            all.entries.extend_from_slice(&own);
            let end = u32::try_from(all.entries.len()).map_err(|_| "it has too many influences".to_owned())?;
            all.starts.push(end);
        }
        Ok(all)
    }

    /// How many vertices there are.
    pub(super) fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// The joints of a vertex and their weights.
    pub(super) fn of(&self, vertex: usize) -> &[(u32, f64)] {
        let range = self.starts.get(vertex).zip(self.starts.get(vertex + 1));
        range
            .and_then(|(&start, &end)| self.entries.get(start as usize..end as usize))
            .unwrap_or(&[])
    }

    /// The joints that hold any vertex, ascending.
    pub(super) fn joints_in_use(&self) -> Vec<u32> {
        let mut joints: Vec<u32> = self.entries.iter().map(|(joint, _)| *joint).collect();
        joints.sort_unstable();
        joints.dedup();
        joints
    }

    /// The transforms of the joints blended for a vertex.
    pub(super) fn blend(&self, vertex: usize, of_joint: &[DAffine3]) -> DAffine3 {
        let mut sum = DAffine3 {
            matrix3: DMat3::ZERO,
            translation: DVec3::ZERO,
        };
        for &(joint, weight) in self.of(vertex) {
            let joint = &of_joint[joint as usize];
            sum.matrix3 += joint.matrix3 * weight;
            sum.translation += joint.translation * weight;
        }
        sum
    }
}

/// One set of four numbers for each vertex.
fn read_set(doc: &GltfDocument<'_>, accessor: usize, name: &str) -> Result<Vec<f32>, String> {
    let layout = doc.layout(accessor).filter(|l| l.lanes == 4);
    let (Some(described), Some(layout)) = (doc.accessors.get(accessor), layout) else {
        return Err(format!("{name} is not a VEC4"));
    };
    let is_joints = name.starts_with("JOINTS");
    let allowed = match layout.component {
        ComponentType::U8 | ComponentType::U16 => described.normalized != is_joints,
        ComponentType::F32 => !is_joints,
        _ => false,
    };
    if !allowed {
        let kinds = if is_joints {
            "5121 or 5123, not normalized"
        } else {
            "5126, or 5121 or 5123 normalized"
        };
        return Err(format!(
            "{name} has component type {}; {kinds}, is needed",
            described.component_type.0
        ));
    }
    doc.read_values(accessor, layout).map_err(|e| e.to_string())
}

/// Where stored places of each skin have been put. Vertices on both sides of a seam have the same stored position, and
/// joints that agree up to rounding (in two primitives, or with weights in few bits); a solver that joins equal
/// positions would see a gap where everyone else sees none.
#[derive(Default)]
pub(super) struct SkinSeams {
    /// By skin and bits of the stored position.
    placed: BTreeMap<(usize, [u32; 3]), DVec3>,
}

/// How far apart the sides of a seam may be placed, in units of the largest coordinate.
const ROUNDING: f64 = 1e-6;

impl SkinSeams {
    /// Moves vertices to where an earlier vertex with the same stored position is, when that is the same but for rounding.
    /// `skin` identifies the skin; `placed` are the world positions of the vertices that are stored as `stored`.
    pub(super) fn close(&mut self, skin: usize, stored: &[f32], placed: &mut [DVec3]) {
        let largest = placed.iter().fold(0.0, |most: f64, p| most.max(p.abs().max_element()));
        for (stored, place) in stored.as_chunks::<3>().0.iter().zip(placed) {
            // Adding zero turns -0 into 0.
            let first = *self
                .placed
                .entry((skin, stored.map(|v| (v + 0.0).to_bits())))
                .or_insert(*place);
            if (first - *place).abs().max_element() <= ROUNDING * largest {
                *place = first;
            }
        }
    }
}
