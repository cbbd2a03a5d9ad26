//! Which joints of a clip turn the bones of a body, by their names.
//!
//! Which joints of a clip turn the bones of a body, by how its skeleton branches.
//!
//! The joints and bones of a body.

use crate::rig::{RestAttitude, RigError, listed_names};
use crate::skeleton::{JointPose, Skeleton, SkeletonJoint};
use glam::DVec3;
use std::collections::BTreeMap;

/// By bone of a body, the joint of a skeleton that turns it.
pub type ClipBones = BTreeMap<&'static str, usize>;

/// Names of limbs' joints without side and ornament, of each bone the likeliest first.
const LIMBS: [(&str, &[&str]); 7] = [
    ("Upper", &["arm", "upperarm", "uparm", "humerus", "shldr", "shoulder"]),
    ("Clav", &["clavicle", "collar", "clav", "collarbone", "shoulder"]),
    ("Fore", &["forearm", "lowerarm", "lowarm", "radius", "elbow"]),
    ("Hand", &["hand", "wrist"]),
    ("Thigh", &["upleg", "upperleg", "thigh", "femur", "hip", "hipjoint"]),
    ("Shin", &["leg", "lowerleg", "lowleg", "shin", "calf", "tibia", "knee"]),
    ("Foot", &["foot", "ankle"]),
];
/// Names of the trunk's.
const HIPS: [&str; 5] = ["hips", "pelvis", "hip", "root", "bodyroot"];
const HEADS: [&str; 2] = ["head", "skull"];

/// What a name says: the side (l, r or nothing) and the rest of it in small letters.
fn side_and_name(name: &str) -> (char, String) {
    let own = name.rsplit(':').next().unwrap_or(name);
    let own = ["mixamorig", "CC_Base_", "Bip001", "Bip01", "DEF-"]
        .iter()
        .fold(own, |own, prefix| own.strip_prefix(prefix).unwrap_or(own));
    let small = own.to_lowercase();
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphabetic).collect::<String>();
    for (word, side) in [("left", 'l'), ("right", 'r')] {
        if let Some(at) = small.find(word) {
            return (side, plain(&small[..at]) + &plain(&small[at + word.len()..]));
        }
    }
    let mut letters = own.trim_start_matches(['_', ' ', '.', '-']).chars();
    let first = letters.next().unwrap_or(' ').to_ascii_lowercase();
    let second = letters.next().unwrap_or(' ');
    let is_mark = |c: char| matches!(c, '_' | '.' | '-' | ' ');
    if matches!(first, 'l' | 'r') && (is_mark(second) || (second.is_uppercase() && own != own.to_uppercase())) {
        return (first, plain(&small)[1..].to_owned());
    }
    let mut back = small.chars().rev();
    let (last, before) = (back.next().unwrap_or(' '), back.next().unwrap_or(' '));
    if matches!(last, 'l' | 'r') && is_mark(before) {
        let text = plain(&small);
        return (last, text[..text.len() - 1].to_owned());
    }
    (' ', plain(&small))
}

/// Finds bones by names, such as those of CMU, Mixamo, Blender's Rigify, 3ds Max and others.
///
/// # Errors
/// [`RigError`] when no joint has the name of a needed bone, with the known names and those of the clip.
pub fn bones_of_names(skeleton: &Skeleton) -> Result<ClipBones, RigError> {
    let named: Vec<(char, String)> = skeleton.joints.iter().map(|joint| side_and_name(&joint.name)).collect();
    let first_of = |side: char, names: &[&str], taken: Option<usize>| {
        let is_it = |name: &str| named.iter().position(|n| n.0 == side && n.1 == name);
        names
            .iter()
            .filter_map(|name| is_it(name))
            .find(|joint| Some(*joint) != taken)
    };
    let mut bones = ClipBones::new();
    if let Some(joint) = first_of(' ', &HIPS, None) {
        bones.insert("pelvis", joint);
    }
    for side in ['l', 'r'] {
        let mut upper = None;
        for (part, names) in LIMBS {
            let taken = if part == "Clav" { upper } else { None };
            let Some(joint) = first_of(side, names, taken) else {
                continue;
            };
            if part == "Upper" {
                upper = Some(joint);
            }
            let bone = BODY_BONES.iter().find(|b| b.id.starts_with(side) && b.id[1..] == *part);
            if let Some(bone) = bone {
                bones.insert(bone.id, joint);
            }
        }
    }
    let missing: Vec<&str> = BODY_BONES
        .iter()
        .filter(|bone| bone.is_needed && !bones.contains_key(bone.id))
        .map(|bone| bone.id)
        .collect();
    if let Some(bone) = missing.first() {
        let names = LIMBS
            .iter()
            .find(|(part, _)| bone[1..] == **part)
            .map_or(&HIPS[..], |l| l.1);
        let joints = skeleton
            .joints
            .iter()
            .map(|j| j.name.as_str())
            .filter(|n| !n.is_empty());
        return Err(RigError::Field {
            field: "clip",
            problem: format!(
                "no joint is called as that of {} is, such as {}; it has {}",
                listed_names(missing.iter()),
                listed_names(names.iter()),
                listed_names(joints)
            ),
        });
    }
    add_trunk(skeleton, first_of(' ', &HEADS, None), &mut bones);
    Ok(bones)
}

/// Finds the bones between hips and head by their parents. `head`: the joint of the head, where one is known.
pub(super) fn add_trunk(skeleton: &Skeleton, head: Option<usize>, bones: &mut ClipBones) {
    let Some(&hips) = bones.get("pelvis") else { return };
    let above = |joint: usize| path_to(skeleton, joint);
    let arms: Vec<Vec<usize>> = ["lUpper", "rUpper"]
        .iter()
        .filter_map(|b| bones.get(b))
        .map(|j| above(*j))
        .collect();
    let [left, right] = &arms[..] else { return };
    // Where the ways to both arms part.
    let shared = left.iter().zip(right).take_while(|(a, b)| a == b).count();
    let Some(&chest) = left[..shared].last() else { return };
    let between: Vec<usize> = left[..shared].iter().copied().skip_while(|j| *j != hips).collect();
    if chest != hips {
        bones.insert("chest", chest);
        if between.len() > 2 {
            bones.insert("abdomen", between[between.len() / 2]);
        }
    }
    if let Some(head) = head {
        bones.insert("head", head);
        let neck: Vec<usize> = above(head).into_iter().skip_while(|j| *j != chest).collect();
        if neck.len() > 2 {
            bones.insert("neck", neck[neck.len() - 2]);
        }
    }
}

/// The joints on the way from a root to a joint, which comes last.
fn path_to(skeleton: &Skeleton, joint: usize) -> Vec<usize> {
    let up = std::iter::successors(Some(joint), |j| skeleton.joints[*j].parent);
    let mut path: Vec<usize> = up.collect();
    path.reverse();
    path
}

/// A skeleton with the names of a preset, so that a rig can be made where no clip is at hand. `None` for another name; there
/// are `cmu` and `mixamo`.
pub fn preset_skeleton(name: &str) -> Option<Skeleton> {
    // Each chain begins at its first joint, or hangs on it where an earlier chain has it.
    let (prefix, chains) = match name {
        "cmu" => (
            "",
            [
                "Hips LeftUpLeg LeftLeg LeftFoot",
                "Hips RightUpLeg RightLeg RightFoot",
                "Hips LowerBack Spine Spine1 Neck Neck1 Head",
                "Spine1 LeftShoulder LeftArm LeftForeArm LeftHand",
                "Spine1 RightShoulder RightArm RightForeArm RightHand",
            ],
        ),
        "mixamo" => (
            "mixamorig:",
            [
                "Hips Spine Spine1 Spine2 Neck Head",
                "Spine2 LeftShoulder LeftArm LeftForeArm LeftHand",
                "Spine2 RightShoulder RightArm RightForeArm RightHand",
                "Hips LeftUpLeg LeftLeg LeftFoot",
                "Hips RightUpLeg RightLeg RightFoot",
            ],
        ),
        _ => return None,
    };
    let mut skeleton = Skeleton::default();
    for chain in chains {
        let mut parent = None;
        for name in chain.split(' ') {
            let name = format!("{prefix}{name}");
            let known = skeleton.joint_named(&name);
            parent = Some(known.unwrap_or_else(|| {
                skeleton.joints.push(SkeletonJoint {
                    name,
                    parent,
                    rest: JointPose::at(DVec3::ZERO),
                });
                skeleton.joints.len() - 1
            }));
        }
    }
    Some(skeleton)
}

/// Finds bones by shape alone: legs are the two branches that reach lowest, the head the one that reaches highest, arms
/// those that reach farthest to both sides. Left is where x rises. `None` where there are no such branches.
pub fn bones_of_shape(skeleton: &Skeleton) -> Option<ClipBones> {
    let world = skeleton.world_transforms(&skeleton.rest_pose());
    let places: Vec<DVec3> = world.iter().map(|w| w.translation).collect();
    let joints = &skeleton.joints;
    let mut is_leaf = vec![true; joints.len()];
    joints.iter().filter_map(|j| j.parent).for_each(|p| is_leaf[p] = false);
    let leaves: Vec<usize> = (0..joints.len()).filter(|j| is_leaf[*j]).collect();
    let low = places.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
    let high = places.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
    let tall = if high.z - low.z > 1.2 * (high.y - low.y) {
        DVec3::Z
    } else {
        DVec3::Y
    };
    let way = |joint: usize| path_to(skeleton, joint);
    let best = |score: &dyn Fn(usize) -> f64| {
        let ranked = leaves.iter().copied().map(|leaf| (score(leaf), leaf));
        ranked
            .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
            .map(|best| best.1)
    };
    let side_of = |leaf: usize| places[leaf].x - places[0].x;
    let on_side = |sign: f64, leaf: usize| {
        if side_of(leaf) * sign > 0.0 {
            0.0
        } else {
            f64::NEG_INFINITY
        }
    };
    let head = best(&|leaf| places[leaf].dot(tall) - side_of(leaf).abs())?;
    let mut bones = ClipBones::new();
    let mut hips = None;
    for (sign, arm, leg) in [
        (1.0, ["lUpper", "lFore", "lHand"], ["lThigh", "lShin", "lFoot"]),
        (-1.0, ["rUpper", "rFore", "rHand"], ["rThigh", "rShin", "rFoot"]),
    ] {
        let foot = best(&|leaf| on_side(sign, leaf) - places[leaf].dot(tall))?;
        let hand = best(&|leaf| on_side(sign, leaf) + side_of(leaf).abs() + 0.25 * places[leaf].dot(tall))?;
        for (leaf, ids) in [(foot, leg), (hand, arm)] {
            let path = way(leaf);
            let trunk = way(head);
            let shared = path.iter().zip(&trunk).take_while(|(a, b)| a == b).count();
            let first = two_longest(&path[shared..], &places)?;
            let chosen = path[shared..].iter().skip(first);
            ids.iter()
                .zip(chosen)
                .for_each(|(id, joint)| _ = bones.insert(id, *joint));
            if leaf == foot {
                hips = path.get(shared.checked_sub(1)?).copied();
            }
        }
    }
    bones.insert("pelvis", hips?);
    // The head's own joint has its end below it.
    joints[head].parent?;
    add_trunk(skeleton, Some(head), &mut bones);
    ["lShin", "rShin", "lFore", "rFore"]
        .iter()
        .all(|b| bones.contains_key(b))
        .then_some(bones)
}

/// Where the two bones begin that are longest together, one after the other.
fn two_longest(path: &[usize], places: &[DVec3]) -> Option<usize> {
    let length = |k: usize| places[path[k]].distance(places[path[k + 1]]);
    let starts = 0..path.len().checked_sub(2)?;
    let ranked = starts.map(|k| (length(k).min(length(k + 1)), k));
    ranked
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
        .map(|best| best.1)
}

/// The joints of a body; l is the figure's own left, which is +x for one that faces along +z.
pub const BODY_JOINTS: [&str; 24] = [
    "hips",
    "spine",
    "chest",
    "neck",
    "head",
    "headEnd",
    "lClav",
    "lShoulder",
    "lElbow",
    "lWrist",
    "lHandEnd",
    "rClav",
    "rShoulder",
    "rElbow",
    "rWrist",
    "rHandEnd",
    "lHip",
    "lKnee",
    "lAnkle",
    "lToe",
    "rHip",
    "rKnee",
    "rAnkle",
    "rToe",
];

/// A bone of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyBone {
    /// Its name.
    pub id: &'static str,
    /// The joint where it begins.
    pub from: &'static str,
    /// The joint where it ends.
    pub to: &'static str,
    /// The bone that it hangs on; empty for the root.
    pub parent: &'static str,
    /// The bone whose joint it points at; empty for none.
    pub aim: &'static str,
    /// How it stands in a clip's reference pose.
    pub rest: RestAttitude,
    /// Whether it is a limb, along which a twist is spread.
    pub is_limb: bool,
    /// Whether no clip may lack it.
    pub is_needed: bool,
}

const fn trunk(id: &'static str, from: &'static str, to: &'static str, parent: &'static str) -> BodyBone {
    BodyBone {
        id,
        from,
        to,
        parent,
        aim: "",
        rest: RestAttitude::Orientation,
        is_limb: false,
        is_needed: false,
    }
}

const fn limb([id, from, to, parent, aim]: [&'static str; 5]) -> BodyBone {
    BodyBone {
        aim,
        rest: RestAttitude::Direction,
        is_limb: true,
        is_needed: true,
        ..trunk(id, from, to, parent)
    }
}

const fn hand(id: &'static str, from: &'static str, to: &'static str, parent: &'static str) -> BodyBone {
    BodyBone {
        rest: RestAttitude::Parent,
        ..trunk(id, from, to, parent)
    }
}

/// The bones of a body, parents first.
pub const BODY_BONES: [BodyBone; 19] = [
    BodyBone {
        is_needed: true,
        ..trunk("pelvis", "hips", "spine", "")
    },
    trunk("abdomen", "spine", "chest", "pelvis"),
    trunk("chest", "chest", "neck", "abdomen"),
    trunk("neck", "neck", "head", "chest"),
    trunk("head", "head", "headEnd", "neck"),
    trunk("lClav", "lClav", "lShoulder", "chest"),
    limb(["lUpper", "lShoulder", "lElbow", "lClav", "lFore"]),
    limb(["lFore", "lElbow", "lWrist", "lUpper", "lHand"]),
    hand("lHand", "lWrist", "lHandEnd", "lFore"),
    trunk("rClav", "rClav", "rShoulder", "chest"),
    limb(["rUpper", "rShoulder", "rElbow", "rClav", "rFore"]),
    limb(["rFore", "rElbow", "rWrist", "rUpper", "rHand"]),
    hand("rHand", "rWrist", "rHandEnd", "rFore"),
    limb(["lThigh", "lHip", "lKnee", "pelvis", "lShin"]),
    limb(["lShin", "lKnee", "lAnkle", "lThigh", "lFoot"]),
    trunk("lFoot", "lAnkle", "lToe", "lShin"),
    limb(["rThigh", "rHip", "rKnee", "pelvis", "rShin"]),
    limb(["rShin", "rKnee", "rAnkle", "rThigh", "rFoot"]),
    trunk("rFoot", "rAnkle", "rToe", "rShin"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_reported_however_they_are_written() {
        for (name, side, rest) in [
            ("mixamorig:LeftUpLeg", 'l', "upleg"),
            ("RThumb", 'r', "thumb"),
            ("upper_arm.L", 'l', "upperarm"),
            ("Bip01 R Thigh", 'r', "thigh"),
            ("rightLowerArm", 'r', "lowerarm"),
            ("l_hand", 'l', "hand"),
            ("LowerBack", ' ', "lowerback"),
            ("Hips", ' ', "hips"),
            ("root", ' ', "root"),
            ("", ' ', ""),
        ] {
            assert_eq!(side_and_name(name), (side, rest.to_owned()), "{name}");
        }
    }

    #[test]
    fn every_bone_of_a_preset_is_reported() {
        for preset in ["cmu", "mixamo"] {
            let skeleton = preset_skeleton(preset).expect("a preset");
            let bones = bones_of_names(&skeleton).expect("bones");
            let missing: Vec<&str> = BODY_BONES
                .iter()
                .map(|b| b.id)
                .filter(|b| !bones.contains_key(b))
                .collect();
            assert!(missing.is_empty(), "{preset}: {missing:?}");
            assert_ne!(bones["lClav"], bones["lUpper"]);
        }
        let mut other = preset_skeleton("cmu").expect("a preset");
        other
            .joints
            .iter_mut()
            .for_each(|j| j.name = j.name.replace("LeftLeg", "pipe"));
        let reported = bones_of_names(&other).expect_err("refused").to_string();
        assert!(
            reported.contains("\"lShin\"") && reported.contains("such as \"leg\""),
            "{reported}"
        );
    }
}

#[cfg(test)]
mod shape_bones_tests {
    use super::*;
    use crate::skeleton::{JointPose, SkeletonJoint};

    #[test]
    fn a_figure_without_names_is_reported_by_its_branches() {
        let mut joints: Vec<SkeletonJoint> = Vec::new();
        let mut add = |parent: Option<usize>, x: f64, y: f64| {
            joints.push(SkeletonJoint {
                name: String::new(),
                parent,
                rest: JointPose::at(DVec3::new(x, y, 0.0)),
            });
            joints.len() - 1
        };
        let hips = add(None, 0.0, 10.0);
        let spine = add(Some(hips), 0.0, 3.0);
        let chest = add(Some(spine), 0.0, 3.0);
        let neck = add(Some(chest), 0.0, 2.0);
        add(Some(neck), 0.0, 2.0);
        let mut expected = Vec::new();
        for (sign, ids) in [
            (1.0, ["lUpper", "lFore", "lThigh", "lShin"]),
            (-1.0, ["rUpper", "rFore", "rThigh", "rShin"]),
        ] {
            let collar = add(Some(chest), 0.5 * sign, 1.5);
            let upper = add(Some(collar), 1.0 * sign, 0.0);
            let fore = add(Some(upper), 3.0 * sign, 0.0);
            let hand = add(Some(fore), 3.0 * sign, 0.0);
            add(Some(hand), 1.0 * sign, 0.0);
            let thigh = add(Some(hips), 1.0 * sign, -0.5);
            let shin = add(Some(thigh), 0.0, -4.5);
            let foot = add(Some(shin), 0.0, -4.5);
            add(Some(foot), 0.0, -0.4);
            expected.extend(ids.into_iter().zip([upper, fore, thigh, shin]));
        }
        let bones = bones_of_shape(&Skeleton { joints }).expect("a figure");
        for (bone, joint) in expected {
            assert_eq!(bones[bone], joint, "{bone}");
        }
        assert_eq!((bones["pelvis"], bones["chest"]), (hips, chest));
        let one = Skeleton {
            joints: vec![SkeletonJoint {
                name: String::new(),
                parent: None,
                rest: JointPose::at(DVec3::ZERO),
            }],
        };
        assert!(bones_of_shape(&one).is_none());
    }
}
