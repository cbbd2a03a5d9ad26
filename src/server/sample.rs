//! The built-in creature, so that a first call needs no file.

use crate::asset::sample;
use crate::engine::{Handle, Region};
use crate::session::{Error, ErrorCode};
use bytes::Bytes;
use std::sync::LazyLock;
use xxhash_rust::xxh3::xxh3_64;

/// Its name.
pub const NAME: &str = "creature";

static GLB: LazyLock<Bytes> = LazyLock::new(|| Bytes::from(sample::creature_glb()));

/// Its model. The first call makes it, which takes a moment, away from the threads that serve.
///
/// # Errors
/// `INTERNAL`, when making it fails.
pub async fn glb() -> Result<Bytes, Error> {
    let made = tokio::task::spawn_blocking(|| GLB.clone()).await;
    made.map_err(|_| Error::new(ErrorCode::Internal, "the built-in model cannot be made"))
}

/// Strong entity tag of a model that never changes while the server runs.
pub(super) fn etag(glb: &Bytes) -> String {
    format!("\"{:016x}\"", xxh3_64(glb))
}

/// Handles that hold its feet and move its head.
pub fn handles() -> [Handle; 2] {
    let (normal, offset) = sample::HANDLES.feet;
    let (center, radius) = sample::HANDLES.head;
    [
        Handle::new("feet", Region::half_space(normal, offset)),
        Handle::new("head", Region::sphere(center, radius)),
    ]
}
