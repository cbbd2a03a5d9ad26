//! What the calls of a manager take and answer. The server makes messages of the answers.

use crate::error::Error;
use bytes::Bytes;
use glam::DVec3;
use pliant_asset::{Format, WrittenFiles};
use pliant_wire::frames::Frame;
use pliant_wire::{AnimationSummary, pb};
use std::sync::Arc;

/// A tenant. Its sessions do not exist for another.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tenant(pub Arc<str>);

impl Default for Tenant {
    fn default() -> Self {
        Self(Arc::from("default"))
    }
}

/// Whose work it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct WorkOwner {
    pub tenant: Tenant,
    /// Empty for sessions that are being opened: those of one tenant share a line.
    pub session: String,
}

/// An answer, and whether it was given before.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyedAnswer<T> {
    /// The answer.
    pub value: T,
    /// True when an earlier call with the same idempotency key got it and this call did nothing.
    pub repeated: bool,
}

/// The idempotency key of a call, and the bytes of its request: the server rejects the same key with other bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CallKey {
    /// The key.
    pub key: String,
    /// The request as the client sent it.
    pub request: Vec<u8>,
}

/// A page of a tenant's sessions, oldest first.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionList {
    /// The sessions.
    pub sessions: Vec<pb::Session>,
    /// The next page begins after the session with this number; `None` on the last page.
    pub next_after: Option<u64>,
}

/// A pose solved and committed.
#[derive(Debug, Clone)]
pub struct CommittedPose {
    /// Its frame, not encoded yet.
    pub frame: Frame,
    /// The session's revision.
    pub revision: u64,
    /// Digest of the positions.
    pub digest: String,
}

/// An answer of a deform stream.
#[derive(Debug, Clone)]
pub enum StreamAnswer {
    /// A frame, not encoded yet.
    Frame(Box<Frame>),
    /// What is wrong with the pose of this number; with 0, why the stream ends.
    Failure {
        /// What is wrong.
        error: Error,
        /// The pose, or 0.
        seq: u64,
    },
    /// Something that the client should know.
    Notice {
        /// A stable kebab-case code.
        code: &'static str,
        /// What it is, for people.
        message: &'static str,
        /// The session to continue.
        session: String,
    },
    /// The answer to a ping with this number.
    Pong(u64),
}

/// An answer of an animation.
#[derive(Debug, Clone)]
pub enum AnimationAnswer {
    /// What is under way before the first frame.
    Stage {
        /// Its name.
        stage: &'static str,
        /// How much of it is done, from 0 to 1.
        fraction: f32,
    },
    /// A frame, not encoded yet.
    Frame(Box<Frame>),
    /// All frames have come.
    Summary(Box<AnimationSummary>),
}

/// An animation as a model that plays it.
#[derive(Debug, Clone)]
pub struct AnimatedModel {
    /// The GLB.
    pub model: Bytes,
    /// The summary of its frames.
    pub summary: AnimationSummary,
}

/// A model in its current shape.
#[derive(Debug, Clone)]
pub struct ExportedModel {
    /// The files.
    pub written: WrittenFiles,
    /// Their format.
    pub format: Format,
    /// Strong entity tag, with its quotes.
    pub etag: String,
}

/// A model with what came to it from another one.
#[derive(Debug, Clone)]
pub struct TransferredModel {
    /// Its files.
    pub model: ExportedModel,
    /// What came.
    pub report: pb::TransferReport,
}

/// The current vertex buffer.
#[derive(Debug, Clone)]
pub struct PositionBuffer {
    /// Little-endian 32-bit floats, x, y, z per render vertex.
    pub bytes: Bytes,
    /// What they are relative to; zero but for models far from the origin.
    pub origin: DVec3,
    /// Strong entity tag, with its quotes.
    pub etag: String,
}
