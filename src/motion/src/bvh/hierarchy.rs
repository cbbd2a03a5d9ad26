//! The first half of a BVH file: joints, their rest places, and what moves them.
//!
//! The text of a clip, line by line.
//!
//! How large a clip may be.

use crate::Error;
use crate::skeleton::{JointPose, Skeleton, SkeletonJoint};
use glam::DVec3;
use std::borrow::Cow;

/// What a number of a frame says of its joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum JointChannel {
    /// Where it is along an axis.
    Position(usize),
    /// By how many degrees it is turned about an axis.
    Rotation(usize),
}

/// What the frames' numbers are about.
pub(super) struct ChannelTree {
    pub skeleton: Skeleton,
    /// For each joint its channels, in the order of the numbers.
    pub channels: Vec<Vec<JointChannel>>,
}

impl ChannelTree {
    /// Numbers in each frame.
    pub(super) fn width(&self) -> usize {
        self.channels.iter().map(Vec::len).sum()
    }
}

/// What of a joint has been read.
struct OpenJoint {
    joint: usize,
    has_offset: bool,
    has_channels: bool,
    ends: bool,
}

/// Reads up to and with the line that says MOTION.
pub(super) fn read_tree(lines: &mut ClipLines<'_>, limits: &ClipLimits) -> Result<ChannelTree, Error> {
    let mut reader = TreeReader {
        tree: ChannelTree {
            skeleton: Skeleton::default(),
            channels: Vec::new(),
        },
        open: Vec::new(),
        announced: None,
        limit: limits.joints,
    };
    while let Some(line) = lines.next_line() {
        if line.begins_with("MOTION") {
            return reader.finish(&line);
        }
        reader.read_line(&line)?;
    }
    Err(Error::Malformed {
        line: lines.number(),
        problem: match reader.open.last() {
            Some(open) => format!("the brace of {} is never closed", reader.name_of(open.joint)),
            None => "there is no MOTION, so nothing moves".into(),
        },
    })
}

struct TreeReader {
    tree: ChannelTree,
    open: Vec<OpenJoint>,
    /// A joint whose brace must come next.
    announced: Option<OpenJoint>,
    limit: usize,
}

impl TreeReader {
    fn name_of(&self, joint: usize) -> String {
        format!("\"{}\"", shown(self.tree.skeleton.joints[joint].name.as_bytes()))
    }

    fn finish(self, line: &ClipLine<'_>) -> Result<ChannelTree, Error> {
        if let Some(open) = self.open.last() {
            return Err(line.refuse(format!("the brace of {} is not closed", self.name_of(open.joint))));
        }
        if let Some(joint) = &self.announced {
            return Err(line.refuse(format!("{} has no braces", self.name_of(joint.joint))));
        }
        if self.tree.skeleton.joints.is_empty() {
            return Err(line.refuse("there is no ROOT"));
        }
        Ok(self.tree)
    }

    fn read_line(&mut self, line: &ClipLine<'_>) -> Result<(), Error> {
        // A brace may stand behind what it belongs to.
        let (before, brace) = match line.text.split_last() {
            Some((b'{', before)) => (before.trim_ascii(), true),
            _ => (line.text, false),
        };
        if !before.is_empty() {
            let text = ClipLine { text: before, ..*line };
            self.read_words(&text)?;
        }
        if brace {
            let Some(joint) = self.announced.take() else {
                return Err(line.refuse("a brace must follow ROOT, JOINT or End Site"));
            };
            self.open.push(joint);
        }
        Ok(())
    }

    fn read_words(&mut self, line: &ClipLine<'_>) -> Result<(), Error> {
        if let Some(joint) = &self.announced {
            return Err(line.refuse(format!("{{ must follow {}", self.name_of(joint.joint))));
        }
        match () {
            () if line.begins_with("ROOT") => self.begin_root(line),
            () if line.begins_with("JOINT") => self.begin_joint(line, false),
            () if line.begins_with("End") => self.begin_joint(line, true),
            () if line.begins_with("OFFSET") => self.read_offset(line),
            () if line.begins_with("CHANNELS") => self.read_channels(line),
            () if line.text == b"}" => self.close_joint(line),
            () => Err(line.refuse(format!(
                "\"{}\" is unknown here; there may be JOINT, End Site, OFFSET, CHANNELS, braces or MOTION",
                shown(line.text)
            ))),
        }
    }

    fn begin_root(&mut self, line: &ClipLine<'_>) -> Result<(), Error> {
        if !self.open.is_empty() {
            return Err(line.refuse("a ROOT stands within a joint"));
        }
        if !self.tree.skeleton.joints.is_empty() {
            return Err(line.refuse("a second ROOT; a clip may move one figure"));
        }
        self.announce(line.after("ROOT".len()), None, false)
    }

    fn begin_joint(&mut self, line: &ClipLine<'_>, ends: bool) -> Result<(), Error> {
        let Some(above) = self.open.last() else {
            return Err(line.refuse("a JOINT or End Site must stand within the braces of a ROOT"));
        };
        if above.ends {
            return Err(line.refuse("nothing may stand within an End Site but its OFFSET"));
        }
        let above = above.joint;
        if ends {
            let name = [self.tree.skeleton.joints[above].name.as_bytes(), b".end"].concat();
            return self.announce(&name, Some(above), true);
        }
        self.announce(line.after("JOINT".len()), Some(above), false)
    }

    fn announce(&mut self, name: &[u8], parent: Option<usize>, ends: bool) -> Result<(), Error> {
        let joints = &mut self.tree.skeleton.joints;
        check_count("joints", joints.len() + 1, self.limit)?;
        joints.push(SkeletonJoint {
            name: String::from_utf8_lossy(name).into_owned(),
            parent,
            rest: JointPose::at(DVec3::ZERO),
        });
        self.tree.channels.push(Vec::new());
        self.announced = Some(OpenJoint {
            joint: joints.len() - 1,
            has_offset: false,
            has_channels: ends,
            ends,
        });
        Ok(())
    }

    fn read_offset(&mut self, line: &ClipLine<'_>) -> Result<(), Error> {
        let Some(open) = self.open.last_mut().filter(|open| !open.has_offset) else {
            return Err(line.refuse("OFFSET must stand once within the braces of a joint"));
        };
        open.has_offset = true;
        let joint = open.joint;
        let numbers: Vec<f64> = line
            .words()
            .skip(1)
            .take(4)
            .map(|word| line.number_of(word))
            .collect::<Result<_, _>>()?;
        let &[x, y, z] = numbers.as_slice() else {
            return Err(line.refuse("OFFSET needs three numbers"));
        };
        self.tree.skeleton.joints[joint].rest = JointPose::at(DVec3::new(x, y, z));
        Ok(())
    }

    fn read_channels(&mut self, line: &ClipLine<'_>) -> Result<(), Error> {
        let Some(open) = self.open.last_mut().filter(|open| !open.has_channels) else {
            return Err(line.refuse("CHANNELS must stand once within the braces of a ROOT or JOINT"));
        };
        open.has_channels = true;
        let joint = open.joint;
        let mut words = line.words().skip(1);
        let count = words
            .next()
            .and_then(|word| std::str::from_utf8(word).ok()?.parse::<usize>().ok());
        let Some(count) = count.filter(|&count| count <= 6) else {
            return Err(line.refuse("CHANNELS needs a whole number from 0 to 6 and as many names"));
        };
        let mut channels = Vec::with_capacity(count);
        for word in words {
            let Some(channel) = channel_named(word) else {
                return Err(line.refuse(format!(
                    "the channel \"{}\" is unknown; there are Xposition, Yposition, Zposition, Xrotation, Yrotation and \
                     Zrotation",
                    shown(word)
                )));
            };
            if channels.contains(&channel) {
                return Err(line.refuse(format!("the channel {} stands twice", shown(word))));
            }
            channels.push(channel);
        }
        if channels.len() != count {
            return Err(line.refuse(format!("{count} channels are declared, {} are named", channels.len())));
        }
        self.tree.channels[joint] = channels;
        Ok(())
    }

    fn close_joint(&mut self, line: &ClipLine<'_>) -> Result<(), Error> {
        let Some(open) = self.open.pop() else {
            return Err(line.refuse("a brace closes nothing"));
        };
        if !open.has_offset {
            return Err(line.refuse(format!("{} has no OFFSET", self.name_of(open.joint))));
        }
        Ok(())
    }
}

fn channel_named(word: &[u8]) -> Option<JointChannel> {
    let (axis, kind) = word.split_first()?;
    let axis = usize::from(axis.to_ascii_uppercase().checked_sub(b'X')?);
    match kind.to_ascii_lowercase().as_slice() {
        b"position" if axis < 3 => Some(JointChannel::Position(axis)),
        b"rotation" if axis < 3 => Some(JointChannel::Rotation(axis)),
        _ => None,
    }
}

/// Goes through the lines of a text that have something on them.
pub(super) struct ClipLines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> ClipLines<'a> {
    /// A mark of byte order at the beginning is passed over.
    pub(super) fn of(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes),
            number: 0,
        }
    }

    /// The next line with something on it. Lines end with LF, CR LF or CR.
    pub(super) fn next_line(&mut self) -> Option<ClipLine<'a>> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|&b| b == b'\n' || b == b'\r');
            let (line, after) = self.rest.split_at(end.unwrap_or(self.rest.len()));
            let after = after.strip_prefix(b"\r\n").or_else(|| after.get(1..));
            self.rest = after.unwrap_or_default();
            self.number += 1;
            let text = line.trim_ascii();
            if !text.is_empty() {
                let number = self.number;
                return Some(ClipLine { text, number });
            }
        }
        None
    }

    /// The number of the last line that was read.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    /// At least how many more bytes there are.
    pub(super) fn bytes_left(&self) -> usize {
        self.rest.len()
    }
}

/// A line without what is blank around it.
#[derive(Clone, Copy)]
pub(super) struct ClipLine<'a> {
    pub text: &'a [u8],
    pub number: usize,
}

impl<'a> ClipLine<'a> {
    pub(super) fn words(&self) -> impl Iterator<Item = &'a [u8]> {
        self.text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
    }

    /// Whether its first word is `word`, in capitals or not.
    pub(super) fn begins_with(&self, word: &str) -> bool {
        self.words()
            .next()
            .is_some_and(|first| first.eq_ignore_ascii_case(word.as_bytes()))
    }

    /// What follows after so many bytes, without what is blank around it.
    pub(super) fn after(&self, bytes: usize) -> &'a [u8] {
        self.text.get(bytes..).unwrap_or_default().trim_ascii()
    }

    pub(super) fn refuse(&self, problem: impl Into<String>) -> Error {
        Error::Malformed {
            line: self.number,
            problem: problem.into(),
        }
    }

    /// A number on this line.
    pub(super) fn number_of(&self, word: &[u8]) -> Result<f64, Error> {
        let text = std::str::from_utf8(word).ok();
        let number = text.and_then(|text| text.parse::<f64>().ok());
        match number {
            Some(number) if number.abs() <= LARGEST => Ok(number),
            Some(number) if number.is_finite() => Err(self.refuse(format!(
                "\"{}\" is too large; numbers from -1e15 to 1e15 are allowed",
                shown(word)
            ))),
            Some(_) => Err(self.refuse(format!("\"{}\" is not finite", shown(word)))),
            None if word.contains(&b',') => Err(self.refuse(format!(
                "\"{}\" is not a number; decimals need a point, not a comma",
                shown(word)
            ))),
            None => Err(self.refuse(format!("\"{}\" is not a number", shown(word)))),
        }
    }
}

/// The largest number of a clip, in degrees, units or seconds: what is computed from such numbers is far from the end of doubles.
const LARGEST: f64 = 1e15;

/// At most 60 characters of a text, for a message.
pub(super) fn shown(text: &[u8]) -> String {
    let text: Cow<'_, str> = String::from_utf8_lossy(text);
    let mut clipped: String = text.chars().take(60).collect();
    if clipped.len() < text.len() {
        clipped.push('…');
    }
    clipped
}

/// How large a clip may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClipLimits {
    /// Bytes of the file.
    pub bytes: u64,
    /// Joints, end sites among them.
    pub joints: usize,
    /// Frames, or keys of a curve.
    pub frames: usize,
    /// Numbers in all frames together.
    pub numbers: usize,
}

impl Default for ClipLimits {
    fn default() -> Self {
        Self {
            bytes: 64 << 20,
            joints: 4096,
            frames: 1_000_000,
            numbers: 8_000_000,
        }
    }
}

/// What a clip has too much of, if anything.
pub(super) fn check_count(what: &'static str, seen: usize, limit: usize) -> Result<(), Error> {
    let (seen, limit) = (seen as u64, limit as u64);
    if seen > limit {
        return Err(Error::TooMany { what, seen, limit });
    }
    Ok(())
}
