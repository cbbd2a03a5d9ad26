//! What is given arbitrary bytes, and what must hold whatever they are: nothing panics, nothing hangs, nothing is taken beyond its
//! limit, and what was accepted can be written and read again.
//!
//! The tests of this folder run every target on stored and mutated inputs; `coverage` runs the same functions under libFuzzer.
#![allow(dead_code)]

pub mod files;
pub mod messages;
pub mod sessions;
pub mod soups;

use glam::DVec3;
use pliant::asset::Format;

/// A function that is given arbitrary bytes.
pub type FuzzTarget = fn(&[u8]);

/// Every target by its name, which is that of its folders of inputs.
pub const TARGETS: [(&str, FuzzTarget); 22] = [
    ("obj", |bytes| files::read_and_write(bytes, Some(Format::OBJ))),
    ("ply", |bytes| files::read_and_write(bytes, Some(Format::PLY))),
    ("off", |bytes| files::read_and_write(bytes, Some(Format::OFF))),
    ("stl", |bytes| files::read_and_write(bytes, Some(Format::STL))),
    ("threemf", |bytes| files::read_and_write(bytes, Some(Format::THREE_MF))),
    ("glb", |bytes| files::read_and_write(bytes, Some(Format::GLB))),
    ("gltf", |bytes| files::read_and_write(bytes, Some(Format::GLTF))),
    ("fbx", |bytes| files::read_and_write(bytes, Some(Format::FBX))),
    ("any_model", |bytes| files::read_and_write(bytes, None)),
    ("decoders", files::decoders),
    ("bvh", files::bvh),
    ("rig", files::rig),
    ("messages", messages::messages),
    ("json", messages::json),
    ("jobs", sessions::jobs),
    ("edits", sessions::edits),
    ("handles", sessions::handles),
    ("soups", soups::soups),
    ("commit_records", messages::commit_records),
    ("model_records", messages::model_records),
    ("reports", messages::reports),
    ("frames", messages::frames),
];

/// The target of a name.
pub fn target(name: &str) -> FuzzTarget {
    let found = TARGETS.iter().find(|(own, _)| *own == name);
    found.expect("the name of a target").1
}

/// Choices and numbers drawn from bytes, so that a small change of the bytes is a small change of the draws; zeros when they
/// have ended.
pub struct ByteDraw<'a>(pub &'a [u8]);

impl ByteDraw<'_> {
    /// Whether all bytes are drawn.
    pub fn is_done(&self) -> bool {
        self.0.is_empty()
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        first
    }

    /// A whole number below `count`, at most 256.
    pub fn below(&mut self, count: usize) -> usize {
        usize::from(self.byte()) % count.max(1)
    }

    /// Yes or no.
    pub fn flag(&mut self) -> bool {
        self.byte() & 1 == 1
    }

    /// A number between -1 and 1; one time in sixteen an odd one.
    pub fn number(&mut self) -> f64 {
        let (high, low) = (self.byte(), self.byte());
        if high >= 0xf0 {
            let odd = [0.0, -0.0, 1.0, -1.0, 1e-300, 1e-12, 1e9, -1e9, 1e300, f64::MIN_POSITIVE];
            return odd[usize::from(low) % odd.len()];
        }
        f64::from(i16::from_be_bytes([high, low])) / 32768.0
    }

    /// Three numbers.
    pub fn vector(&mut self) -> DVec3 {
        DVec3::new(self.number(), self.number(), self.number())
    }
}
