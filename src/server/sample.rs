//! The built-in models, so that a first call needs no file.

use crate::asset::sample::{self, BuiltInModel};
use crate::engine::{Handle, Region};
use crate::session::{Error, ErrorCode};
use bytes::Bytes;
use std::sync::LazyLock;
use xxhash_rust::xxh3::xxh3_64;

static CREATURE: LazyLock<Bytes> = LazyLock::new(|| Bytes::from(BuiltInModel::Creature.glb()));
static FIGURE: LazyLock<Bytes> = LazyLock::new(|| Bytes::from(BuiltInModel::Figure.glb()));

/// A built-in model's file. The first call makes it on a blocking thread, which takes a moment.
///
/// # Errors
/// `INTERNAL`, when making it fails.
pub async fn glb(model: BuiltInModel) -> Result<Bytes, Error> {
    let made = tokio::task::spawn_blocking(move || match model {
        BuiltInModel::Creature => CREATURE.clone(),
        BuiltInModel::Figure => FIGURE.clone(),
    });
    made.await
        .map_err(|_| Error::new(ErrorCode::Internal, "the built-in model cannot be made"))
}

/// Strong entity tag of a model that never changes while the server runs.
pub(super) fn etag(glb: &Bytes) -> String {
    format!("\"{:016x}\"", xxh3_64(glb))
}

/// Handles that fix the creature's feet and move its head.
pub fn handles() -> [Handle; 2] {
    let (normal, offset) = sample::HANDLES.feet;
    let (center, radius) = sample::HANDLES.head;
    [
        Handle::new("feet", Region::half_space(normal, offset)),
        Handle::new("head", Region::sphere(center, radius)),
    ]
}
