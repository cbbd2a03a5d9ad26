//! Models made on the spot, for trying pliant where none is at hand: a creature, and a figure with everything that a game's
//! character has; and recordings that drive them.

mod creature;
mod figure;
mod figure_clips;
mod figure_file;
mod figure_skeleton;
mod limbs;
mod recorded_poses;
mod recorded_skeleton;
mod recordings;

pub use creature::{HANDLES, SampleHandles, creature, creature_glb};
pub use figure::{body_glb, figure_body};
pub use figure_file::figure_glb;
pub use recordings::BuiltInRecording;

/// A model that needs no file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum BuiltInModel {
    /// A friendly four-legged creature: one closed mesh.
    Creature,
    /// A person with a skeleton, two clips, two levels of detail, a hull for collisions and two sockets.
    Figure,
}

impl BuiltInModel {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Creature, Self::Figure];

    /// What it is called, without an ending.
    pub fn name(self) -> &'static str {
        match self {
            Self::Creature => "creature",
            Self::Figure => "figure",
        }
    }

    /// The one of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The names of all, for a sentence: "creature or figure".
    pub fn name_list() -> String {
        Self::ALL.map(Self::name).join(" or ")
    }

    /// Builds its GLB file; the same bytes every time.
    pub fn glb(self) -> Vec<u8> {
        match self {
            Self::Creature => creature_glb(),
            Self::Figure => figure_glb(),
        }
    }
}
