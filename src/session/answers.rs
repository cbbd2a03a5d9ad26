//! What the calls of a manager answer, beside the messages of the schema.

use crate::asset::{Format, WrittenFiles};
use crate::wire::pb;
use bytes::Bytes;
use glam::DVec3;
use std::sync::Arc;

/// Who asks. Sessions of one tenant do not exist for another.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tenant(pub Arc<str>);

impl Default for Tenant {
    fn default() -> Self {
        Self(Arc::from("default"))
    }
}

/// An answer, and whether it was given before.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer<T> {
    /// The answer.
    pub value: T,
    /// True when an earlier call with the same idempotency key got it first and nothing was done now.
    pub repeated: bool,
}

/// A committed pose.
#[derive(Debug, Clone)]
pub struct SolvedFrames {
    /// The frame in parts.
    pub frames: Vec<pb::Frame>,
    /// The session's revision.
    pub revision: u64,
    /// One per render vertex, model space.
    pub positions: Arc<Vec<DVec3>>,
    /// Digest of `positions`.
    pub digest: String,
}

/// A model in its current shape.
#[derive(Debug, Clone)]
pub struct Exported {
    /// The files.
    pub written: WrittenFiles,
    /// Their format.
    pub format: Format,
    /// Strong entity tag, with its quotes.
    pub etag: String,
}

/// The current vertex buffer.
#[derive(Debug, Clone)]
pub struct Positions {
    /// Little-endian 32-bit floats, x, y, z per render vertex.
    pub bytes: Bytes,
    /// Strong entity tag, with its quotes.
    pub etag: String,
}
