//! Frames of an animation as a GLB that plays them: with morph targets, or with bones.

use super::key_frames::choose_key_frames;
use super::played_skin::{write_corrected_frames, write_rig_frames, write_skin_frames};
use super::prepare::Animation;
use crate::asset::{ClipBeside, MorphClip, NodeKeys, NodePlace, WrittenFiles};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::motion::rig::RigidMotion;
use glam::{DVec3, Vec3};

/// How a GLB holds frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlayedForm {
    /// With so many morph targets at most.
    Morphs(usize),
    /// With a skin of so many bones, which are fitted to the frames.
    Bones(usize),
    /// With a skin of the rig's bones.
    RigBones {
        /// Whether three more bones along each limb share its twist.
        has_twists: bool,
    },
    /// With a skin of the rig's bones, and so many correctives at most.
    Correctives(usize),
}

/// Solved frames, numbered from 0, that can be read again.
pub trait FrameSource {
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

/// A GLB that plays frames.
#[derive(Debug)]
pub struct PlayedClipFile {
    /// Its files.
    pub files: WrittenFiles,
    /// How far it is from the solved frames; `None` where it has them all.
    pub error: Option<WrittenError>,
}

/// How far written frames are from the solved ones.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenError {
    /// The root of the mean square, in percent of the diagonal.
    pub rms_percent: f64,
    /// The largest distance, in percent of the diagonal.
    pub max_percent: f64,
    /// Morph targets or bones.
    pub parts: usize,
    /// The line that reports it.
    pub message: String,
}

impl Animation {
    /// Writes its frames as a GLB that plays them; with `has_root` the motion of the root is that of a node.
    ///
    /// # Errors
    /// When a frame cannot be read again, the frames have no such bones, or the model cannot be written as a GLB.
    pub fn write_clip<F: FrameSource>(
        &self,
        form: PlayedForm,
        has_root: bool,
        frames: &mut F,
        exec: &Exec<'_>,
    ) -> Result<PlayedClipFile, F::Failure> {
        let played = PlayedModel {
            animation: self,
            rest: &self.model().1[..],
            vertices: self.played_vertices(),
            has_root,
        };
        match form {
            PlayedForm::Morphs(most) => write_morph_frames(&played, frames, most),
            PlayedForm::Bones(bones) => write_skin_frames(&played, frames, bones, exec),
            PlayedForm::RigBones { has_twists } => write_rig_frames(&played, frames, has_twists, exec),
            PlayedForm::Correctives(most) => write_corrected_frames(&played, frames, most, exec),
        }
    }
}

/// The model that frames are of, and how they are played.
pub(super) struct PlayedModel<'a> {
    pub(super) animation: &'a Animation,
    /// Its rest positions, one per render vertex.
    pub(super) rest: &'a [DVec3],
    /// The vertices that are played; the model's own clip moves the others.
    pub(super) vertices: Vec<usize>,
    /// Whether the root's motion becomes a node.
    has_root: bool,
}

impl PlayedModel<'_> {
    /// When a frame is, in seconds from the first.
    pub(super) fn seconds(&self, frame: usize) -> f64 {
        frame as f64 / self.animation.times.rate
    }

    /// The clip's name, or a word for it.
    pub(super) fn clip_name(&self) -> &str {
        match self.animation.clip_name() {
            "" => "clip",
            name => name,
        }
    }

    /// How far so many morph targets or bones are off, of a root mean square and a largest distance.
    pub(super) fn written_error(&self, parts: usize, lengths: [f64; 2]) -> WrittenError {
        let diagonal = self.animation.diagonal();
        let [rms_percent, max_percent] = lengths.map(|length| match diagonal > 0.0 {
            true => 100.0 * length / diagonal,
            false => 0.0,
        });
        WrittenError {
            rms_percent,
            max_percent,
            parts,
            message: String::new(),
        }
    }

    /// The model's own clip, which plays beside the frames. `around`: keys that apply to all that it moves.
    pub(super) fn beside<'k>(&self, around: Option<NodeKeys<'k>>) -> Option<ClipBeside<'k>> {
        let Animation {
            range, times, own_clip, ..
        } = self.animation;
        let seconds = [range.start, range.end - 1].map(|frame| times.at(frame));
        own_clip.map(|clip| ClipBeside { clip, seconds, around })
    }
}

/// Where the root has moved the model in each frame, and the inverse motions.
pub(super) struct RootPlaces {
    places: Vec<NodePlace>,
    back: Vec<NodePlace>,
}

impl RootPlaces {
    pub(super) fn of_frames(frames: &impl FrameSource) -> Self {
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

/// Writes frames as a GLB with `most` morph targets, and the motion of the root as a node.
fn write_morph_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    most: usize,
) -> Result<PlayedClipFile, F::Failure> {
    let count = frames.count();
    let keys = choose_key_frames(frames, &played.vertices, most)?;
    let times: Vec<f64> = keys.chosen.iter().map(|frame| played.seconds(*frame)).collect();
    let all: Vec<f64> = (0..count).map(|frame| played.seconds(frame)).collect();
    let roots = RootPlaces::of_frames(frames);
    let clip = MorphClip {
        name: played.clip_name(),
        times: &times,
        shapes: &keys.shapes,
        root: roots.keys_of_node(played, &all),
        beside: played.beside(roots.keys_around(played, &all)),
    };
    let files = played
        .animation
        .model()
        .0
        .write_morph_clip(&clip)
        .map_err(Error::from)?;
    let is_whole = keys.chosen.len() == count;
    let error = (!is_whole).then(|| {
        let mut error = played.written_error(keys.chosen.len(), [keys.rms, keys.error]);
        error.message = format!(
            "{count} frames are blended from {} shapes; at worst a vertex is off by {:.3} % of the diagonal",
            error.parts, error.max_percent
        );
        error
    });
    Ok(PlayedClipFile { files, error })
}
