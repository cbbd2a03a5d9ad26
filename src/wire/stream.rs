//! What a client sends along a deform stream.

use super::options::DeformOptions;
use super::poses::{check_pose_size, pose_entries};
use super::{Error, pb};
use crate::engine::HandlePose;
use prost::Message as _;

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
        /// Identifies a commit that is sent again.
        key: Option<PoseKey>,
        /// The handles that it names, each with its pose or what is wrong with that.
        entries: Result<Vec<(String, Result<HandlePose, Error>)>, Error>,
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
    let checked = check_pose_size(pose, limits.pose_entries).and_then(|()| pose_key(pose));
    let (entries, key) = match checked {
        Ok(key) => (Ok(pose_entries(pose)), key),
        Err(error) => (Err(error), None),
    };
    StreamRequest::Pose {
        seq: pose.seq,
        commit: pose.commit,
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
            idempotency_key: String::new(),
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
