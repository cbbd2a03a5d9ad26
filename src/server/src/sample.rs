//! What the built-in models need as resources of the server: an entity tag, and handles for the first call.

use pliant_asset::sample;
use pliant_core::engine::{Handle, Region};
use xxhash_rust::xxh3::xxh3_64;

/// Strong entity tag of a model that never changes while the server runs.
pub(super) fn etag(glb: &[u8]) -> String {
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
