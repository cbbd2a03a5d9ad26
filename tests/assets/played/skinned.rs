//! Clips of joints: every vertex is carried by them and nothing else.

use super::{bar_folder, read_glb};
use crate::support::data::data_path;
use crate::support::khronos;
use crate::support::shapes::bounds;
use crate::support::skinning::{ClipTime, draw};
use glam::{DQuat, DVec3};
use pliant::asset::sample::BuiltInModel;
use pliant::asset::{
    CarryingJoints, FileSet, Format, Limits, Model, MorphClip, NodeKeys, NodePlace, PlayedJoint, SkinnedClip,
};
use std::fs;
use std::path::Path;

/// Joints at the ends of the longest side of a model, and how much of each every vertex has.
fn two_joints(model: &Model) -> (Vec<PlayedJoint>, Vec<CarryingJoints>) {
    let (low, high) = bounds(&model.positions);
    let side = (high - low).max_position();
    let joint = |name: &str, at: DVec3| PlayedJoint {
        name: name.into(),
        parent: None,
        rest: NodePlace {
            translation: at,
            rotation: DQuat::from_rotation_y(0.3),
        },
    };
    let share = |p: &DVec3| ((p[side] - low[side]) / (high[side] - low[side])) as f32;
    let influences = model.positions.iter().map(|p| {
        let share = share(p).clamp(0.0, 1.0);
        let none = (0, 0.0);
        [(1, share), (0, 1.0 - share), none, none, none, none, none, none]
    });
    (vec![joint("low", low), joint("high", high)], influences.collect())
}

/// Writes a model with a clip of two joints, and checks that a plain player puts every vertex where they do.
fn check_skinned(model: &Model, at: &Path) {
    let (joints, influences) = two_joints(model);
    let (low, high) = bounds(&model.positions);
    let diagonal = low.distance(high);
    let moved = |joint: &PlayedJoint, angle: f64| NodePlace {
        translation: joint.rest.translation + DVec3::Y * (0.1 * angle * diagonal),
        rotation: DQuat::from_rotation_x(angle) * joint.rest.rotation,
    };
    let frames: Vec<Vec<NodePlace>> = [0.0, 0.4, -0.7]
        .map(|angle| vec![joints[0].rest, moved(&joints[1], angle)])
        .to_vec();
    let root = NodePlace {
        translation: DVec3::X * diagonal,
        rotation: DQuat::from_rotation_z(1.0),
    };
    let roots = [NodePlace::IDENTITY, NodePlace::IDENTITY, root];
    let times = [0.0, 0.5, 1.0];
    let clip = SkinnedClip {
        name: "bend",
        influences: &influences,
        joints: &joints,
        times: &times,
        frames: &frames,
        root: Some(NodeKeys {
            times: &times,
            places: &roots,
        }),
        correctives: None,
        beside: None,
    };
    let written = model.write_skinned_clip(&clip).expect("it is written");
    fs::write(at, &written.main).expect("written");
    let file = read_glb(at);
    let clip = file.json["animations"].as_array().expect("clips").len() - 1;
    let place = |place: &NodePlace, p: DVec3| place.rotation * p + place.translation;
    let back = |place: &NodePlace, p: DVec3| place.rotation.inverse() * (p - place.translation);
    let read_again = Model::read(FileSet::single("again.glb", written.main), None, &Limits::default()).expect("a GLB");
    assert_eq!(read_again.triangles.len(), model.triangles.len());
    let stands: Vec<DVec3> = drawn(&file, None);
    let near = |p: &DVec3| {
        let mut all = (0..model.positions.len()).map(|v| (model.positions[v].distance_squared(*p), v));
        all.find(|(far, _)| far.sqrt() < 1e-5 * diagonal).map(|(_, v)| v)
    };
    let in_order = stands.len() == model.positions.len();
    let vertices: Vec<usize> = match in_order {
        true => (0..stands.len()).collect(),
        false => stands.iter().map(|p| near(p).expect("a vertex of the model")).collect(),
    };
    for (p, v) in stands.iter().zip(&vertices) {
        assert!(
            p.distance(model.positions[*v]) < 1e-5 * diagonal,
            "at rest {p} is {}",
            model.positions[*v]
        );
    }
    for (k, frame) in frames.iter().enumerate() {
        let at = ClipTime {
            clip,
            seconds: times[k],
        };
        for (p, v) in drawn(&file, Some(at)).iter().zip(&vertices) {
            let rest = model.positions[*v];
            let carried = influences[*v].iter().map(|(joint, weight)| {
                let own = back(&joints[*joint as usize].rest, rest);
                place(&frame[*joint as usize], own) * f64::from(*weight)
            });
            let wanted = place(&roots[k], carried.sum());
            assert!(p.distance(wanted) < 1e-5 * diagonal, "frame {k}: {p} is to be {wanted}");
        }
    }
}

fn drawn(file: &crate::support::gltf_parsed::Parsed, at: Option<ClipTime>) -> Vec<DVec3> {
    let drawn = draw(file, at, &[]).expect("a plain player draws it");
    drawn.into_iter().flat_map(|d| d.positions).collect()
}

fn read_model(path: &Path) -> Model {
    let bytes = fs::read(path).expect("a model");
    Model::read(
        FileSet::single(path.display().to_string(), bytes),
        None,
        &Limits::default(),
    )
    .expect("a model")
}

#[test]
fn joints_carry_models_of_every_kind() {
    let folder = &bar_folder();
    let mut models = vec![(folder.join("bar.obj"), None)];
    let figure = folder.join("figure.glb");
    fs::write(&figure, BuiltInModel::Figure.glb()).expect("written");
    models.push((figure.clone(), Some(figure)));
    for name in ["CesiumMan", "Fox", "BrainStem"] {
        models.extend(data_path(name, &format!("gltf/{name}.glb")).map(|path| (path.clone(), Some(path))));
    }
    let mut made = Vec::new();
    for (k, (path, source)) in models.into_iter().enumerate() {
        let at = folder.join(format!("skinned_{k}.glb"));
        check_skinned(&read_model(&path), &at);
        made.extend(source.map(|source| (at, source)));
    }
    khronos::assert_nothing_new("skinned clips", &made);
    khronos::assert_valid("a skinned bar", &[folder.join("skinned_0.glb")]);
}

#[test]
fn clips_that_cannot_be_are_refused() {
    let model = Model::read(
        FileSet::single("one.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        Some(Format::OBJ),
        &Limits::default(),
    )
    .expect("a model");
    let joints = [PlayedJoint {
        name: "one".into(),
        parent: None,
        rest: NodePlace::IDENTITY,
    }];
    let frames = [vec![NodePlace::IDENTITY]];
    let skinned = |influence: (u32, f32), times: &[f64], count: usize| {
        let clip = SkinnedClip {
            name: "",
            influences: &vec![[influence; 8]; count],
            joints: &joints,
            times,
            frames: &frames,
            root: None,
            correctives: None,
            beside: None,
        };
        model.write_skinned_clip(&clip).expect_err("refused").to_string()
    };
    for (influence, times, count, reason) in [
        ((1, 0.25), &[0.0][..], 3, "joint 1 of 1"),
        ((0, f32::NAN), &[0.0], 3, "by NaN"),
        ((0, 0.25), &[0.0], 2, "2 influences are given, the model has 3 vertices"),
        ((0, 0.25), &[0.0, 1.0], 3, "2 times and 1 keys"),
        ((0, 0.25), &[f64::NAN], 3, "not finite"),
    ] {
        let refused = skinned(influence, times, count);
        assert!(refused.contains(reason), "{reason}: {refused}");
    }
    let shape = vec![glam::Vec3::ZERO; 3];
    let morphs = |times: &[f64], shapes: &[Vec<glam::Vec3>]| {
        let clip = MorphClip {
            name: "",
            times,
            shapes,
            root: None,
            beside: None,
        };
        model.write_morph_clip(&clip).expect_err("refused").to_string()
    };
    assert!(morphs(&[], &[]).contains("0 times and 0 keys"));
    assert!(morphs(&[1.0, 1.0], &[shape.clone(), shape]).contains("do not rise"));
    assert!(morphs(&[0.0], &[vec![glam::Vec3::NAN; 3]]).contains("not finite"));
}
