//! Rejects models that could not be opened again: every triangle collapses in the precision of a format.

use super::error::Error;
use super::format::Format;
use super::formats::codec_of;
use glam::DVec3;

/// Rejects a model whose every triangle collapses in the format's positions. One remaining triangle makes a model that
/// opens. A model that had no triangle before is not rejected here.
pub(super) fn check_precision(format: Format, positions: &[DVec3], triangles: &[[u32; 3]]) -> Result<(), Error> {
    if !codec_of(format).rounds_to_single() || triangles.is_empty() {
        return Ok(());
    }
    let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
    let is_apart = |[a, b, c]: [DVec3; 3]| a != b && b != c && c != a;
    let rounded = |p: DVec3| p.as_vec3().as_dvec3();
    let mut was_apart = triangles.iter().filter(|t| is_apart(corners(t))).peekable();
    if was_apart.peek().is_none() || was_apart.any(|t| is_apart(corners(t).map(rounded))) {
        return Ok(());
    }
    let far = positions.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let problem = format!(
        "its positions have seven digits, and at coordinates of {far:.3e} every one of {} triangles collapses in them; \
         move the model nearer to the origin, or write obj, ply or off",
        triangles.len()
    );
    Err(Error::unwritable(format, problem))
}
