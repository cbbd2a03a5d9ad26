//! Motion capture in the BVH format: a tree of joints with offsets and channels, then a row of numbers for each frame.
//!
//! The reader goes over the text once, line by line and without recursion, and believes no number before it is counted. Rotations
//! are taken as quaternions in the order that each joint lists its channels, so that angles that wrap do no harm. Position
//! channels replace the joint's offset.

mod hierarchy;

use super::Error;
use super::curve::{Interpolation, KeyedCurve};
use super::skeleton::{JointCurves, MotionClip, RecordedFrames};
use glam::{DQuat, DVec3};
pub use hierarchy::ClipLimits;
use hierarchy::{ChannelTree, ClipLine, ClipLines, JointChannel, check_count, shown};
use std::sync::Arc;

/// Reads a BVH file. Frames that follow after those declared count too, with a warning.
///
/// ```
/// use pliant_motion::bvh::{ClipLimits, read_bvh};
///
/// let text = b"HIERARCHY\nROOT hip\n{\n OFFSET 0 1 0\n CHANNELS 1 Yrotation\n End Site\n {\n  OFFSET 0 1 0\n }\n}\n\
///     MOTION\nFrames: 2\nFrame Time: 0.5\n0\n90\n";
/// let clip = read_bvh(text, &ClipLimits::default())?;
/// let turned = clip.pose_at(0.25)[0].rotation;
/// assert!((turned.y - 22.5f64.to_radians().sin()).abs() < 1e-12);
/// # Ok::<(), pliant_motion::Error>(())
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
    read_rows(&mut lines, tree, limits)
}

#[cfg(test)]
mod tests;

/// Reads what follows MOTION.
fn read_rows(lines: &mut ClipLines<'_>, tree: ChannelTree, limits: &ClipLimits) -> Result<MotionClip, Error> {
    let declared = read_count(lines, limits)?;
    let interval = read_interval(lines)?;
    let width = tree.width();
    let numbers = read_numbers(lines, width, limits)?;
    // Where no joint moves, rows are blank and cannot be counted.
    let count = numbers.len().checked_div(width).unwrap_or(declared);
    if count < declared {
        let problem = format!("{declared} frames are declared, {count} follow");
        let line = lines.number();
        return Err(Error::Malformed { line, problem });
    }
    let mut warnings = Vec::new();
    if count > declared {
        warnings.push(format!(
            "{declared} frames are declared, {count} follow; all of them count"
        ));
    }
    let times: Arc<[f64]> = (0..count).map(|frame| frame as f64 * interval).collect();
    let mut first = 0;
    let mut curves = Vec::with_capacity(tree.channels.len());
    for (joint, channels) in tree.skeleton.joints.iter().zip(&tree.channels) {
        let own = JointRows {
            numbers: &numbers,
            width,
            first,
            channels,
        };
        curves.push(own.curves(&times, joint.rest.translation));
        first += channels.len();
    }
    Ok(MotionClip {
        name: String::new(),
        duration: interval * (count - 1) as f64,
        recorded: Some(RecordedFrames { count, interval }),
        curves,
        skeleton: tree.skeleton,
        warnings,
    })
}

fn read_count(lines: &mut ClipLines<'_>, limits: &ClipLimits) -> Result<usize, Error> {
    let (line, value) = labelled(lines, "Frames:")?;
    let count = line.number_of(value)?;
    if count < 1.0 || count.fract() != 0.0 {
        return Err(line.refuse(format!(
            "{} frames; at least 1 is needed, in whole numbers",
            shown(value)
        )));
    }
    // Numbers beyond what 64 bits count become the largest, which is refused.
    check_count("frames", count as usize, limits.frames)?;
    Ok(count as usize)
}

fn read_interval(lines: &mut ClipLines<'_>) -> Result<f64, Error> {
    let (line, value) = labelled(lines, "Frame Time:")?;
    let interval = line.number_of(value)?;
    if !(1e-6..=3600.0).contains(&interval) {
        return Err(line.refuse(format!(
            "a frame time of {} seconds; allowed are 0.000001 to 3600",
            shown(value)
        )));
    }
    Ok(interval)
}

/// The next line, which must begin with `label`, and what follows it. Blanks within the label do not matter.
fn labelled<'a>(lines: &mut ClipLines<'a>, label: &str) -> Result<(ClipLine<'a>, &'a [u8]), Error> {
    let Some(line) = lines.next_line() else {
        let problem = format!("the file ends where \"{label}\" should stand");
        let line = lines.number();
        return Err(Error::Malformed { line, problem });
    };
    let mut wanted = label.bytes().filter(|b| !b.is_ascii_whitespace()).peekable();
    let mut used = 0;
    for &byte in line.text {
        let Some(next) = wanted.peek() else { break };
        if byte.eq_ignore_ascii_case(next) {
            wanted.next();
        } else if !byte.is_ascii_whitespace() {
            break;
        }
        used += 1;
    }
    if wanted.peek().is_some() {
        return Err(line.refuse(format!("\"{label}\" should stand here, not \"{}\"", shown(line.text))));
    }
    Ok((line, line.after(used)))
}

fn read_numbers(lines: &mut ClipLines<'_>, width: usize, limits: &ClipLimits) -> Result<Vec<f64>, Error> {
    // Each number has a digit and a blank, so the text's length bounds how many there can be.
    let mut numbers = Vec::with_capacity((lines.bytes_left() / 2).min(limits.numbers));
    let mut count = 0;
    while let Some(line) = lines.next_line() {
        if width == 0 {
            return Err(line.refuse("no joint has channels, so no numbers may follow"));
        }
        count += 1;
        check_count("frames", count, limits.frames)?;
        let before = numbers.len();
        for word in line.words() {
            if numbers.len() - before == width {
                let seen = line.words().count();
                return Err(line.refuse(format!("{seen} numbers, the joints have {width} channels")));
            }
            numbers.push(line.number_of(word)?);
        }
        let seen = numbers.len() - before;
        if seen < width {
            return Err(line.refuse(format!("{seen} numbers, the joints have {width} channels")));
        }
        check_count("numbers in frames", numbers.len(), limits.numbers)?;
    }
    Ok(numbers)
}

/// The numbers of one joint in every frame.
struct JointRows<'a> {
    numbers: &'a [f64],
    width: usize,
    /// The place of the joint's first number in a frame.
    first: usize,
    channels: &'a [JointChannel],
}

impl JointRows<'_> {
    fn curves(&self, times: &Arc<[f64]>, offset: DVec3) -> JointCurves {
        let moves = self.channels.iter().any(|c| matches!(c, JointChannel::Position(_)));
        let turns = self.channels.iter().any(|c| matches!(c, JointChannel::Rotation(_)));
        let frames = || {
            let rows = self.numbers.chunks_exact(self.width.max(1));
            rows.map(|row| self.channels.iter().zip(&row[self.first..]))
        };
        let translation = moves.then(|| {
            let places = frames().map(|channels| {
                let mut place = offset;
                for (channel, &number) in channels {
                    if let JointChannel::Position(axis) = channel {
                        place[*axis] = number;
                    }
                }
                place
            });
            KeyedCurve::through(Arc::clone(times), places.collect(), Interpolation::Linear)
        });
        let rotation = turns.then(|| {
            let turns = frames().map(|channels| {
                let mut turn = DQuat::IDENTITY;
                for (channel, &number) in channels {
                    if let JointChannel::Rotation(axis) = channel {
                        turn *= about_axis(*axis, number);
                    }
                }
                turn.normalize()
            });
            KeyedCurve::through(Arc::clone(times), turns.collect(), Interpolation::Linear)
        });
        JointCurves {
            translation: translation.flatten(),
            rotation: rotation.flatten(),
            scale: None,
        }
    }
}

/// A turn about a coordinate axis. Whole turns are taken off first, which is exact for degrees.
fn about_axis(axis: usize, degrees: f64) -> DQuat {
    let half = (degrees % 720.0) * (std::f64::consts::PI / 360.0);
    let along = DVec3::AXES[axis] * libm::sin(half);
    DQuat::from_xyzw(along.x, along.y, along.z, libm::cos(half))
}
