//! Rigs of messages and files.

use super::check::{enumerated, number, points};
use super::{Error, json, pb};
use glam::DVec3;
use pliant_motion::SignedAxis;
use pliant_motion::rig::{MotionRig, ReferencePose, RestAttitude, RigBone};
use serde_json::{Value, json};

/// The version of rigs that this program reads.
const VERSION: u32 = 1;
/// The most joints of a rig.
const MOST_JOINTS: usize = 4096;
/// From where to where rotations are held along a long bone, and along one shorter than twice its radius.
const SPANS: [[f64; 2]; 2] = [[0.15, 0.85], [0.3, 0.7]];

/// Reads a rig from JSON. A joint may be a list of three numbers, and the reference pose an object
/// `{"frame": 0}` or `{"rest": true}`, which is shorter to write by hand.
///
/// # Errors
/// [`Error::Malformed`] and [`Error::Invalid`] with the field.
pub fn rig_from_json(text: &[u8]) -> Result<MotionRig, Error> {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    // Bytes that are not JSON are refused by the reader that names the place.
    let rig: pb::Rig = match serde_json::from_slice::<Value>(text) {
        Ok(mut value) => {
            spell_out(&mut value);
            json::from_json(value.to_string().as_bytes())?
        }
        Err(_) => json::from_json(text)?,
    };
    motion_rig(&rig)
}

/// Writes short forms as the schema has them.
pub(super) fn spell_out(rig: &mut Value) {
    let Some(rig) = rig.as_object_mut() else { return };
    if let Some(Value::Object(joints)) = rig.get_mut("joints") {
        for place in joints.values_mut().filter(|place| place.is_array()) {
            *place = json!({ "at": place.take() });
        }
    }
    if let Some(Value::Object(reference)) = rig.get("reference") {
        match (reference.get("frame").cloned(), reference.get("rest")) {
            (Some(frame), None) => {
                rig.remove("reference");
                rig.insert("referenceFrame".into(), frame);
            }
            (None, Some(Value::Bool(true))) => {
                rig.remove("reference");
            }
            _ => {}
        }
    }
}

/// Reads a rig.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn motion_rig(rig: &pb::Rig) -> Result<MotionRig, Error> {
    if rig.version != VERSION {
        let problem = format!("is {}, this program reads version {VERSION}", rig.version);
        return Err(Error::invalid("version", problem));
    }
    if rig.joints.len() > MOST_JOINTS {
        let problem = format!("has {} entries, at most {MOST_JOINTS} are allowed", rig.joints.len());
        return Err(Error::invalid("joints", problem));
    }
    let mut bones = Vec::with_capacity(rig.bones.len().min(MotionRig::MOST_BONES));
    let mut parents = Vec::with_capacity(bones.capacity());
    for (k, bone) in rig.bones.iter().enumerate().take(MotionRig::MOST_BONES + 1) {
        bones.push(rig_bone(rig, bone, &format!("bones[{k}]"))?);
        parents.push((!bone.parent.is_empty()).then(|| bone.parent.clone()));
    }
    let reference = match rig.reference_frame {
        None => ReferencePose::Rest,
        Some(frame) => ReferencePose::Frame(frame as usize),
    };
    let scale = if rig.scale == 0.0 { None } else { Some(rig.scale) };
    let up = match rig.up.as_str() {
        "" => SignedAxis::Y,
        name => SignedAxis::named(name).ok_or_else(|| {
            let problem = format!("is \"{name}\", allowed are {}", SignedAxis::NAMES.join(", "));
            Error::invalid("up", problem)
        })?,
    };
    let rig = MotionRig::from_named_parents(bones, &parents, reference, scale)?;
    Ok(MotionRig { up, ..rig })
}

fn rig_bone(rig: &pb::Rig, bone: &pb::rig::Bone, at: &str) -> Result<RigBone, Error> {
    let place = |name: &str, field: &str| -> Result<DVec3, Error> {
        let Some(joint) = rig.joints.get(name) else {
            let problem = format!("is \"{name}\", the rig's joints have no such name");
            return Err(Error::invalid(format!("{at}.{field}"), problem));
        };
        let field = format!("joints.{name}");
        let three = |count: usize| format!("has {count} numbers, x, y and z are needed");
        let read = points(&joint.at, 1..=1, &field, three)?;
        Ok(read[0])
    };
    let (from, to) = (place(&bone.from, "from")?, place(&bone.to, "to")?);
    let rest = match enumerated::<pb::rig::Rest>(bone.rest, &format!("{at}.rest"))? {
        pb::rig::Rest::Unspecified | pb::rig::Rest::Direction => RestAttitude::Direction,
        pb::rig::Rest::Orientation => RestAttitude::Orientation,
        pb::rig::Rest::Parent => RestAttitude::Parent,
    };
    let span = match bone.span[..] {
        [] => SPANS[usize::from(from.distance(to) < 2.0 * bone.radius)],
        [low, high] => [low, high],
        _ => {
            let problem = format!("has {} numbers, two shares of the length are needed", bone.span.len());
            return Err(Error::invalid(format!("{at}.span"), problem));
        }
    };
    let optional = |value: f64, field: &str| -> Result<Option<f64>, Error> {
        number(value, &format!("{at}.{field}"))?;
        Ok((value != 0.0).then_some(value))
    };
    Ok(RigBone {
        id: bone.id.clone(),
        parent: None,
        from,
        to,
        joint: bone.joint.clone(),
        aim: (!bone.aim.is_empty()).then(|| bone.aim.clone()),
        rest,
        radius: bone.radius,
        slices: bone.slices.max(1) as usize,
        span,
        joint_radius: optional(bone.joint_radius, "jointRadius")?,
        limit_degrees: optional(bone.limit_degrees, "limitDegrees")?,
    })
}

/// Spells a rig as the schema has it. `names` are joints with a name of their own; others are called as the bone that begins
/// there, or ends.
pub fn rig_message(rig: &MotionRig, names: &[(&str, DVec3)], model: &str) -> pb::Rig {
    let mut message = pb::Rig {
        version: VERSION,
        reference_frame: match rig.reference {
            ReferencePose::Rest => None,
            ReferencePose::Frame(frame) => Some(u32::try_from(frame).unwrap_or(u32::MAX)),
        },
        scale: rig.scale.unwrap_or_default(),
        model: model.to_owned(),
        up: match rig.up {
            SignedAxis::Y => String::new(),
            up => up.name().to_owned(),
        },
        ..Default::default()
    };
    let begins = rig.bones.iter().map(|bone| (bone.id.as_str(), bone.from));
    let known: Vec<(&str, DVec3)> = names.iter().copied().chain(begins).collect();
    for bone in &rig.bones {
        let mut joint = |at: DVec3, other: String| {
            let name = known.iter().find(|k| k.1 == at).map_or(other, |k| k.0.to_owned());
            let place = pb::rig::Joint {
                at: at.to_array().to_vec(),
            };
            message.joints.insert(name.clone(), place);
            name
        };
        let (from, to) = (
            joint(bone.from, bone.id.clone()),
            joint(bone.to, format!("{} end", bone.id)),
        );
        let rest = match bone.rest {
            RestAttitude::Direction => pb::rig::Rest::Direction,
            RestAttitude::Orientation => pb::rig::Rest::Orientation,
            RestAttitude::Parent => pb::rig::Rest::Parent,
        };
        message.bones.push(pb::rig::Bone {
            id: bone.id.clone(),
            from,
            to,
            parent: bone.parent.map_or_else(String::new, |p| rig.bones[p].id.clone()),
            joint: bone.joint.clone(),
            aim: bone.aim.clone().unwrap_or_default(),
            rest: rest.into(),
            radius: bone.radius,
            slices: bone.slices as u32,
            span: bone.span.to_vec(),
            joint_radius: bone.joint_radius.unwrap_or_default(),
            limit_degrees: bone.limit_degrees.unwrap_or_default(),
        });
    }
    message
}
