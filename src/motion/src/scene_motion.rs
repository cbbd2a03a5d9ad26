//! What of a scene moves beside a skin: primitives that their nodes carry, and morph targets.
//!
//! A scene's nodes as a skeleton, and its clips as motion of it.

use super::curve::{Interpolation, KeyedCurve};
use super::rig::RigidMotion;
use super::skeleton::{JointCurves, JointPose, MotionClip, Skeleton, SkeletonJoint};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use pliant_asset::{ChannelValues, MovingScene, PrimitiveShapes, SceneChannel, SceneClip, SceneNode};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::local_turns::local_turns;
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

/// What a clip of a model does to primitives that no skin places, and to morph targets of those that one does.
///
/// What has no skin is where its node and its morph targets put it. Where a skinned surface has morph targets, what they move in
/// the rest pose turns and grows with the surface.
#[derive(Debug, Clone)]
pub struct SceneMotion {
    clip: MotionClip,
    /// By joint, the transform of a node that the clip does not move and that has a matrix.
    fixed: Vec<Option<DAffine3>>,
    parts: Vec<ScenePart>,
}

#[derive(Debug, Clone)]
struct ScenePart {
    joint: usize,
    vertices: Range<usize>,
    has_skin: bool,
    shapes: PrimitiveShapes,
    /// By morph target; none where the clip moves none.
    weights: Vec<KeyedCurve<f64>>,
}

impl ScenePart {
    /// By how much morph targets move each vertex at a time; `None` where they do not.
    fn shifts(&self, seconds: f64, exec: &Exec<'_>) -> Result<Option<Vec<DVec3>>, Cancelled> {
        let mut shifts = vec![DVec3::ZERO; self.vertices.len()];
        let mut is_moved = false;
        for (curve, target) in self.weights.iter().zip(&self.shapes.targets) {
            let weight = curve.value_at(seconds);
            if weight == 0.0 || target.is_empty() {
                continue;
            }
            exec.check()?;
            is_moved = true;
            for (shift, own) in shifts.iter_mut().zip(target) {
                *shift += own.as_dvec3() * weight;
            }
        }
        Ok(is_moved.then_some(shifts))
    }
}

impl SceneMotion {
    /// What a clip does to a scene beside its skins; `None` where it does nothing of that kind. `motion` is what
    /// [`crate::clip_of_scene`] made of the clip in the same order, and `shapes` has one entry per primitive.
    pub fn of(
        scene: &MovingScene,
        order: &NodeOrder,
        clip: &SceneClip,
        motion: &MotionClip,
        shapes: Vec<PrimitiveShapes>,
    ) -> Option<Self> {
        let parts = scene
            .primitives
            .iter()
            .zip(shapes)
            .map(|(primitive, shapes)| ScenePart {
                joint: order.joints[primitive.node],
                vertices: primitive.vertices.clone(),
                has_skin: primitive.has_skin,
                shapes,
                weights: weight_curves(clip, primitive.node),
            });
        let parts: Vec<ScenePart> = parts.filter(|p| !p.has_skin || !p.weights.is_empty()).collect();
        let fixed = order.nodes.iter().zip(&motion.curves).map(|(&node, curves)| {
            let is_moved = curves.translation.is_some() || curves.rotation.is_some() || curves.scale.is_some();
            scene.nodes[node].matrix.filter(|_| !is_moved)
        });
        let fixed = fixed.collect();
        (!parts.is_empty()).then(|| Self {
            clip: motion.clone(),
            fixed,
            parts,
        })
    }

    /// Shifts the vertices that a skin holds by their morph targets at a time in seconds. `positions`, one per render vertex, are
    /// as the root bone sees them; `rest` and `triangles` are the model's.
    ///
    /// # Errors
    /// [`Cancelled`], with none of them shifted.
    pub fn shift_skinned(
        &self,
        seconds: f64,
        rest: &[DVec3],
        triangles: &[[u32; 3]],
        positions: &mut [DVec3],
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        let mut morphed: Vec<(&ScenePart, Vec<DVec3>)> = Vec::new();
        for part in self.parts.iter().filter(|part| part.has_skin) {
            morphed.extend(part.shifts(seconds, exec)?.map(|shifts| (part, shifts)));
        }
        if !morphed.is_empty() {
            let turns = local_turns(rest, positions, triangles);
            for (part, shifts) in morphed {
                for (vertex, shift) in part.vertices.clone().zip(shifts) {
                    let turn = turns[vertex].as_ref();
                    positions[vertex] += turn.map_or(shift, |turn| turn.similarity() * shift);
                }
            }
        }
        Ok(())
    }

    /// Puts the vertices that move beside a skin where they are at a time in seconds, as the root bone sees them that does `root`.
    ///
    /// # Errors
    /// [`Cancelled`], with some of them placed.
    pub fn place_carried(
        &self,
        seconds: f64,
        root: &RigidMotion,
        positions: &mut [DVec3],
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        let mut world: Vec<DAffine3> = Vec::with_capacity(self.fixed.len());
        let pose = self.clip.pose_at(seconds);
        for ((joint, own), fixed) in self.clip.skeleton.joints.iter().zip(&pose).zip(&self.fixed) {
            let above = joint.parent.map_or(DAffine3::IDENTITY, |parent| world[parent]);
            world.push(above * fixed.unwrap_or_else(|| own.transform()));
        }
        for part in self.parts.iter().filter(|part| !part.has_skin) {
            let shifts = part.shifts(seconds, exec)?;
            for (number, (vertex, own)) in part.vertices.clone().zip(&part.shapes.positions).enumerate() {
                let shift = shifts.as_ref().map_or(DVec3::ZERO, |shifts| shifts[number]);
                let place = world[part.joint].transform_point3(own.as_dvec3() + shift);
                positions[vertex] = root.place_back(place);
            }
        }
        Ok(())
    }
}

/// The curves of the weights of a node's morph targets; none where the clip moves none.
fn weight_curves(clip: &SceneClip, node: usize) -> Vec<KeyedCurve<f64>> {
    let mut own = clip.channels.iter().filter(|channel| channel.node == node);
    let found = own.find_map(|channel| match &channel.values {
        ChannelValues::Weights(targets) => Some((channel, targets)),
        _ => None,
    });
    let Some((channel, targets)) = found else {
        return Vec::new();
    };
    let times: Arc<[f64]> = channel.times.as_slice().into();
    let curves = targets
        .iter()
        .map(|values| KeyedCurve::through(Arc::clone(&times), values.clone(), channel.interpolation));
    curves.flatten().collect()
}

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
    let interpolation = channel.interpolation;
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use pliant_asset::ScenePrimitive;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    fn node(name: &str, parent: Option<usize>) -> SceneNode {
        SceneNode {
            name: name.into(),
            parent,
            translation: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            scale: DVec3::ONE,
            matrix: None,
        }
    }

    fn channel(node: usize, values: ChannelValues) -> SceneChannel {
        SceneChannel {
            node,
            times: vec![0.0, 2.0],
            values,
            interpolation: Interpolation::Linear,
        }
    }

    #[test]
    fn props_follow_their_nodes_and_faces_their_weights() {
        let shear = DAffine3::from_cols(DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Z, DVec3::ZERO);
        let scene = MovingScene {
            nodes: vec![
                node("hand", None),
                SceneNode {
                    matrix: Some(shear),
                    ..node("prop", Some(0))
                },
                node("face", None),
            ],
            primitives: vec![
                ScenePrimitive {
                    node: 1,
                    vertices: 0..1,
                    has_skin: false,
                },
                ScenePrimitive {
                    node: 2,
                    vertices: 1..4,
                    has_skin: true,
                },
            ],
            ..Default::default()
        };
        let clip = SceneClip {
            name: String::new(),
            channels: vec![
                channel(0, ChannelValues::Translation(vec![DVec3::ZERO, DVec3::X * 4.0])),
                channel(2, ChannelValues::Weights(vec![vec![0.0, 1.0]])),
            ],
        };
        let order = NodeOrder::of(&scene);
        let motion = clip_of_scene(&scene, &order, Some(&clip));
        let shapes = vec![
            PrimitiveShapes {
                positions: vec![Vec3::Y],
                targets: vec![],
            },
            PrimitiveShapes {
                positions: vec![],
                targets: vec![vec![Vec3::Z; 3]],
            },
        ];
        let beside = SceneMotion::of(&scene, &order, &clip, &motion, shapes).expect("something moves");
        let rest = [DVec3::Y, DVec3::ZERO, DVec3::X, DVec3::Y];
        // The face lies turned about x by a quarter: the z axis becomes -y.
        let turned = |p: DVec3| DVec3::new(p.x, -p.z, p.y);
        let mut positions = rest.map(turned);
        let root = RigidMotion {
            rotation: DQuat::from_rotation_z(1.0),
            from: DVec3::X,
            to: DVec3::ONE,
        };
        let pool = Pool::new(1).expect("a thread");
        let exec = Exec::new(&pool, &Silent);
        let placed = beside
            .shift_skinned(1.0, &rest, &[[1, 2, 3]], &mut positions, &exec)
            .and_then(|()| beside.place_carried(1.0, &root, &mut positions, &exec));
        assert_eq!(placed, Ok(()));
        assert!(root.place(positions[0]).distance(DVec3::new(3.0, 1.0, 0.0)) < 1e-12);
        for (now, at_rest) in positions.iter().zip(&rest).skip(1) {
            assert!(now.distance(turned(*at_rest + DVec3::Z * 0.5)) < 1e-9, "{now}");
        }
        let still = SceneClip::default();
        let mut skinned = scene;
        skinned.primitives.remove(0);
        let motion = clip_of_scene(&skinned, &order, Some(&still));
        assert!(SceneMotion::of(&skinned, &order, &still, &motion, vec![Default::default()]).is_none());
    }
}
