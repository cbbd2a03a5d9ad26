//! Bones of small skeletons made by hand, where lengths are to stay: what stands between joints, scales, and shared joints.

use super::super::container::{self, GltfFault};
use super::super::read::parse_written;
use super::super::scene::place_meshes;
use super::rigs::{RigDraft, raised};
use super::*;
use crate::asset::{BoneLengthRule, Following};
use glam::DAffine3;

fn kept(files: &FileSet, bone_lengths: BoneLengthRule) -> WrittenFiles {
    let model = open(files);
    let positions: Vec<DVec3> = model
        .positions
        .iter()
        .enumerate()
        .map(|(i, &p)| raised(i % 4, p))
        .collect();
    let following = Following {
        bone_lengths,
        ..Following::default()
    };
    let written = model
        .write_following(&positions, Format::GLB, following)
        .expect("writable");
    let now = open(&again(&written)).positions.clone();
    let off = now
        .iter()
        .zip(&positions)
        .map(|(a, b)| a.distance(*b))
        .fold(0.0, f64::max);
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

/// Joint 2 stands below node 4, which is no joint and stands below joint 1.
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
    let files = draft.files();
    let skin = r#"{"joints":[1,2],"inverseBindMatrices":4}"#;
    let json = text(&files.main)
        .replace(skin, &format!("{skin},{skin}"))
        .replace(r#""nodes":[0,1]}"#, r#""nodes":[0,1,3]}"#);
    let glb = container::join(json.trim_end(), Some(&bin(&files.main)), &[], GltfFault(Format::GLB)).expect("a GLB");
    let files = FileSet::single("two.glb", glb);
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
