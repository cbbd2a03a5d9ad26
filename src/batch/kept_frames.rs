//! Frames of an animation that are kept until the last one is there, to become a model that plays them.

use crate::asset::{ClipBeside, Model, NodeKeys, NodePlace};
use crate::motion::rig::RigidMotion;
use crate::wire::Error;
use crate::wire::pb::animation_report::WrittenError;
use glam::{DVec3, Vec3};

/// Frames that are kept, numbered from 0.
pub trait KeptFrames {
    /// Why one cannot be read again.
    type Failure: From<Error>;

    /// How many there are.
    fn count(&self) -> usize;

    /// What the root bone does in a frame.
    fn root(&self, frame: usize) -> RigidMotion;

    /// Where the vertices are in a frame.
    ///
    /// # Errors
    /// When it cannot be read again.
    fn positions(&mut self, frame: usize) -> Result<Vec<Vec3>, Self::Failure>;
}

/// The error of the written frames against the solved ones, and a line that reports it.
pub type WrittenOff = (WrittenError, String);

/// The model that frames are of, and how they are played.
#[derive(Clone, Copy)]
pub struct PlayedModel<'a> {
    /// The model.
    pub model: &'a Model,
    /// Its rest positions, one per render vertex.
    pub rest: &'a [DVec3],
    /// The vertices that are played; the model's own clip moves the others.
    pub vertices: &'a [usize],
    /// Length of its bounding box's diagonal.
    pub diagonal: f64,
    /// What the clip is called; may be empty.
    pub clip: &'a str,
    /// The clip's number in the model, where it is of the model's own skin.
    pub own: Option<usize>,
    /// When the first frame and the last one are, in seconds of the clip.
    pub seconds: [f64; 2],
    /// Frames a second.
    pub rate: f64,
    /// Whether the root's motion becomes a node.
    pub has_root: bool,
}

impl PlayedModel<'_> {
    /// When a frame is, in seconds from the first.
    pub(super) fn seconds(&self, frame: usize) -> f64 {
        frame as f64 / self.rate
    }

    /// The clip's name, or a word for it.
    pub(super) fn clip_name(&self) -> &str {
        if self.clip.is_empty() { "clip" } else { self.clip }
    }

    /// How far so many morph targets or bones are off, of a root mean square and a largest distance.
    pub(super) fn written_error(&self, parts: usize, lengths: [f64; 2]) -> WrittenError {
        let [rms_percent, max_percent] = lengths.map(|length| match self.diagonal > 0.0 {
            true => 100.0 * length / self.diagonal,
            false => 0.0,
        });
        WrittenError {
            rms_percent,
            max_percent,
            parts: u32::try_from(parts).unwrap_or(u32::MAX),
        }
    }

    /// The model's own clip, which plays beside the frames. `around`: keys that apply to all that it moves.
    pub(super) fn beside<'k>(&self, around: Option<NodeKeys<'k>>) -> Option<ClipBeside<'k>> {
        let seconds = self.seconds;
        self.own.map(|clip| ClipBeside { clip, seconds, around })
    }
}

/// Where the root has moved the model in each frame, and the inverse motions.
pub(super) struct RootPlaces {
    places: Vec<NodePlace>,
    back: Vec<NodePlace>,
}

impl RootPlaces {
    pub(super) fn of_frames(frames: &impl KeptFrames) -> Self {
        let places = (0..frames.count()).map(|frame| node_place(&frames.root(frame)));
        let places: Vec<NodePlace> = places.collect();
        let back = places.iter().map(back_from).collect();
        Self { places, back }
    }

    fn keys<'k>(&'k self, is_wanted: bool, places: &'k [NodePlace], times: &'k [f64]) -> Option<NodeKeys<'k>> {
        let moves = self.places.iter().any(|place| *place != NodePlace::IDENTITY);
        (moves && is_wanted).then_some(NodeKeys { times, places })
    }

    /// The keys of the root node; `None` when it never moves.
    pub(super) fn keys_of_node<'k>(&'k self, played: &PlayedModel<'_>, times: &'k [f64]) -> Option<NodeKeys<'k>> {
        self.keys(played.has_root, &self.places, times)
    }

    /// Without such a node, the inverse keys for what plays beside.
    pub(super) fn keys_around<'k>(&'k self, played: &PlayedModel<'_>, times: &'k [f64]) -> Option<NodeKeys<'k>> {
        self.keys(!played.has_root, &self.back, times)
    }
}

/// Where a node is that moves as a root does.
pub fn node_place(root: &RigidMotion) -> NodePlace {
    NodePlace {
        translation: root.to - root.rotation * root.from,
        rotation: root.rotation,
    }
}

/// The inverse of a node's motion.
fn back_from(place: &NodePlace) -> NodePlace {
    let rotation = place.rotation.inverse();
    NodePlace {
        translation: -(rotation * place.translation),
        rotation,
    }
}
