//! The first half of a BVH file: joints, their rest places, and what moves them.

use super::clip_limits::{ClipLimits, check_count};
use super::lines::{ClipLine, ClipLines, shown};
use crate::motion::error::Error;
use crate::motion::skeleton::{JointPose, Skeleton, SkeletonJoint};
use glam::DVec3;

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
