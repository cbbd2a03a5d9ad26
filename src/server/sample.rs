//! The built-in creature, so that a first call needs no file.

use crate::asset::sample;
use crate::session::{Error, ErrorCode};
use crate::wire::pb;
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
pub fn handles() -> Vec<pb::Handle> {
    use pb::region::Region;
    let regions = sample::HANDLES;
    let handle = |id: &str, region: Region| pb::Handle {
        id: id.to_owned(),
        region: Some(pb::Region { region: Some(region) }),
        ..pb::Handle::default()
    };
    let (normal, offset) = regions.feet;
    let (center, radius) = regions.head;
    vec![
        handle(
            "feet",
            Region::HalfSpace(pb::region::HalfSpace {
                normal: normal.to_vec(),
                offset,
            }),
        ),
        handle(
            "head",
            Region::Sphere(pb::region::Sphere {
                center: center.to_vec(),
                radius,
            }),
        ),
    ]
}
