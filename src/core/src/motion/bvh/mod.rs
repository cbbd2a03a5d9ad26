//! Motion capture in the BVH format: a tree of joints with offsets and channels, then a row of numbers for each frame.
//!
//! The reader goes over the text once, line by line and without recursion, and believes no number before it is counted. Rotations
//! are taken as quaternions in the order that each joint lists its channels, so that angles that wrap do no harm. Position
//! channels replace the joint's offset.

mod hierarchy;
mod rows;

pub use hierarchy::ClipLimits;

use super::error::Error;
use super::skeleton::{MotionClip, RecordedFrames};
use hierarchy::ClipLines;

/// Reads a BVH file. Frames that follow after those declared count too, with a warning.
///
/// ```
/// use pliant_core::motion::bvh::{ClipLimits, read_bvh};
///
/// let text = b"HIERARCHY\nROOT hip\n{\n OFFSET 0 1 0\n CHANNELS 1 Yrotation\n End Site\n {\n  OFFSET 0 1 0\n }\n}\n\
///     MOTION\nFrames: 2\nFrame Time: 0.5\n0\n90\n";
/// let clip = read_bvh(text, &ClipLimits::default())?;
/// let turned = clip.pose_at(0.25)[0].rotation;
/// assert!((turned.y - 22.5f64.to_radians().sin()).abs() < 1e-12);
/// # Ok::<(), pliant_core::motion::Error>(())
/// ```
///
/// # Errors
/// [`Error`] with the line where the text is not a clip, or where there is more than `limits` allow.
pub fn read_bvh(bytes: &[u8], limits: &ClipLimits) -> Result<MotionClip, Error> {
    let seen = bytes.len() as u64;
    if seen > limits.bytes {
        let (what, limit) = ("bytes", limits.bytes);
        return Err(Error::TooMany { what, seen, limit });
    }
    let mut lines = ClipLines::of(bytes);
    let Some(first) = lines.next_line() else {
        return Err(Error::Empty);
    };
    if !first.begins_with("HIERARCHY") || first.words().count() != 1 {
        return Err(first.refuse("a BVH file begins with HIERARCHY"));
    }
    let tree = hierarchy::read_tree(&mut lines, limits)?;
    let frames = rows::read_rows(&mut lines, &tree, limits)?;
    let interval = frames.interval;
    Ok(MotionClip {
        name: String::new(),
        duration: interval * (frames.count - 1) as f64,
        recorded: Some(RecordedFrames {
            count: frames.count,
            interval,
        }),
        curves: frames.curves,
        skeleton: tree.skeleton,
        warnings: frames.warnings,
    })
}

#[cfg(test)]
mod tests;
