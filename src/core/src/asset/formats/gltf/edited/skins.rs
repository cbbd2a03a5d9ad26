//! Joints and weights of edited vertices, and where these put them.

use super::super::buffers::BufferBytes;
use super::super::builder::{AccessorKind, BufferBuilder};
use super::super::document::GltfDocument;
use super::super::fault::GltfFault;
use super::super::influences::{VertexInfluences, influence_accessors};
use super::super::placement::{Placement, VertexTransforms, is_writable};
use super::super::schema::MeshPrimitive;
use super::channels::{AttributeBlender, AttributeValues, read};
use super::handles::AccessorHandle;
use crate::asset::Error;
use glam::DAffine3;
use std::collections::BTreeMap;

/// The influences of a run's vertices as they are written: sets of four joints and four weights for each vertex.
pub(super) struct BlendedSkin {
    joints: Vec<Vec<f32>>,
    weights: Vec<Vec<f32>>,
}

impl BlendedSkin {
    /// Blends what a primitive has; `None` for one without joints. Accessors must be decoded.
    pub(super) fn read(
        doc: &GltfDocument<'_>,
        buffers: &BufferBytes,
        primitive: &MeshPrimitive,
        mixer: &AttributeBlender<'_>,
        placement: &Placement,
    ) -> Result<Option<Self>, Error> {
        let sets = influence_accessors(primitive);
        if sets.is_empty() {
            return Ok(None);
        }
        let (mut of_joints, mut of_weights) = (Vec::new(), Vec::new());
        for (joints, weights) in sets {
            of_joints.push(read_fours(doc, buffers, joints)?);
            of_weights.push(read_fours(doc, buffers, weights)?);
        }
        let (joints, weights) = mixer.blend_skin(&of_joints, &of_weights);
        let mut skin = Self { joints, weights };
        if let Placement::Blended(pose) = placement {
            // Joints that hold two vertices well may cancel each other half-way; the heavier vertex then lends its own.
            let transforms = skin.transforms(&pose.world_from_bind, doc.fault)?;
            let bad: Vec<bool> = (0..mixer.len()).map(|v| !is_writable(transforms.at(v))).collect();
            if bad.contains(&true) {
                let heaviest = |from: &[AttributeValues]| -> Vec<Vec<f32>> {
                    from.iter().map(|set| mixer.take_heaviest(set)).collect()
                };
                replace_where(&bad, &mut skin.joints, &heaviest(&of_joints));
                replace_where(&bad, &mut skin.weights, &heaviest(&of_weights));
            }
        }
        Ok(Some(skin))
    }

    /// Which of so many joints hold the vertices.
    pub(super) fn influences(&self, joints: usize, fault: GltfFault) -> Result<VertexInfluences, Error> {
        let influences = VertexInfluences::from_sets(&self.joints, &self.weights, joints);
        influences.map_err(|problem| fault.unwritable(problem))
    }

    /// Where joints at these transforms put the vertices.
    pub(super) fn transforms(&self, of_joint: &[DAffine3], fault: GltfFault) -> Result<VertexTransforms, Error> {
        let influences = self.influences(of_joint.len(), fault)?;
        Ok(VertexTransforms::of_influences(&influences, of_joint))
    }

    /// Writes all sets.
    pub(super) fn write(&self, fresh: &mut BufferBuilder, attributes: &mut BTreeMap<String, AccessorHandle>) {
        for (n, (joints, weights)) in self.joints.iter().zip(&self.weights).enumerate() {
            let joints = fresh.add_joints(joints);
            let weights = fresh.add_floats(weights, 4, "VEC4", AccessorKind::Floats);
            attributes.insert(format!("JOINTS_{n}"), AccessorHandle::New(joints));
            attributes.insert(format!("WEIGHTS_{n}"), AccessorHandle::New(weights));
        }
    }
}

fn replace_where(bad: &[bool], sets: &mut [Vec<f32>], with: &[Vec<f32>]) {
    for (set, with) in sets.iter_mut().zip(with) {
        let vertices = set.as_chunks_mut::<4>().0.iter_mut().zip(with.as_chunks::<4>().0);
        for ((own, other), _) in vertices.zip(bad).filter(|(_, bad)| **bad) {
            *own = *other;
        }
    }
}

fn read_fours(doc: &GltfDocument<'_>, buffers: &BufferBytes, accessor: usize) -> Result<AttributeValues, Error> {
    let channel = read(doc, buffers, accessor)?;
    if channel.lanes != 4 {
        let problem = format!("{} numbers per element, 4 are needed", channel.lanes);
        return Err(doc.fault.malformed(format!("accessors/{accessor}/type"), problem));
    }
    Ok(channel)
}
