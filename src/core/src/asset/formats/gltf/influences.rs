//! Which joints hold which vertices, and how much.

use super::accessors::{AccessorLayout, ComponentType, read_values};
use super::buffers::BufferBytes;
use super::document::GltfDocument;
use super::schema::MeshPrimitive;
use glam::{DAffine3, DMat3, DVec3};

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
    /// Reads all sets of a primitive, which must be decoded; or says, for a warning, why they mean nothing.
    pub(super) fn read(
        doc: &GltfDocument<'_>,
        buffers: &BufferBytes,
        primitive: &MeshPrimitive,
        joint_count: usize,
    ) -> Result<Self, String> {
        let sets = influence_accessors(primitive);
        if sets.is_empty() {
            return Err("it has no JOINTS_0 and WEIGHTS_0".into());
        }
        let mut joints = Vec::with_capacity(sets.len());
        let mut weights = Vec::with_capacity(sets.len());
        for (set, (joint, weight)) in sets.into_iter().enumerate() {
            joints.push(read_set(doc, buffers, joint, &format!("JOINTS_{set}"))?);
            weights.push(read_set(doc, buffers, weight, &format!("WEIGHTS_{set}"))?);
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
fn read_set(doc: &GltfDocument<'_>, buffers: &BufferBytes, accessor: usize, name: &str) -> Result<Vec<f32>, String> {
    let described = doc.accessors.get(accessor);
    let layout = described.and_then(|a| AccessorLayout::of(a, doc.views.values));
    let (Some(described), Some(layout)) = (described, layout.filter(|l| l.lanes == 4)) else {
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
    read_values(doc, buffers, accessor, layout).map_err(|e| e.to_string())
}
