//! Rigs that are made of a session's model: the checked request, and the answer.

use super::check::points;
use super::rig::rig_message;
use super::{Error, pb};
use glam::DVec3;
use pb::make_rig_request::Source;
use pliant_core::engine::MadeRig;
use pliant_motion::SignedAxis;
use pliant_motion::humanoid::BODY_JOINTS;
use prost::bytes::Bytes;
use std::collections::BTreeMap;

/// What a rig is to be made for. Made by [`make_rig_order`].
#[derive(Debug, Clone, Default)]
pub struct MakeRigOrder {
    /// A BVH file.
    pub bvh: Option<Bytes>,
    /// Without it, whose names joints have.
    pub preset: Option<String>,
    /// Places of joints.
    pub landmarks: BTreeMap<&'static str, DVec3>,
    /// From a figure's feet to its head.
    pub up: Option<SignedAxis>,
    /// Where it faces.
    pub front: Option<SignedAxis>,
}

/// Reads a request for a rig.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn make_rig_order(request: &pb::MakeRigRequest) -> Result<MakeRigOrder, Error> {
    let mut landmarks = BTreeMap::new();
    for (name, place) in &request.joints {
        let field = format!("joints.{name}");
        let Some(known) = BODY_JOINTS.iter().find(|own| *own == name) else {
            let problem = format!("is not a joint of a body; there are {}", BODY_JOINTS.join(", "));
            return Err(Error::invalid(field, problem));
        };
        let three = |count: usize| format!("has {count} numbers, x, y and z are needed");
        landmarks.insert(*known, points(&place.at, 1..=1, &field, three)?[0]);
    }
    let (up, front) = (axis(&request.up, "up")?, axis(&request.front, "front")?);
    if let (Some(up), Some(front)) = (up, front)
        && up.direction().dot(front.direction()) != 0.0
    {
        let problem = format!("is {}, the axis of up; a figure faces along another one", front.name());
        return Err(Error::invalid("front", problem));
    }
    let (bvh, preset) = match request.source.clone() {
        Some(Source::Bvh(bytes)) => (Some(bytes), None),
        Some(Source::Preset(name)) => (None, Some(name)),
        None => (None, None),
    };
    Ok(MakeRigOrder {
        bvh,
        preset,
        landmarks,
        up,
        front,
    })
}

fn axis(name: &str, field: &str) -> Result<Option<SignedAxis>, Error> {
    let unknown = || {
        let problem = format!("is \"{name}\", allowed are {}", SignedAxis::NAMES.join(", "));
        Error::invalid(field, problem)
    };
    match name {
        "" => Ok(None),
        name => SignedAxis::named(name).ok_or_else(unknown).map(Some),
    }
}

/// Writes a rig that was made.
pub fn made_rig_message(made: &MadeRig) -> pb::MakeRigResponse {
    let joints = made.joints.iter().map(|joint| pb::make_rig_response::Joint {
        name: joint.name.clone(),
        at: joint.at.to_array().to_vec(),
        score: joint.score,
        reason: joint.reason.clone(),
        doubtful: MadeRig::is_doubtful(joint),
        inside: joint.inside,
    });
    let names: Vec<(&str, DVec3)> = made.joints.iter().map(|j| (j.name.as_str(), j.at)).collect();
    let name = |axis: SignedAxis| axis.name().to_owned();
    pb::MakeRigResponse {
        rig: Some(rig_message(&made.rig, &names, "")),
        joints: joints.collect(),
        source: made.source.to_owned(),
        up: made.axes.map(|axes| name(axes.up)).unwrap_or_default(),
        front: made.axes.map(|axes| name(axes.front)).unwrap_or_default(),
        warnings: made.warnings.clone(),
    }
}
