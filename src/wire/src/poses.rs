//! Poses as messages and as values of the engine, and what a client sends along a deform stream.

use super::check::vector;
use super::guides::{guide_pose, guide_pose_message};
use super::options::DeformOptions;
use super::vertex_targets::{vertex_targets, vertex_targets_message};
use super::{Error, pb};
use glam::{DQuat, DVec3};
use pliant_core::engine::{Deformer, HandlePose, HandlePoses, HandleRotation, HandleScale};
use prost::Message as _;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Returns `poses` with those that a message names replaced.
///
/// # Errors
/// [`Error::Precondition`] without handles, [`Error::Invalid`] with the field.
pub fn change_poses(deformer: &Deformer, poses: &HandlePoses, change: &pb::Pose) -> Result<HandlePoses, Error> {
    let changes = pose_changes(change)?;
    deformer.change_poses(poses, changes.iter().map(|(id, pose)| (id.as_str(), pose.clone())))
}

/// Reads the poses that a message names, by handle.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn pose_changes(message: &pb::Pose) -> Result<Vec<(String, HandlePose)>, Error> {
    let change = |(id, pose): (String, Result<HandlePose, Error>)| Ok((id, pose?));
    pose_entries(message).into_iter().map(change).collect()
}

/// Reads the handles that a pose names, each with its pose, or with the error that is reported later; the default is the rest
/// pose. An entry that names a handle again is an error.
pub(super) fn pose_entries(pose: &pb::Pose) -> Vec<(String, Result<HandlePose, Error>)> {
    let mut named: BTreeMap<&str, usize> = BTreeMap::new();
    let mut entries = Vec::with_capacity(pose.handles.len());
    for (k, entry) in pose.handles.iter().enumerate() {
        let pose = match (named.insert(&entry.id, k), &entry.pose) {
            (Some(before), _) => {
                let problem = format!("names the handle of handles[{before}] again; each handle has one pose");
                Err(Error::invalid(format!("pose.handles[{k}].id"), problem))
            }
            (None, Some(pose)) => handle_pose(pose, &format!("pose.handles[{k}].pose")),
            (None, None) => Ok(HandlePose::default()),
        };
        entries.push((entry.id.clone(), pose));
    }
    entries
}

/// Refuses a pose of more than `max_entries` entries, and entries that are too large to be right.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub(super) fn check_pose_size(pose: &pb::Pose, max_entries: usize) -> Result<(), Error> {
    if pose.handles.len() > max_entries {
        let problem = format!("has {} entries, at most {max_entries} are allowed", pose.handles.len());
        return Err(Error::invalid("pose.handles", problem));
    }
    for (k, entry) in pose.handles.iter().enumerate() {
        if entry.id.len() > 128 {
            let problem = "is longer than the 128 bytes of any handle";
            return Err(Error::invalid(format!("pose.handles[{k}].id"), problem));
        }
        let Some(p) = &entry.pose else { continue };
        let lists = [
            ("translation", &p.translation),
            ("rotation", &p.rotation),
            ("rotationVector", &p.rotation_vector),
            ("scale", &p.scale),
            ("pivot", &p.pivot),
        ];
        if let Some((name, list)) = lists.into_iter().find(|(_, list)| list.len() > 4) {
            let field = format!("pose.handles[{k}].pose.{name}");
            let problem = format!("has {} numbers, at most 4 are allowed", list.len());
            return Err(Error::invalid(field, problem));
        }
    }
    Ok(())
}

/// Reads the pose of a handle.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`.
pub fn handle_pose(pose: &pb::HandlePose, field: &str) -> Result<HandlePose, Error> {
    let optional = |values: &[f64], name: &str| match values {
        [] => Ok(None),
        values => vector(values, &format!("{field}.{name}")).map(Some),
    };
    let translation = optional(&pose.translation, "translation")?;
    let pivot = optional(&pose.pivot, "pivot")?;
    let turned = optional(&pose.rotation_vector, "rotationVector")?;
    if turned.is_some_and(|v| v.length() > 1e6) {
        return Err(Error::invalid(
            format!("{field}.rotationVector"),
            "is longer than 1e6 radians",
        ));
    }
    let rotation = match (quaternion(&pose.rotation, &format!("{field}.rotation"))?, turned) {
        (Some(_), Some(_)) => {
            return Err(Error::invalid(
                field,
                "has both rotation and rotationVector, only one of them is allowed",
            ));
        }
        (Some(q), None) => Some(HandleRotation::Quaternion(q)),
        (None, v) => v.map(HandleRotation::Vector),
    };
    Ok(HandlePose {
        translation,
        rotation,
        free_rotation: pose.free_rotation,
        scale: scale(&pose.scale, &format!("{field}.scale"))?,
        pivot,
        targets: (pose.targets.as_ref())
            .map(|targets| vertex_targets(targets, &format!("{field}.targets")).map(Arc::new))
            .transpose()?,
        guide: (pose.guide.as_ref())
            .map(|shape| guide_pose(shape, &format!("{field}.guide")).map(Arc::new))
            .transpose()?,
    })
}

/// Writes the pose of a handle; numbers are as they were read.
pub fn handle_pose_message(pose: &HandlePose) -> pb::HandlePose {
    let vector = |v: Option<DVec3>| v.map_or_else(Vec::new, |v| v.to_array().to_vec());
    let (rotation, rotation_vector) = match pose.rotation {
        None => Default::default(),
        Some(HandleRotation::Quaternion(q)) => (q.to_array().to_vec(), Vec::new()),
        Some(HandleRotation::Vector(v)) => (Vec::new(), v.to_array().to_vec()),
    };
    pb::HandlePose {
        translation: vector(pose.translation),
        rotation,
        rotation_vector,
        scale: match pose.scale {
            None => Vec::new(),
            Some(HandleScale::Uniform(s)) => vec![s],
            Some(HandleScale::PerAxis(s)) => s.to_array().to_vec(),
        },
        pivot: vector(pose.pivot),
        free_rotation: pose.free_rotation,
        targets: pose.targets.as_deref().map(vertex_targets_message),
        guide: pose.guide.as_deref().map(guide_pose_message),
    }
}

fn quaternion(values: &[f64], field: &str) -> Result<Option<DQuat>, Error> {
    if values.is_empty() {
        return Ok(None);
    }
    let [x, y, z, w] = values else {
        let problem = format!("has {} numbers, a quaternion has 4 [x, y, z, w]", values.len());
        return Err(Error::invalid(field, problem));
    };
    let q = DQuat::from_xyzw(*x, *y, *z, *w);
    let length = q.length();
    if !(0.99..=1.01).contains(&length) {
        let problem = format!("has length {length}, a rotation needs a unit quaternion [x, y, z, w]");
        return Err(Error::invalid(field, problem));
    }
    Ok(Some(q))
}

fn scale(values: &[f64], field: &str) -> Result<Option<HandleScale>, Error> {
    for (k, s) in values.iter().enumerate().filter(|_| matches!(values.len(), 1 | 3)) {
        if !(1e-6..=1e6).contains(s) {
            let place = if values.len() == 1 {
                field.to_owned()
            } else {
                format!("{field}[{k}]")
            };
            return Err(Error::invalid(place, format!("is {s}, allowed are 1e-6 to 1e6")));
        }
    }
    match values {
        [] => Ok(None),
        [s] => Ok(Some(HandleScale::Uniform(*s))),
        [x, y, z] => Ok(Some(HandleScale::PerAxis(DVec3::new(*x, *y, *z)))),
        more => {
            let problem = format!("has {} numbers, allowed are 1 or 3", more.len());
            Err(Error::invalid(field, problem))
        }
    }
}

/// The handle that a pose of a stream names, and its pose or what is wrong with that.
pub type NamedPose = (String, Result<HandlePose, Error>);

/// One request of a deform stream. It contains its error: the stream reports it when its turn comes.
#[derive(Debug, Clone, PartialEq)]
pub enum StreamRequest {
    /// The options from now on.
    Options(Result<DeformOptions, Error>),
    /// A pose to solve.
    Pose {
        /// Its number; numbers grow along a stream.
        seq: u64,
        /// Whether it is to be committed.
        commit: bool,
        /// Whether it is a part of the next pose, and not solved alone.
        more: bool,
        /// Identifies a commit that is sent again.
        key: Option<PoseKey>,
        /// The handles that it names, each with its pose or what is wrong with that.
        entries: Result<Vec<NamedPose>, Error>,
    },
    /// The client has the frames up to this number.
    Ack(u64),
    /// A ping; the answer has the same number.
    Ping(u64),
}

/// The idempotency key of a commit on a stream. The same key with other handles is a mistake of the caller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PoseKey {
    /// The key.
    pub key: String,
    /// The handles as the client sent them.
    pub request: Vec<u8>,
}

/// How large the requests of a stream may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamLimits {
    /// The largest window of unacknowledged frames.
    pub window: u32,
    /// The most handles that a pose may name.
    pub pose_entries: usize,
}

/// Reads a request of a stream; `None` for a message that asks for nothing.
pub fn stream_request(request: &pb::DeformRequest, limits: StreamLimits) -> Option<StreamRequest> {
    use pb::deform_request::Message;
    Some(match request.message.as_ref()? {
        Message::Options(options) => StreamRequest::Options(DeformOptions::check(options, "options", limits.window)),
        Message::Pose(pose) => stream_pose(pose, limits),
        Message::Ack(ack) => StreamRequest::Ack(ack.seq),
        Message::Ping(ping) => StreamRequest::Ping(ping.nonce),
    })
}

fn stream_pose(pose: &pb::Pose, limits: StreamLimits) -> StreamRequest {
    let checked = check_pose_size(pose, limits.pose_entries).and_then(|()| {
        if pose.commit && pose.more {
            let problem = "stands on a commit; the last part of a pose is the one that is committed";
            return Err(Error::invalid("pose.more", problem));
        }
        pose_key(pose)
    });
    let (entries, key) = match checked {
        Ok(key) => (Ok(pose_entries(pose)), key),
        Err(error) => (Err(error), None),
    };
    StreamRequest::Pose {
        seq: pose.seq,
        commit: pose.commit,
        more: pose.more,
        key,
        entries,
    }
}

/// The longest key.
const KEY_BYTES: usize = 255;

fn pose_key(pose: &pb::Pose) -> Result<Option<PoseKey>, Error> {
    let key = pose.idempotency_key.as_str();
    if key.is_empty() {
        return Ok(None);
    }
    let wrong = |problem: &str| Err(Error::invalid("pose.idempotencyKey", problem));
    if !pose.commit {
        return wrong("stands on a pose that is not committed; only a commit has a key");
    }
    if key.len() > KEY_BYTES || !key.bytes().all(|b| b.is_ascii_graphic()) {
        return wrong("is not a key; 1 to 255 visible ASCII characters are allowed");
    }
    let handles = pb::Pose {
        handles: pose.handles.clone(),
        ..pb::Pose::default()
    };
    Ok(Some(PoseKey {
        key: key.to_owned(),
        request: handles.encode_to_vec(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_poses_are_refused_with_their_field() {
        let refused = |pose: pb::HandlePose, field: &str| match handle_pose(&pose, "p") {
            Err(Error::Invalid { field: f, .. }) => assert_eq!(f, field),
            other => panic!("{field}: {other:?}"),
        };
        let pose = pb::HandlePose::default;
        refused(
            pb::HandlePose {
                translation: vec![1.0],
                ..pose()
            },
            "p.translation",
        );
        refused(
            pb::HandlePose {
                translation: vec![1.0, f64::NAN, 0.0],
                ..pose()
            },
            "p.translation[1]",
        );
        refused(
            pb::HandlePose {
                rotation: vec![0.0, 0.0, 0.0, 2.0],
                ..pose()
            },
            "p.rotation",
        );
        refused(
            pb::HandlePose {
                rotation: vec![f64::NAN, 0.0, 0.0, 1.0],
                ..pose()
            },
            "p.rotation",
        );
        refused(
            pb::HandlePose {
                scale: vec![1.0, 2.0],
                ..pose()
            },
            "p.scale",
        );
        refused(
            pb::HandlePose {
                scale: vec![0.0],
                ..pose()
            },
            "p.scale",
        );
        refused(
            pb::HandlePose {
                scale: vec![1.0, -1.0, 1.0],
                ..pose()
            },
            "p.scale[1]",
        );
        let both = pb::HandlePose {
            rotation: vec![0., 0., 0., 1.],
            rotation_vector: vec![0., 0., 0.],
            ..pose()
        };
        refused(both, "p");
    }
}

#[cfg(test)]
mod stream_tests {
    use super::*;

    const LIMITS: StreamLimits = StreamLimits {
        window: 8,
        pose_entries: 2,
    };

    type Entries = Vec<(String, Result<HandlePose, Error>)>;

    fn entries(handles: Vec<pb::pose::Entry>) -> Result<Entries, Error> {
        let pose = pb::Pose {
            seq: 3,
            handles,
            commit: true,
            ..Default::default()
        };
        let request = pb::DeformRequest {
            session_id: String::new(),
            message: Some(pb::deform_request::Message::Pose(pose)),
        };
        match stream_request(&request, LIMITS) {
            Some(StreamRequest::Pose {
                seq: 3,
                commit: true,
                entries,
                ..
            }) => entries,
            other => panic!("a pose was expected, not {other:?}"),
        }
    }

    fn entry(id: &str, scale: &[f64]) -> pb::pose::Entry {
        pb::pose::Entry {
            id: id.into(),
            pose: Some(pb::HandlePose {
                scale: scale.to_vec(),
                ..Default::default()
            }),
        }
    }

    #[test]
    fn a_wrong_entry_leaves_the_others_right() {
        let read = entries(vec![entry("a", &[2.0]), entry("b", &[0.0])]).expect("small enough");
        assert!(read[0].1.is_ok());
        let wrong = read[1].1.clone().expect_err("no scale");
        assert!(matches!(wrong, Error::Invalid { field, .. } if field == "pose.handles[1].pose.scale"));
    }

    #[test]
    fn what_is_too_large_is_refused_as_a_whole() {
        let long = "x".repeat(129);
        for (handles, field) in [
            (vec![entry("a", &[]), entry("b", &[]), entry("c", &[])], "pose.handles"),
            (vec![entry("a", &[]), entry(&long, &[])], "pose.handles[1].id"),
            (vec![entry("a", &[1.0; 5])], "pose.handles[0].pose.scale"),
        ] {
            let refused = entries(handles).expect_err(field);
            assert!(
                matches!(refused, Error::Invalid { field: f, .. } if f == field),
                "{field}"
            );
        }
    }

    #[test]
    fn a_message_without_content_asks_for_nothing() {
        assert_eq!(stream_request(&pb::DeformRequest::default(), LIMITS), None);
    }
}
