//! Which joints of a clip turn the bones of a body, by their names.

use super::body_table::BODY_BONES;
use crate::motion::rig::{RigError, listed_names};
use crate::motion::skeleton::{JointPose, Skeleton, SkeletonJoint};
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
    let above = |joint: usize| {
        let up = std::iter::successors(Some(joint), |j| skeleton.joints[*j].parent);
        let mut path: Vec<usize> = up.collect();
        path.reverse();
        path
    };
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

/// A skeleton with the names of a preset, so that a rig can be made where no clip is at hand. `None` for another name; there
/// are `cmu` and `mixamo`.
pub fn preset_skeleton(name: &str) -> Option<Skeleton> {
    let rows: &[(&str, &str)] = match name {
        "cmu" => &[
            ("Hips", ""),
            ("LeftUpLeg", "Hips"),
            ("LeftLeg", "LeftUpLeg"),
            ("LeftFoot", "LeftLeg"),
            ("RightUpLeg", "Hips"),
            ("RightLeg", "RightUpLeg"),
            ("RightFoot", "RightLeg"),
            ("LowerBack", "Hips"),
            ("Spine", "LowerBack"),
            ("Spine1", "Spine"),
            ("Neck", "Spine1"),
            ("Neck1", "Neck"),
            ("Head", "Neck1"),
            ("LeftShoulder", "Spine1"),
            ("LeftArm", "LeftShoulder"),
            ("LeftForeArm", "LeftArm"),
            ("LeftHand", "LeftForeArm"),
            ("RightShoulder", "Spine1"),
            ("RightArm", "RightShoulder"),
            ("RightForeArm", "RightArm"),
            ("RightHand", "RightForeArm"),
        ],
        "mixamo" => &[
            ("mixamorig:Hips", ""),
            ("mixamorig:Spine", "mixamorig:Hips"),
            ("mixamorig:Spine1", "mixamorig:Spine"),
            ("mixamorig:Spine2", "mixamorig:Spine1"),
            ("mixamorig:Neck", "mixamorig:Spine2"),
            ("mixamorig:Head", "mixamorig:Neck"),
            ("mixamorig:LeftShoulder", "mixamorig:Spine2"),
            ("mixamorig:LeftArm", "mixamorig:LeftShoulder"),
            ("mixamorig:LeftForeArm", "mixamorig:LeftArm"),
            ("mixamorig:LeftHand", "mixamorig:LeftForeArm"),
            ("mixamorig:RightShoulder", "mixamorig:Spine2"),
            ("mixamorig:RightArm", "mixamorig:RightShoulder"),
            ("mixamorig:RightForeArm", "mixamorig:RightArm"),
            ("mixamorig:RightHand", "mixamorig:RightForeArm"),
            ("mixamorig:LeftUpLeg", "mixamorig:Hips"),
            ("mixamorig:LeftLeg", "mixamorig:LeftUpLeg"),
            ("mixamorig:LeftFoot", "mixamorig:LeftLeg"),
            ("mixamorig:RightUpLeg", "mixamorig:Hips"),
            ("mixamorig:RightLeg", "mixamorig:RightUpLeg"),
            ("mixamorig:RightFoot", "mixamorig:RightLeg"),
        ],
        _ => return None,
    };
    let joint = |(name, parent): &(&str, &str)| SkeletonJoint {
        name: (*name).to_owned(),
        parent: rows.iter().position(|row| row.0 == *parent),
        rest: JointPose::at(glam::DVec3::ZERO),
    };
    Some(Skeleton {
        joints: rows.iter().map(joint).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_told_however_they_are_written() {
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
    fn every_bone_of_a_preset_is_told() {
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
        let told = bones_of_names(&other).expect_err("refused").to_string();
        assert!(told.contains("\"lShin\"") && told.contains("such as \"leg\""), "{told}");
    }
}
