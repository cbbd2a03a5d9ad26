//! Morph targets that follow what is under them.

use super::*;
use crate::asset::{Following, MorphTargetRule};
use glam::{DQuat, Vec3};

/// Displacements of the square's four vertices, one of them none.
const PUSH: [[f32; 3]; 4] = [[0.0, 0.0, 1.0], [0.5, 0.0, 0.25], [0.0, 0.0, 0.0], [0.1, -0.2, 0.3]];

fn floats(bytes: &[u8], from: usize, count: usize) -> Vec<Vec3> {
    let lanes: Vec<f32> = bytes[from..from + 12 * count]
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| f32::from_le_bytes(*b))
        .collect();
    lanes.as_chunks::<3>().0.iter().map(|v| Vec3::from_array(*v)).collect()
}

/// A square with normals and two targets: bytes 0..48 positions, 48..96 normals, 96..144 pushes, 144..192 their normals.
fn morphed(node: &str) -> FileSet {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.points(&UP);
    let view = draft.view(&bytes_of(&PUSH), "");
    draft.accessor(view, 5126, 4, "VEC3", r#","min":[0,-0.2,0],"max":[0.5,0,1]"#);
    draft.points(&PUSH);
    let indices = draft.indices(&CORNERS);
    draft.glb(&format!(
        r#""scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{node}}}],"meshes":[{{"weights":[0.5,0],"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1}},"indices":{indices},"targets":[{{"POSITION":2,"NORMAL":3}},{{"POSITION":2,"_FLOW":3}}]}}]}}]"#
    ))
}

fn with_rule(files: &FileSet, morph_targets: MorphTargetRule, f: impl Fn(DVec3) -> DVec3) -> WrittenFiles {
    let model = open(files);
    let positions: Vec<DVec3> = model.positions.iter().map(|&p| f(p)).collect();
    model
        .write_following(
            &positions,
            Format::GLB,
            Following {
                morph_targets,
                ..Following::default()
            },
        )
        .expect("writable")
}

#[test]
fn displacements_turn_and_grow_with_the_surface() {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 1.25);
    for node in ["", r#","rotation":[0.6,0,0,0.8],"scale":[2,2,2],"translation":[3,4,5]"#] {
        let files = morphed(node);
        let model = open(&files);
        assert_eq!(model.positions.len(), 4, "default weights are not applied");
        let written = with_rule(&files, MorphTargetRule::Follow, |p| turn * p * 1.5 + DVec3::X);
        let stored = bin(&written.main);
        // In world space the turn is the same, whatever the node does.
        let world = if node.is_empty() {
            DQuat::IDENTITY
        } else {
            DQuat::from_xyzw(0.6, 0.0, 0.0, 0.8)
        };
        let in_mesh = world.inverse() * turn * world;
        let (moves, normals) = (floats(&stored, 96, 4), Vec::from(&PUSH));
        for (now, was) in moves.iter().zip(&normals) {
            let expected = in_mesh * Vec3::from_array(*was).as_dvec3() * 1.5;
            assert!(
                (now.as_dvec3() - expected).length() < 1e-6,
                "{node}: {now} for {expected}"
            );
        }
        let document = json(&written);
        assert_eq!(
            document["meshes"][0]["primitives"][0]["targets"][1]["POSITION"], 2,
            "shared and alike: in place"
        );
        assert_eq!(document["meshes"][0]["primitives"][0]["targets"][1]["_FLOW"], 3);
        let own = document["meshes"][0]["primitives"][0]["targets"][0]["NORMAL"]
            .as_u64()
            .expect("a number");
        assert!(own > 4, "an accessor that something else reads is not written over");
        assert_eq!(stored[144..192], bin(&files.main)[144..192]);
        let turned = floats_of(&written, own as usize);
        let turned = turned.as_chunks::<3>().0.iter().map(|v| Vec3::from_array(*v));
        for (now, was) in turned.zip(&PUSH) {
            let expected = in_mesh * Vec3::from_array(*was).as_dvec3();
            assert!(
                (now.as_dvec3() - expected).length() < 1e-6,
                "normals turn and do not grow"
            );
        }
        let bounds = |key: &str, f: fn(Vec3, Vec3) -> Vec3| {
            let values = floats(&stored, 96, 4);
            let all = values.iter().copied().reduce(f).expect("four");
            let stated: Vec<f64> = document["accessors"][2][key]
                .as_array()
                .expect("bounds")
                .iter()
                .filter_map(|v| v.as_f64())
                .collect();
            assert_eq!(stated, all.to_array().map(f64::from), "{key}");
        };
        bounds("min", Vec3::min);
        bounds("max", Vec3::max);
    }
}

#[test]
fn displacements_stay_to_the_byte_where_nothing_turned_or_where_they_are_to() {
    let files = morphed("");
    let shifted = with_rule(&files, MorphTargetRule::Follow, |p| p + DVec3::new(0.1, 0.7, -3.3));
    assert_eq!(bin(&shifted.main)[96..], bin(&files.main)[96..]);
    let kept = with_rule(&files, MorphTargetRule::Keep, |p| DVec3::new(p.z, p.x, p.y));
    assert_eq!(bin(&kept.main)[96..], bin(&files.main)[96..]);
    assert_ne!(bin(&kept.main)[..48], bin(&files.main)[..48]);
    let same = with_rule(&files, MorphTargetRule::Follow, |p| p);
    assert_eq!(same.main, files.main);
}

#[test]
fn sparse_displacements_stay_sparse() {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    let indices = draft.indices(&CORNERS);
    let at = draft.view(&[1, 3], "");
    let to = draft.view(&bytes_of(&[PUSH[1], PUSH[3]]), "");
    let start = draft.bin.len() - 24;
    draft.accessors.push(format!(
        r#"{{"componentType":5126,"count":4,"type":"VEC3","min":[0,-0.2,0],"max":[0.5,0,0.3],"sparse":{{"count":2,"indices":{{"bufferView":{at},"componentType":5121}},"values":{{"bufferView":{to}}}}}}}"#
    ));
    let files = draft.glb(&one(&format!(
        r#"{{"attributes":{{"POSITION":0}},"indices":{indices},"targets":[{{"POSITION":2}}]}}"#
    )));
    let written = with_rule(&files, MorphTargetRule::Follow, |p| DVec3::new(p.z, p.x, p.y));
    let (before, after) = (bin(&files.main), bin(&written.main));
    assert_eq!(before.len(), after.len());
    for (now, was) in floats(&after, start, 2).iter().zip([PUSH[1], PUSH[3]]) {
        assert!((*now - Vec3::new(was[2], was[0], was[1])).length() < 1e-6);
    }
    let accessor = &json(&written)["accessors"][2];
    let stated: Vec<f64> = accessor["max"]
        .as_array()
        .expect("bounds")
        .iter()
        .filter_map(|v| v.as_f64())
        .collect();
    assert!(
        (stated[0] - 0.3).abs() < 1e-6 && (stated[1] - 0.5).abs() < 1e-6,
        "{stated:?}"
    );
}

#[test]
fn targets_too_many_to_follow_are_refused() {
    let mut draft = DocumentDraft::default();
    draft.points(&[SQUARE.as_slice(), &[[0.0; 3]; 80_000]].concat());
    let indices = draft.indices(&CORNERS);
    // Zeros that cost nothing in the file.
    draft
        .accessors
        .push(r#"{"componentType":5126,"count":80004,"type":"VEC3"}"#.into());
    let targets = vec![r#"{"POSITION":2}"#; 2500].join(",");
    let files = draft.glb(&one(&format!(
        r#"{{"attributes":{{"POSITION":0}},"indices":{indices},"targets":[{targets}]}}"#
    )));
    let model = open(&files);
    let positions: Vec<DVec3> = model.positions.iter().map(|p| DVec3::new(p.z, p.x, p.y)).collect();
    let error = model.write(&positions, Format::GLB).err().map(|e| e.to_string());
    assert!(error.as_ref().is_some_and(|e| e.contains("morph targets")), "{error:?}");
    let following = Following {
        morph_targets: MorphTargetRule::Keep,
        ..Following::default()
    };
    assert!(model.write_following(&positions, Format::GLB, following).is_ok());
}
