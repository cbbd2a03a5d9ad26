//! A scene's nodes as a skeleton, and its clips as motion of it.

use super::clip::{JointCurves, MotionClip};
use super::curve::{Interpolation, KeyedCurve};
use super::skeleton::{JointPose, Skeleton, SkeletonJoint};
use crate::asset::{ChannelInterpolation, ChannelValues, MovingScene, SceneChannel, SceneClip, SceneNode};
use glam::{DMat3, DQuat};
use std::collections::BTreeSet;
use std::sync::Arc;

/// The nodes of a scene in the order of a skeleton: parents before children.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NodeOrder {
    /// By joint of the skeleton, the node of the scene.
    pub nodes: Vec<usize>,
    /// By node, its joint.
    pub joints: Vec<usize>,
}

impl NodeOrder {
    /// Finds it. Nodes that hang on each other in a circle, which no reader lets through, come last.
    pub fn of(scene: &MovingScene) -> Self {
        let count = scene.nodes.len();
        let mut children = vec![Vec::new(); count];
        let mut open = Vec::new();
        for (node, own) in scene.nodes.iter().enumerate().rev() {
            match own.parent {
                Some(parent) => children[parent].push(node),
                None => open.push(node),
            }
        }
        let mut order = Self {
            nodes: Vec::with_capacity(count),
            joints: vec![0; count],
        };
        while let Some(node) = open.pop() {
            order.joints[node] = order.nodes.len();
            order.nodes.push(node);
            open.extend(&children[node]);
        }
        order
    }
}

/// A clip of a scene, or without one its rest pose. Joints have the names of nodes; one without a name, or with that of an
/// earlier one, is called by its number.
pub fn clip_of_scene(scene: &MovingScene, order: &NodeOrder, clip: Option<&SceneClip>) -> MotionClip {
    let mut names = BTreeSet::new();
    let joints: Vec<SkeletonJoint> = (order.nodes.iter())
        .map(|&node| {
            let own = &scene.nodes[node];
            let mut name = own.name.clone();
            if name.is_empty() || !names.insert(name.clone()) {
                name = format!("{name}#{node}");
                names.insert(name.clone());
            }
            SkeletonJoint {
                name,
                parent: own.parent.map(|p| order.joints[p]),
                rest: JointPose {
                    translation: own.translation,
                    rotation: own.rotation,
                    scale: own.scale,
                },
            }
        })
        .collect();
    let mut motion = MotionClip {
        name: clip.map_or_else(String::new, |clip| clip.name.clone()),
        curves: vec![JointCurves::default(); joints.len()],
        skeleton: Skeleton { joints },
        ..Default::default()
    };
    motion.warnings.extend(shear_warning(scene, order));
    for channel in clip.iter().flat_map(|clip| &clip.channels) {
        add_channel(&mut motion, order.joints[channel.node], channel);
    }
    motion
}

/// Warns of joints, or nodes above them, with matrices that shear: a skeleton only turns, shifts and scales.
fn shear_warning(scene: &MovingScene, order: &NodeOrder) -> Option<String> {
    let mut carries = scene.is_joint.clone();
    for &node in order.nodes.iter().rev() {
        if let Some(parent) = scene.nodes[node].parent.filter(|_| carries.get(node) == Some(&true)) {
            carries[parent] = true;
        }
    }
    let shears = |node: &SceneNode| {
        let Some(matrix) = node.matrix else { return false };
        let plain = DMat3::from_quat(node.rotation) * DMat3::from_diagonal(node.scale);
        let off = (matrix.matrix3 - plain).to_cols_array();
        off.iter().any(|v| v.abs() > 1e-3 * node.scale.abs().max_element())
    };
    let nodes = scene
        .nodes
        .iter()
        .zip(&carries)
        .filter(|(node, carries)| **carries && shears(node));
    let names: Vec<String> = nodes.map(|(node, _)| format!("\"{}\"", node.name)).take(8).collect();
    (!names.is_empty()).then(|| {
        format!(
            "the matrices of {} shear; of joints the nearest rotation is taken",
            names.join(", ")
        )
    })
}

fn add_channel(motion: &mut MotionClip, joint: usize, channel: &SceneChannel) {
    let times: Arc<[f64]> = channel.times.as_slice().into();
    let end = times.last().copied().unwrap_or(0.0);
    let interpolation = interpolation_of(channel);
    let curves = &mut motion.curves[joint];
    match &channel.values {
        ChannelValues::Translation(values) => {
            curves.translation = KeyedCurve::through(times, values.clone(), interpolation);
        }
        ChannelValues::Scale(values) => curves.scale = KeyedCurve::through(times, values.clone(), interpolation),
        ChannelValues::Rotation(values) => {
            let is_spline = interpolation == Interpolation::CubicSpline;
            let rotations = values.iter().enumerate().map(|(k, q)| match is_spline && k % 3 != 1 {
                true => *q,
                false if q.length_squared() > 1e-12 => q.normalize(),
                false => DQuat::IDENTITY,
            });
            curves.rotation = KeyedCurve::through(times, rotations.collect(), interpolation);
        }
        ChannelValues::Weights(_) => {}
    }
    motion.duration = motion.duration.max(end);
}

/// How a channel of a scene runs, as curves do.
pub(super) fn interpolation_of(channel: &SceneChannel) -> Interpolation {
    match channel.interpolation {
        ChannelInterpolation::Step => Interpolation::Step,
        ChannelInterpolation::Linear => Interpolation::Linear,
        ChannelInterpolation::CubicSpline => Interpolation::CubicSpline,
    }
}
