//! Clips after joints have moved: the samplers whose values change, and how.
//!
//! Old and new rest pose of a node differ by a turn in its parent's frame and by where it stands there. A rotation of a clip is
//! turned by the same, and a translation's difference from the old rest is turned and added to the new. In the node's own
//! frame a clip so does what it did. Where a bone keeps its length, translations turn with the bone instead. All of it is linear in what interpolation mixes, tangents of splines included.

use super::super::document::GltfDocument;
use super::super::text::{index_of, list_of, value_of};
use super::nodes::{MovedNode, MovedNodes};
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;

/// What a clip does to a node that has moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ClipTarget {
    pub(super) node: usize,
    pub(super) is_rotation: bool,
}

/// How values of a sampler lie in their accessor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct SampledValues {
    pub(super) accessor: usize,
    /// Whether each value stands between two tangents.
    pub(super) is_spline: bool,
}

/// A sampler that needs other values.
pub(super) struct ChangedSampler<'a> {
    pub(super) animation: usize,
    /// Its text.
    pub(super) sampler: &'a str,
    pub(super) values: SampledValues,
    pub(super) target: ClipTarget,
    /// The channels that need a sampler of their own, because others use this one for something else; empty when the sampler
    /// itself changes.
    pub(super) parting: Vec<&'a str>,
}

impl ClipTarget {
    /// Numbers of one value.
    pub(super) fn lanes(self) -> usize {
        if self.is_rotation { 4 } else { 3 }
    }
}

/// All samplers that need other values, animation by animation.
pub(super) fn changed_samplers<'a>(doc: &GltfDocument<'a>, nodes: &MovedNodes) -> Vec<ChangedSampler<'a>> {
    let mut all = Vec::new();
    for (animation, &text) in doc.animations.iter().enumerate() {
        let list = |key: &str| list_of(text, key);
        let samplers = list("samplers");
        let mut users: BTreeMap<usize, Vec<(Option<ClipTarget>, &'a str)>> = BTreeMap::new();
        for channel in list("channels") {
            if let Some(sampler) = index_of(channel, "sampler") {
                let target = target_of(channel).filter(|target| is_changed(nodes, *target));
                users.entry(sampler).or_default().push((target, channel));
            }
        }
        for (sampler, users) in users {
            let Some(&text) = samplers.get(sampler) else { continue };
            let Some(accessor) = index_of(text, "output") else {
                continue;
            };
            let is_spline = value_of(text, "interpolation") == Some("\"CUBICSPLINE\"");
            let mut wanted: BTreeMap<ClipTarget, Vec<&'a str>> = BTreeMap::new();
            for (target, channel) in &users {
                if let Some(target) = target {
                    wanted.entry(*target).or_default().push(channel);
                }
            }
            let is_agreed = wanted.len() == 1 && users.iter().all(|(target, _)| target.is_some());
            for (target, channels) in wanted {
                all.push(ChangedSampler {
                    animation,
                    sampler: text,
                    values: SampledValues { accessor, is_spline },
                    target,
                    parting: if is_agreed { Vec::new() } else { channels },
                });
            }
        }
    }
    all
}

/// Which node a channel moves, and how; `None` for what no joint's motion changes.
fn target_of(channel: &str) -> Option<ClipTarget> {
    let target = value_of(channel, "target")?;
    let path: String = serde_json::from_str(value_of(target, "path")?).ok()?;
    let (node, path) = if path == "pointer" {
        let extension = value_of(value_of(target, "extensions")?, "KHR_animation_pointer")?;
        let pointer: String = serde_json::from_str(value_of(extension, "pointer")?).ok()?;
        let (node, path) = pointer.strip_prefix("/nodes/")?.split_once('/')?;
        (node.parse().ok()?, path.to_owned())
    } else {
        (index_of(target, "node")?, path)
    };
    let is_rotation = path == "rotation";
    (is_rotation || path == "translation").then_some(ClipTarget { node, is_rotation })
}

/// Whether a clip moves or turns any node. Others, such as those of morph weights alone, never change.
pub(in super::super) fn moves_nodes(animation: &str) -> bool {
    let channels = list_of(animation, "channels");
    channels.into_iter().any(|channel| target_of(channel).is_some())
}

fn is_changed(nodes: &MovedNodes, target: ClipTarget) -> bool {
    let turns = |node: &MovedNode| node.turn != DQuat::IDENTITY;
    let node = nodes.moved.get(&target.node);
    node.is_some_and(|node| turns(node) || (!target.is_rotation && node.translation.is_some()))
}

/// Values of a sampler relative to the new rest pose.
pub(super) fn carried_values(stored: &[f32], node: &MovedNode, is_rotation: bool, is_spline: bool) -> Vec<f32> {
    let mut values = stored.to_vec();
    if is_rotation {
        for value in values.as_chunks_mut::<4>().0 {
            let carried = (node.turn * DQuat::from_array(value.map(f64::from))).as_quat();
            if carried.is_finite() {
                *value = carried.to_array();
            }
        }
        return values;
    }
    let turn = node.bone_turn.unwrap_or(node.turn);
    for (i, value) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let stored = DVec3::from_array(value.map(f64::from));
        let is_tangent = is_spline && i % 3 != 1;
        let carried = if is_tangent {
            turn * stored
        } else {
            node.to + turn * (stored - node.from)
        };
        if carried.as_vec3().is_finite() {
            *value = carried.as_vec3().to_array();
        }
    }
    values
}
