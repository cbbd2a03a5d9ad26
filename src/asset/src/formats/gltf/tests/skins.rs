//! Where skins put their vertices, and what is reported of those that do not say; morph targets that follow what is under them.

use super::*;
use crate::{MorphTargetRule, RigRule};
use glam::{DAffine3, DQuat};

/// A square with two joints. `joints`, `weights`: one row of four for each vertex; `bind`: inverse bind matrices.
struct SkinDraft {
    joints: [[u8; 4]; 4],
    weights: [[f32; 4]; 4],
    bind: Vec<[f32; 16]>,
    nodes: String,
    skin: String,
}

const ONE: [f32; 16] = [
    1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
];

impl Default for SkinDraft {
    /// The lower two vertices hang on joint 0, the upper two on joint 1.
    fn default() -> Self {
        Self {
            joints: [[0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]],
            weights: [[1.0, 0.0, 0.0, 0.0]; 4],
            bind: vec![ONE, ONE],
            nodes: r#"{"mesh":0,"skin":0,"translation":[9,9,9]},{"name":"low","children":[2],"translation":[0,0,5]},{"name":"high","translation":[0,2,0]}"#.into(),
            skin: r#""joints":[1,2]"#.into(),
        }
    }
}

impl SkinDraft {
    fn files(&self) -> FileSet {
        let mut draft = DocumentDraft::default();
        draft.points(&SQUARE);
        draft.points(&UP);
        let indices = draft.indices(&CORNERS);
        let joints = draft.view(self.joints.as_flattened(), "");
        let joints = draft.accessor(joints, 5121, 4, "VEC4", "");
        let weights = draft.elements(&self.weights, "VEC4", "");
        let bind = draft.elements(&self.bind, "MAT4", "");
        let (nodes, skin) = (&self.nodes, &self.skin);
        draft.glb(&format!(
            r#""scene":0,"scenes":[{{"nodes":[0,1]}}],"nodes":[{nodes}],"skins":[{{{skin},"inverseBindMatrices":{bind}}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"JOINTS_0":{joints},"WEIGHTS_0":{weights}}},"indices":{indices}}}]}}]"#
        ))
    }

    fn codes(&self) -> Vec<String> {
        open(&self.files()).geometry.warnings.into_iter().map(|w| w.0).collect()
    }
}

#[test]
fn vertices_stand_where_their_joints_put_them() {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let draft = SkinDraft {
        nodes: format!(
            r#"{{"mesh":0,"skin":0,"translation":[9,9,9]}},{{"children":[2],"translation":[0,0,5]}},{{"translation":[0,2,0],"rotation":[{half},0,0,{half}]}}"#
        ),
        weights: [
            [1.0, 0.0, 0.0, 0.0],
            [0.5, 0.0, 0.0, 0.0],
            [0.25, 0.75, 0.0, 0.0],
            [3.0, 1.0, 0.0, 0.0],
        ],
        joints: [[0; 4], [0; 4], [0, 1, 0, 0], [1, 0, 0, 0]],
        ..SkinDraft::default()
    };
    let model = open(&draft.files());
    assert_eq!(
        model.positions[0],
        DVec3::new(0.0, 0.0, 5.0),
        "the node's own transform is not a part of it"
    );
    assert_eq!(model.positions[1], DVec3::new(1.0, 0.0, 5.0), "weights are scaled");
    let low = DAffine3::from_translation(DVec3::Z * 5.0);
    let turn = DQuat::from_xyzw(half.into(), 0.0, 0.0, half.into()).normalize();
    let high = DAffine3::from_rotation_translation(turn, DVec3::new(0.0, 2.0, 5.0));
    for (vertex, stored) in [(2, DVec3::new(1.0, 1.0, 0.0)), (3, DVec3::Y)] {
        let expected = low.transform_point3(stored) * 0.25 + high.transform_point3(stored) * 0.75;
        assert!(
            (model.positions[vertex] - expected).length() < 1e-7,
            "{}",
            model.positions[vertex]
        );
        assert!(
            model.normals[vertex].y < -0.5,
            "normals turn along: {}",
            model.normals[vertex]
        );
    }
    assert_eq!(draft.codes(), ["skin-weights"]);

    // And back: what did not move keeps its bytes, what did comes to lie where it was put.
    assert_eq!(moved(&draft.files(), |_, p| p).main, draft.files().main);
    let place = DVec3::new(0.5, 3.0, 4.0);
    let written = moved(&draft.files(), |i, p| if i == 2 { place } else { p });
    let again = open(&again(&written));
    assert!((again.positions[2] - place).length() < 1e-6);
    assert_eq!(
        bin(&written.main)[..24],
        bin(&draft.files().main)[..24],
        "vertices 0 and 1 stay to the byte"
    );
}

#[test]
fn a_skin_that_is_bound_at_rest_is_one_transform() {
    // The joints stand where they were bound, but for what 32 bits lose of a third.
    let third = 1.0_f32 / 3.0;
    let mut bind = vec![ONE, ONE];
    bind[0][13] = -third;
    bind[1][13] = -2.0 * third + 1e-8;
    let draft = SkinDraft {
        bind,
        nodes:
            r#"{"mesh":0,"skin":0},{"children":[2],"translation":[0,0.333333333,0]},{"translation":[0,0.333333333,0]}"#
                .into(),
        ..SkinDraft::default()
    };
    let model = open(&draft.files());
    let stored: Vec<DVec3> = SQUARE
        .iter()
        .map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()))
        .collect();
    assert_eq!(model.positions, stored, "rounding is not a pose");
    assert!(model.warnings.is_empty());
}

#[test]
fn what_a_skin_cannot_say_is_reported_and_bind_coordinates_are_taken() {
    let usual = SkinDraft::default;
    let with_bind = |lane: usize, value: f32| {
        let mut bind = vec![ONE, ONE];
        bind[1][lane] = value;
        SkinDraft { bind, ..usual() }
    };
    let with_skin = |skin: &str| SkinDraft {
        skin: skin.into(),
        ..usual()
    };
    let (mut short, mut far) = (usual(), usual());
    short.bind.pop();
    far.joints = [[0; 4], [0; 4], [2, 0, 0, 0], [0; 4]];
    let cases = [
        (with_skin(r#""joints":[1,7]"#), "names node 7"),
        (with_skin(r#""joints":[]"#), "no joints"),
        (with_skin(r#""joints":"all""#), "cannot be read"),
        (short, "only 1 inverse bind matrices"),
        (far, "vertex 2 follows joint 2"),
        (with_bind(0, f32::NAN), "not an affine transform"),
        (with_bind(3, 0.5), "not an affine transform"),
        (with_bind(0, -1.0), "mirror"),
        (with_bind(5, 0.0), "a line or a point"),
        (with_bind(0, 1e-6), "a line or a point"),
    ];
    for (draft, reason) in cases {
        let model = open(&draft.files());
        assert_eq!(model.positions[2], DVec3::new(1.0, 1.0, 0.0), "{reason}");
        let [(code, message, place)] = model.warnings.as_slice() else {
            panic!("{reason}: {:?}", model.warnings);
        };
        assert_eq!(
            (code.as_str(), place.as_str()),
            ("skin-not-applied", "meshes/0/primitives/0")
        );
        assert!(
            message.contains(reason) && message.contains("bind coordinates"),
            "{message}"
        );
        let written = moved(&draft.files(), |_, p| p + DVec3::X);
        assert_eq!(
            open(&again(&written)).positions[2],
            DVec3::new(2.0, 1.0, 0.0),
            "{reason}"
        );
    }
}

#[test]
fn weights_that_do_not_add_up_are_scaled_and_reported() {
    let with = |weights: [f32; 4], joints: [u8; 4]| {
        let mut draft = SkinDraft::default();
        draft.weights[2] = weights;
        draft.joints[2] = joints;
        draft
    };
    for (draft, height) in [
        (with([0.0; 4], [1, 0, 0, 0]), 3.0),
        (with([0.0; 4], [9, 0, 0, 0]), 1.0),
        (with([2.0, 2.0, 0.0, 0.0], [0, 1, 0, 0]), 2.0),
        (with([-1.0, 0.5, 0.0, 0.0], [0, 1, 0, 0]), 3.0),
        (with([f32::NAN, 0.5, 0.0, 0.0], [0, 1, 0, 0]), 3.0),
        (with([0.5, 0.25, 0.0, 0.0], [1, 1, 0, 0]), 3.0),
    ] {
        assert_eq!(draft.codes(), ["skin-weights"]);
        assert_eq!(open(&draft.files()).positions[2].y, height);
    }
    let usual = with([0.3, 0.3, 0.4, 0.0], [1, 0, 1, 0]);
    assert!(usual.codes().is_empty());
    assert!(
        (open(&usual.files()).positions[2].y - 2.4).abs() < 1e-6,
        "a joint may be named twice"
    );
}

#[test]
fn joints_outside_the_scene_are_reported_and_joints_in_a_circle_refused() {
    let outside = SkinDraft {
        nodes: r#"{"mesh":0,"skin":0},{"translation":[0,0,5]},{"translation":[0,2,0]}"#.into(),
        ..SkinDraft::default()
    };
    assert_eq!(outside.codes(), ["joint-outside-scene"]);
    assert_eq!(open(&outside.files()).positions[2], DVec3::new(1.0, 3.0, 0.0));
    let circle = SkinDraft {
        nodes: r#"{"mesh":0,"skin":0},{"children":[2]},{"children":[1]}"#.into(),
        ..SkinDraft::default()
    };
    let text = refusal(&circle.files());
    assert!(text.contains("its own ancestor"), "{text}");
}

#[test]
fn one_mesh_under_two_skins_stands_in_two_places_and_parts_when_they_differ() {
    let mut draft = SkinDraft::default();
    draft.nodes += r#",{"mesh":0,"skin":1},{"translation":[4,0,0]}"#;
    draft.skin += r#","inverseBindMatrices":5},{"joints":[4,2]"#;
    let files = with_replaced(&draft.files(), &[(r#""nodes":[0,1]}"#, r#""nodes":[0,1,3,4]}"#)]);
    let model = open(&files);
    assert_eq!(
        (model.positions[0], model.positions[4]),
        (DVec3::Z * 5.0, DVec3::X * 4.0)
    );
    assert_eq!(
        model.positions[2], model.positions[6],
        "both hang on the same joint here"
    );
    // Bit for bit where joints stay; where they follow, their matrices are rounded.
    let following = Following {
        rig: RigRule::Keep,
        ..Following::default()
    };
    let written = followed(&files, following, |_, p| DVec3::new(p.x, p.y, -p.z));
    let geometry = open(&again(&written));
    assert_eq!(
        (geometry.positions[0], geometry.positions[4]),
        (DVec3::Z * -5.0, DVec3::X * 4.0)
    );
    assert_eq!(count(&written, "meshes"), 2, "their stored shapes differ now");
}

#[test]
fn the_sides_of_a_seam_stay_together() {
    // Two vertices in one place, held by joints that agree up to rounding.
    let mut files = DocumentDraft::default();
    let thirds = [[1.0 / 3.0, 1.0 / 7.0, 0.0]; 2];
    let points = [thirds[0], thirds[1], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    files.points(&points);
    files.indices(&[0, 2, 3, 1, 3, 2]);
    let joints = files.view(&[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0], "");
    files.accessor(joints, 5121, 4, "VEC4", "");
    let weights: [[f32; 4]; 4] = [
        [0.300_000_04, 0.7, 0.0, 0.0],
        [0.7, 0.3, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
    ];
    files.elements(&weights, "VEC4", "");
    let model = open(&files.glb(
        r#""scene":0,"scenes":[{"nodes":[0,1]}],"nodes":[{"mesh":0,"skin":0},{"children":[2],"translation":[0,0,5]},{"translation":[0.3,2,0]}],"skins":[{"joints":[1,2]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":2,"WEIGHTS_0":3},"indices":1}]}]"#,
    ));
    assert_eq!(model.positions[0], model.positions[1]);
}

/// Displacements of the square's four vertices, one of them none.
const PUSH: [[f32; 3]; 4] = [[0.0, 0.0, 1.0], [0.5, 0.0, 0.25], [0.0, 0.0, 0.0], [0.1, -0.2, 0.3]];

fn floats(bytes: &[u8], from: usize, count: usize) -> Vec<Vec3> {
    vectors(&floats_in(&bytes[from..from + 12 * count]))
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
    let following = Following {
        morph_targets,
        ..Following::default()
    };
    followed(files, following, |_, p| f(p))
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
        let own = index(&document["meshes"][0]["primitives"][0]["targets"][0]["NORMAL"]);
        assert!(own > 4, "an accessor that something else reads is not written over");
        assert_eq!(stored[144..192], bin(&files.main)[144..192]);
        for (now, was) in vectors(&floats_of(&written, own)).iter().zip(&PUSH) {
            let expected = in_mesh * Vec3::from_array(*was).as_dvec3();
            assert!(
                (now.as_dvec3() - expected).length() < 1e-6,
                "normals turn and do not grow"
            );
        }
        let bounds = |key: &str, f: fn(Vec3, Vec3) -> Vec3| {
            let values = floats(&stored, 96, 4);
            let all = values.iter().copied().reduce(f).expect("four");
            let stated = numbers(&document["accessors"][2][key]);
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
    let stated = numbers(&json(&written)["accessors"][2]["max"]);
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
    let positions = places_of(&model, |_, p| DVec3::new(p.z, p.x, p.y));
    let error = model.write(&positions, Format::GLB).err().map(|e| e.to_string());
    assert!(error.as_ref().is_some_and(|e| e.contains("morph targets")), "{error:?}");
    let following = Following {
        morph_targets: MorphTargetRule::Keep,
        ..Following::default()
    };
    assert!(model.write_following(&positions, Format::GLB, following).is_ok());
}
