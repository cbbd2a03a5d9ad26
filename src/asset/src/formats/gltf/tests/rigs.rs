//! What becomes of small skeletons made by hand: nodes, matrices, clips, and what hangs on bones.

use super::super::read::parse_written;
use super::super::scene::place_meshes;
use super::*;
use crate::{BoneLengthRule, RigRule};
use glam::{DAffine3, DQuat};

/// A square of which joint 1 holds the lower two vertices and joint 2, its child, the upper two.
pub(super) struct RigDraft {
    pub(super) nodes: String,
    /// Animations, with accessor 5 for times, 6 for rotations and 7 for translations of two keys.
    pub(super) animations: String,
    pub(super) rotations: Vec<[f32; 4]>,
    pub(super) translations: Vec<[f32; 3]>,
}

const HALF: f32 = std::f32::consts::FRAC_1_SQRT_2;

impl Default for RigDraft {
    fn default() -> Self {
        Self {
            nodes: r#"{"mesh":0,"skin":0},{"children":[2]},{"translation":[0.5,1,0],"children":[3]},{"name":"hand","translation":[0.5,0.5,0]}"#.into(),
            animations: String::new(),
            rotations: vec![[0.0, 0.0, 0.0, 1.0], [HALF, 0.0, 0.0, HALF]],
            translations: vec![[0.0, 1.0, 0.0], [0.0, 1.5, 0.0]],
        }
    }
}

impl RigDraft {
    pub(super) fn files(&self) -> FileSet {
        let mut draft = square_draft();
        let joints = draft.view(&[0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0], "");
        draft.accessor(joints, 5121, 4, "VEC4", "");
        draft.elements(&[[1.0, 0.0, 0.0, 0.0]; 4], "VEC4", "");
        let mut binds = [glam::Mat4::IDENTITY.to_cols_array(); 2];
        (binds[1][12], binds[1][13]) = (-0.5, -1.0);
        draft.elements(&binds, "MAT4", "");
        draft.elements(&[[0.0], [1.0]], "SCALAR", r#","min":[0],"max":[1]"#);
        draft.elements(&self.rotations, "VEC4", "");
        draft.points(&self.translations);
        let (nodes, animations) = (&self.nodes, &self.animations);
        draft.glb(&format!(
            r#""scene":0,"scenes":[{{"nodes":[0,1]}}],"nodes":[{nodes}],"skins":[{{"joints":[1,2],"inverseBindMatrices":4}}],{animations}"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"JOINTS_0":2,"WEIGHTS_0":3}},"indices":1}}]}}]"#
        ))
    }
}

/// The upper two vertices turn about the z axis by a quarter, around their middle, and go up by one.
pub(super) fn raised(i: usize, p: DVec3) -> DVec3 {
    let middle = DVec3::new(0.5, 1.0, 0.0);
    let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
    if i < 2 {
        p
    } else {
        turn * (p - middle) + middle + DVec3::Y
    }
}

fn quarter_turn() -> DQuat {
    DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2)
}

fn is_near(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
}

#[test]
fn a_joint_goes_and_turns_with_what_it_holds_and_what_hangs_on_it_rides_along() {
    let draft = RigDraft::default();
    let written = moved(&draft.files(), |i, p| {
        quarter_turn() * p + DVec3::Y * if i < 4 { 2.0 } else { 0.0 }
    });
    let nodes = &json(&written)["nodes"];
    assert!(is_near(&numbers(&nodes[1]["translation"]), &[0.0, 2.0, 0.0]), "{nodes}");
    let half = f64::from(HALF);
    assert!(
        is_near(&numbers(&nodes[1]["rotation"]), &[half, 0.0, 0.0, half]),
        "{nodes}"
    );
    for same in [2, 3] {
        assert_eq!(
            nodes[same],
            json(&again_as_written(&draft))["nodes"][same],
            "it rides along"
        );
    }
    let skin = &json(&written)["skins"][0];
    assert_eq!(skin["inverseBindMatrices"], 4, "in its place");
    let bind = DAffine3::from_mat4(glam::DMat4::from_cols_slice(&wide(&written, 4)[..16]));
    let joint = DAffine3::from_rotation_translation(quarter_turn(), DVec3::Y * 2.0);
    assert!((bind.inverse().translation - joint.translation).length() < 1e-5);
}

/// The floats of an accessor.
fn wide(written: &WrittenFiles, accessor: usize) -> Vec<f64> {
    floats_of(written, accessor).into_iter().map(f64::from).collect()
}

fn again_as_written(draft: &RigDraft) -> WrittenFiles {
    moved(&draft.files(), |_, p| p)
}

#[test]
fn a_clip_turns_and_shifts_a_joint_from_its_new_rest() {
    let draft = RigDraft {
        animations: r#""animations":[{"channels":[{"sampler":0,"target":{"node":1,"path":"rotation"}},{"sampler":1,"target":{"node":1,"path":"translation"}}],"samplers":[{"input":5,"output":6},{"input":5,"output":7}]}],"#.into(),
        ..RigDraft::default()
    };
    let written = moved(&draft.files(), |_, p| quarter_turn() * p + DVec3::Z * 3.0);
    let animation = &json(&written)["animations"][0];
    assert_eq!(animation["samplers"][0]["output"], 6, "in its place");
    let rotations = wide(&written, 6);
    let half = f64::from(HALF);
    assert!(
        is_near(&rotations, &[half, 0.0, 0.0, half, 1.0, 0.0, 0.0, 0.0]),
        "{rotations:?}"
    );
    // From the old rest in the origin by one, then one and a half upwards: that is along z now.
    let translations = wide(&written, 7);
    assert!(
        is_near(&translations, &[0.0, 0.0, 4.0, 0.0, 0.0, 4.5]),
        "{translations:?}"
    );
}

#[test]
fn tangents_of_a_spline_turn_and_are_not_shifted() {
    let tangent = [0.0, 2.0, 0.0];
    let draft = RigDraft {
        animations: r#""animations":[{"channels":[{"sampler":0,"target":{"node":1,"path":"translation"}}],"samplers":[{"input":5,"output":7,"interpolation":"CUBICSPLINE"}]}],"#.into(),
        translations: vec![tangent, [0.0; 3], tangent, tangent, [0.0, 1.0, 0.0], tangent],
        ..RigDraft::default()
    };
    let written = moved(&draft.files(), |_, p| quarter_turn() * p + DVec3::X);
    let values = wide(&written, 7);
    let turned = [0.0, 0.0, 2.0];
    let expected = [turned, [1.0, 0.0, 0.0], turned, turned, [1.0, 0.0, 1.0], turned];
    assert!(is_near(&values, expected.as_flattened()), "{values:?}");
}

#[test]
fn channels_that_share_numbers_part_when_their_joints_do() {
    let draft = RigDraft {
        animations: r#""animations":[{"channels":[{"sampler":0,"target":{"node":1,"path":"rotation"}},{"sampler":0,"target":{"node":2,"path":"rotation"}}],"samplers":[{"input":5,"output":6}]},{"channels":[{"sampler":0,"target":{"node":1,"path":"rotation"}}],"samplers":[{"input":5,"output":6}]}],"#.into(),
        ..RigDraft::default()
    };
    let files = draft.files();
    let written = moved(&files, raised);
    let animations = &json(&written)["animations"];
    // The lower joint stays, and so do its channels and their numbers; the upper one gets its own.
    assert_eq!(json(&written)["nodes"][1], serde_json::json!({"children": [2]}));
    assert_eq!(animations[1], json_of(&files.main)["animations"][1]);
    assert_eq!(animations[0]["channels"][0]["sampler"], 0);
    assert_eq!(animations[0]["channels"][1]["sampler"], 1);
    assert_eq!(floats_of(&written, 6), draft.rotations.as_flattened());
    let own = index(&animations[0]["samplers"][1]["output"]);
    assert_eq!(animations[0]["samplers"][1]["input"], 5, "the times stay shared");
    let turn = numbers(&json(&written)["nodes"][2]["rotation"]);
    let turn = DQuat::from_slice(&turn);
    for (old, new) in draft.rotations.iter().zip(floats_of(&written, own).as_chunks::<4>().0) {
        let expected = turn * DQuat::from_array(old.map(f64::from));
        assert!(expected.dot(DQuat::from_array(new.map(f64::from))).abs() > 1.0 - 1e-6);
    }
}

#[test]
fn a_mesh_on_a_bone_stays_where_it_was_put() {
    // The hand draws the square too, as it is stored.
    let mut draft = RigDraft::default();
    draft.nodes = draft.nodes.replace(r#""name":"hand""#, r#""name":"hand","mesh":0"#);
    let files = draft.files();
    let model = open(&files);
    assert_eq!(model.primitives.len(), 2);
    let fixed = model.positions[4..].to_vec();
    let written = moved(&files, raised);
    let now = open(&again(&written)).positions.clone();
    let off = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| (*a - *b).length()).fold(0.0, f64::max);
    let wanted: Vec<DVec3> = (0..8).map(|i| raised(i, model.positions[i])).collect();
    assert!(off(&now, &wanted) < 1e-5, "{now:?}");
    assert!(off(&fixed, &wanted[4..]) > 0.5);
}

#[test]
fn matrices_of_nodes_stay_matrices_and_rules_are_kept() {
    let mut draft = RigDraft::default();
    let matrix = "1,0,0,0,0,1,0,0,0,0,1,0,0.5,1,0,1";
    draft.nodes = draft
        .nodes
        .replace(r#""translation":[0.5,1,0]"#, &format!(r#""matrix":[{matrix}]"#));
    let files = draft.files();
    let nodes_with = |rig| {
        let following = Following {
            rig,
            ..Following::default()
        };
        json(&followed(&files, following, raised))["nodes"].clone()
    };
    assert_eq!(nodes_with(RigRule::Keep), json_of(&files.main)["nodes"]);
    let node = &nodes_with(RigRule::Follow)[2];
    assert!(node["translation"].is_null() && node["rotation"].is_null());
    let matrix = numbers(&node["matrix"]);
    assert!((matrix[13] - 2.0).abs() < 0.3 && matrix[1] > 0.3, "{matrix:?}");
}

fn kept(files: &FileSet, bone_lengths: BoneLengthRule) -> WrittenFiles {
    let following = Following {
        bone_lengths,
        ..Following::default()
    };
    let raised = |i: usize, p| raised(i % 4, p);
    let written = followed(files, following, raised);
    let (now, positions) = (
        open(&again(&written)).positions.clone(),
        places_of(&open(files), raised),
    );
    let off = now.iter().zip(&positions).map(|(a, b)| a.distance(*b));
    let off = off.fold(0.0, f64::max);
    assert!(off < 1e-5, "drawn where it was put: {now:?} {positions:?}");
    written
}

/// Where the nodes of a file stand.
fn places(files: &FileSet) -> Vec<DVec3> {
    let parsed = parse_written(files, Format::GLB).expect("readable");
    let doc = parsed.of(files).expect("readable");
    let world: Vec<DAffine3> = place_meshes(&doc, &mut Vec::new()).expect("placed").world_from_node;
    world.iter().map(|node| node.translation).collect()
}

/// Joint 2 stands below node 4, which is not a joint and stands below joint 1.
fn with_node_between(between: &str) -> RigDraft {
    RigDraft {
        nodes: format!(
            r#"{{"mesh":0,"skin":0}},{{"children":[4]}},{{"name":"tip","translation":[0.5,1,0]}},{{}},{{{between},"children":[2]}}"#
        ),
        ..RigDraft::default()
    }
}

#[test]
fn a_joint_stays_at_its_distance_and_goes_where_it_would_have_gone() {
    let draft = RigDraft::default();
    let (before, free) = (
        places(&draft.files()),
        places(&again(&kept(&draft.files(), BoneLengthRule::Follow))),
    );
    let now = places(&again(&kept(&draft.files(), BoneLengthRule::Keep)));
    assert_eq!(now[1], before[1], "nothing has moved around the root");
    let length = before[1].distance(before[2]);
    assert!((free[1].distance(free[2]) - length).abs() > 0.5, "{free:?}");
    assert!((now[1].distance(now[2]) - length).abs() < 1e-6, "{now:?}");
    let (wished, is) = ((free[2] - free[1]).normalize(), (now[2] - now[1]).normalize());
    assert!(wished.distance(is) < 1e-6, "{wished} {is}");
}

#[test]
fn nodes_between_joints_and_their_scales_change_no_length() {
    for between in [
        r#""translation":[0.25,0,0.5]"#,
        r#""scale":[2,2,2],"translation":[0,0.25,0]"#,
        r#""scale":[0.5,2,3],"rotation":[0.5,0.5,0.5,0.5]"#,
        r#""matrix":[0,2,0,0,-1,0,0,0,0,0,1,0,0.25,0,0,1]"#,
    ] {
        let files = with_node_between(between).files();
        let before = places(&files);
        let now = places(&again(&kept(&files, BoneLengthRule::Keep)));
        let (old, new) = (before[1].distance(before[2]), now[1].distance(now[2]));
        assert!((old - new).abs() < 1e-6, "{between}: {new}, it was {old}");
        assert!(now[2].distance(before[2]) > 0.1, "{between}: {now:?}");
    }
}

#[test]
fn a_joint_in_the_place_of_the_one_above_stays_there() {
    let mut draft = RigDraft::default();
    draft.nodes = draft.nodes.replace(r#""translation":[0.5,1,0],"#, "");
    let now = places(&again(&kept(&draft.files(), BoneLengthRule::Keep)));
    assert!(now[1].distance(now[2]) < 1e-7, "{now:?}");
    let free = places(&again(&kept(&draft.files(), BoneLengthRule::Follow)));
    assert!(free[1].distance(free[2]) > 0.1, "{free:?}");
}

#[test]
fn joints_of_two_skins_keep_their_distance_and_draw_both() {
    let nodes = r#"{"mesh":0,"skin":0},{"children":[2]},{"translation":[0.5,1,0]},{"mesh":0,"skin":1}"#;
    let draft = RigDraft {
        nodes: nodes.into(),
        ..RigDraft::default()
    };
    let skin = r#"{"joints":[1,2],"inverseBindMatrices":4}"#;
    let two = format!("{skin},{skin}");
    let scene = (r#""nodes":[0,1]}"#, r#""nodes":[0,1,3]}"#);
    let files = with_replaced(&draft.files(), &[(skin, &two), scene]);
    assert_eq!(open(&files).primitives.len(), 2);
    let (before, now) = (places(&files), places(&again(&kept(&files, BoneLengthRule::Keep))));
    let off = before[1].distance(before[2]) - now[1].distance(now[2]);
    assert!(off.abs() < 1e-6 && now[2] != before[2], "{now:?}");
}

#[test]
fn only_bones_below_a_named_joint_are_rigid() {
    let mut draft = RigDraft::default();
    draft.nodes = draft
        .nodes
        .replace(r#"{"children":[2]}"#, r#"{"name":"root","children":[2]}"#)
        .replace(
            r#"{"translation":[0.5,1,0]"#,
            r#"{"name":"tip","translation":[0.5,1,0]"#,
        );
    let files = draft.files();
    let below = |name: &str| kept(&files, BoneLengthRule::KeepBelow(vec![name.into()]));
    assert_eq!(below("root"), kept(&files, BoneLengthRule::Keep));
    assert_eq!(below("tip"), kept(&files, BoneLengthRule::Follow));
    assert_eq!(open(&files).joint_names().expect("readable"), ["root", "tip"]);
}
