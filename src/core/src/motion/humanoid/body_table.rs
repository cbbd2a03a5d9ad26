//! The joints and bones of a body.

use crate::motion::rig::RestAttitude;

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
