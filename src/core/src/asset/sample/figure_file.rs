//! The figure as a game's character: a skinned body with two clips, two levels of detail, a hull for collisions and two sockets.

use super::figure::figure_body;
use super::figure_clips::{FigureClip, clips};
use super::figure_skeleton::{FigureJoint, joint_weights, skeleton};
use crate::asset::Geometry;
use crate::asset::formats::{ElementShape, GlbWriter};
use glam::DVec3;
use serde_json::{Value, json};

/// Names of the drawn parts, the edge of their cells, and how far outside of the body they lie. All but the last are skinned.
const PARTS: [(&str, f64, f64); 4] = [
    ("body", 0.02, 0.0),
    ("lod1", 0.035, 0.0),
    ("lod2", 0.055, 0.0),
    ("hull", 0.1, 0.05),
];

/// Where things are attached: a name, the joint, and the place in the world.
const SOCKETS: [(&str, &str, [f64; 3]); 2] = [
    ("rightHandSocket", "rightHand", [-0.80, 1.365, 0.0]),
    ("hatSocket", "head", [0.0, 1.775, 0.0]),
];

/// The figure as a GLB file: primitive 0 is the body, 1 and 2 are its levels of detail (`lod1`, `lod2`), 3 is a hull for collisions.
/// Its clips are called `walk` and `wave`, its sockets `rightHandSocket` and `hatSocket`.
///
/// # Panics
/// Never: a few thousand finite vertices fit the format.
pub fn figure_glb() -> Vec<u8> {
    let joints = skeleton();
    let mut file = GlbWriter::default();
    let (mut nodes, mut meshes, mut scene) = (joint_nodes(&joints), Vec::new(), vec![json!(0)]);
    for (name, joint, place) in SOCKETS {
        let Some(above) = joints.iter().position(|own| own.name == joint) else {
            continue;
        };
        let offset = (DVec3::from_array(place) - joints[above].place).as_vec3();
        hang(
            &mut nodes,
            above,
            json!({"name": name, "translation": offset.to_array()}),
        );
    }
    for (name, cell, off) in PARTS {
        let part = figure_body(name, cell, off);
        let skinned = off == 0.0;
        let mesh = drawn(&mut file, &part, skinned.then_some(joints.as_slice()));
        scene.push(json!(nodes.len()));
        nodes.push(json!({"name": name, "mesh": meshes.len()}));
        if skinned {
            nodes.last_mut().expect("one was pushed")["skin"] = json!(0);
        }
        meshes.push(mesh);
    }
    let matrices: Vec<f32> = joints
        .iter()
        .flat_map(|joint| glam::Mat4::from_translation(-joint.place.as_vec3()).to_cols_array())
        .collect();
    let matrices = file.add_floats(&matrices, ElementShape::Mat4);
    let animations: Vec<Value> = clips().iter().map(|clip| animation(&mut file, clip, &joints)).collect();
    let document = json!({
        "scene": 0,
        "scenes": [{"nodes": scene}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [{
            "name": "cloth",
            "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8},
        }],
        "skins": [{
            "skeleton": 0,
            "joints": (0..joints.len()).collect::<Vec<_>>(),
            "inverseBindMatrices": matrices,
        }],
        "animations": animations,
    });
    file.finish(document).expect("a small file fits the format")
}

/// The joints as nodes, each where it is relative to the one that it hangs on.
fn joint_nodes(joints: &[FigureJoint]) -> Vec<Value> {
    let mut nodes: Vec<Value> = Vec::new();
    for joint in joints {
        let above = joint.parent.map_or(DVec3::ZERO, |parent| joints[parent].place);
        let node = json!({"name": joint.name, "translation": (joint.place - above).as_vec3().to_array()});
        match joint.parent {
            Some(parent) => hang(&mut nodes, parent, node),
            None => nodes.push(node),
        }
    }
    nodes
}

/// Adds a node below another.
fn hang(nodes: &mut Vec<Value>, above: usize, node: Value) {
    let own = nodes.len();
    nodes.push(node);
    match nodes[above]["children"].as_array_mut() {
        Some(children) => children.push(json!(own)),
        None => nodes[above]["children"] = json!([own]),
    }
}

fn drawn(file: &mut GlbWriter, part: &Geometry, joints: Option<&[FigureJoint]>) -> Value {
    let positions: Vec<f32> = part.positions.iter().flat_map(|p| p.as_vec3().to_array()).collect();
    let normals: Vec<f32> = part.normals.iter().flat_map(|n| n.to_array()).collect();
    let mut attributes = json!({
        "POSITION": file.add_bounded(&positions, ElementShape::Vec3),
        "NORMAL": file.add_floats(&normals, ElementShape::Vec3),
    });
    if let Some(joints) = joints {
        let colours: Vec<f32> = part.positions.iter().flat_map(|&p| cloth_at(p)).collect();
        attributes["COLOR_0"] = json!(file.add_floats(&colours, ElementShape::Vec3));
        let held: Vec<_> = part.positions.iter().map(|&p| joint_weights(joints, p)).collect();
        let numbers: Vec<[u16; 4]> = held.iter().map(|(numbers, _)| numbers.map(u16::from)).collect();
        let weights: Vec<f32> = held.iter().flat_map(|(_, weights)| *weights).collect();
        attributes["JOINTS_0"] = json!(file.add_joints(&numbers));
        attributes["WEIGHTS_0"] = json!(file.add_floats(&weights, ElementShape::Vec4));
    }
    let indices = file.add_triangles(&part.triangles);
    json!({
        "name": part.primitives[0].name,
        "primitives": [{"attributes": attributes, "indices": indices, "material": 0}],
    })
}

/// The colour of what the figure wears at a place, as linear red, green and blue: shoes, trousers, a shirt, or its skin.
fn cloth_at(place: DVec3) -> [f32; 3] {
    let [aside, height] = [place.x.abs(), place.y];
    match () {
        () if height < 0.08 => [0.03, 0.025, 0.02],
        () if height < 0.97 => [0.06, 0.11, 0.3],
        () if height < 1.47 && aside < 0.4 => [0.55, 0.12, 0.08],
        () => [0.8, 0.5, 0.36],
    }
}

fn animation(file: &mut GlbWriter, clip: &FigureClip, joints: &[FigureJoint]) -> Value {
    let times: Vec<f32> = clip.times.iter().map(|&time| time as f32).collect();
    let times = file.add_bounded(&times, ElementShape::Scalar);
    let (mut channels, mut samplers) = (Vec::new(), Vec::new());
    let mut play = |joint: &str, path: &str, output: usize| {
        let node = joints.iter().position(|own| own.name == joint);
        channels.push(json!({"sampler": samplers.len(), "target": {"node": node, "path": path}}));
        samplers.push(json!({"input": times, "output": output}));
    };
    for (joint, rotations) in &clip.rotations {
        let values: Vec<f32> = rotations.iter().flat_map(|q| q.as_quat().to_array()).collect();
        play(joint, "rotation", file.add_floats(&values, ElementShape::Vec4));
    }
    if !clip.lift.is_empty() {
        let hips = joints[0].place;
        let raised = |lift: &f64| (hips + DVec3::Y * *lift).as_vec3().to_array();
        let values: Vec<f32> = clip.lift.iter().flat_map(raised).collect();
        play(
            &joints[0].name,
            "translation",
            file.add_floats(&values, ElementShape::Vec3),
        );
    }
    json!({"name": clip.name, "channels": channels, "samplers": samplers})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::{FileSet, Limits, Model};

    #[test]
    fn the_figure_reads_back_without_a_warning() {
        let files = FileSet::single("figure.glb", figure_glb());
        let model = Model::read(files, None, &Limits::default()).expect("it is a GLB");
        let names: Vec<&str> = model
            .primitives
            .iter()
            .map(|primitive| primitive.name.as_str())
            .collect();
        assert_eq!(names, PARTS.map(|(name, _, _)| name));
        assert!(model.warnings.is_empty(), "{:?}", model.warnings);
    }
}
