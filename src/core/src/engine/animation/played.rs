//! Frames of an animation as a GLB that plays them: with morph targets, or with bones: bones that are fitted to the frames, or
//! those of the rig with weights that fit, or with correctives.

use super::frames::FrameSource;
use super::key_frames::choose_key_frames;
use super::made_rig::{bind_model, carrying_joints, influences_of_skin};
use super::prepare::Animation;
use crate::asset::{
    CarryingJoints, ClipBeside, MorphClip, NodeKeys, NodePlace, PlayedCorrectives, PlayedJoint, SkinnedClip,
    WrittenFiles,
};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::motion::BoneInfluences;
use crate::motion::correctives::{SkinnedFrames, fit_correctives};
use crate::motion::decomposition::{
    DecompositionError, DecompositionOptions, ShapeSequence, SkinDecomposition, decompose, fit_weights,
};
use crate::motion::rig::{RigError, RigSkeleton, RigidMotion, moved_joints};
use glam::{DQuat, DVec3, Vec3};

/// The most bones that a vertex follows, unless the model's own weights have more.
const INFLUENCES: usize = 4;

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
struct PlayedModel<'a> {
    animation: &'a Animation,
    /// Its rest positions, one per render vertex.
    rest: &'a [DVec3],
    /// The vertices that are played; the model's own clip moves the others.
    vertices: Vec<usize>,
    /// Whether the root's motion becomes a node.
    has_root: bool,
}

impl PlayedModel<'_> {
    /// The triangles between vertices that are played, by their numbers among these.
    fn triangles(&self) -> Vec<[u32; 3]> {
        let mut number = vec![None; self.rest.len()];
        (0..)
            .zip(&self.vertices)
            .for_each(|(k, vertex)| number[*vertex] = Some(k));
        let all = &self.animation.derived.topology().geometry().triangles;
        let renumbered = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|vertex| number[vertex as usize]);
            Some([a?, b?, c?])
        };
        all.iter().filter_map(renumbered).collect()
    }

    /// When a frame is, in seconds from the first.
    fn seconds(&self, frame: usize) -> f64 {
        frame as f64 / self.animation.times.rate
    }

    /// The clip's name, or a word for it.
    fn clip_name(&self) -> &str {
        match self.animation.clip_name() {
            "" => "clip",
            name => name,
        }
    }

    /// How far so many morph targets or bones are off, of a root mean square and a largest distance.
    fn written_error(&self, parts: usize, lengths: [f64; 2]) -> WrittenError {
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
    fn beside<'k>(&self, around: Option<NodeKeys<'k>>) -> Option<ClipBeside<'k>> {
        let Animation {
            range, times, own_clip, ..
        } = self.animation;
        let seconds = [range.start, range.end - 1].map(|frame| times.at(frame));
        own_clip.map(|clip| ClipBeside { clip, seconds, around })
    }
}

/// Where the root has moved the model in each frame, and the inverse motions.
struct RootPlaces {
    places: Vec<NodePlace>,
    back: Vec<NodePlace>,
}

impl RootPlaces {
    fn of_frames(frames: &impl FrameSource) -> Self {
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
    fn keys_of_node<'k>(&'k self, played: &PlayedModel<'_>, times: &'k [f64]) -> Option<NodeKeys<'k>> {
        self.keys(played.has_root, &self.places, times)
    }

    /// Without such a node, the inverse keys for what plays beside.
    fn keys_around<'k>(&'k self, played: &PlayedModel<'_>, times: &'k [f64]) -> Option<NodeKeys<'k>> {
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

/// Writes frames as a GLB whose vertices follow at most four of so many `bones`, and the motion of the root as a node; and what
/// there is to say of it.
///
/// # Errors
/// When a frame cannot be read again, the frames have no such bones, or the model cannot be written as a GLB.
fn write_skin_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    bones: usize,
    exec: &Exec<'_>,
) -> Result<PlayedClipFile, F::Failure> {
    let sequence = sequence_of(played, frames)?;
    let options = DecompositionOptions {
        bones,
        ..Default::default()
    };
    let skin = decompose(&sequence, &options, exec).map_err(refused)?;
    let off = played.written_error(skin.centres.len(), [skin.rms, skin.max]);
    let joints = resting_joints(&skin);
    let parts = SkinParts {
        frames: skin.motions.iter().map(|m| moved_joints(&joints, m)).collect(),
        joints,
        influences: skin.influences,
    };
    let files = write_parts(played, frames, &parts, None)?;
    Ok(bones_file(files, off))
}

/// Writes frames as a GLB with the bones of the rig, and with `has_twists` three more along each limb, among which its twist is
/// spread; weights are fitted to the frames.
///
/// # Errors
/// When a frame cannot be read again, the rig has too many bones, or the model cannot be written as a GLB.
fn write_rig_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    has_twists: bool,
    exec: &Exec<'_>,
) -> Result<PlayedClipFile, F::Failure> {
    let animation = played.animation;
    let sequence = sequence_of(played, frames)?;
    let skeleton = RigSkeleton::of_rig(animation.moving_rig(), has_twists);
    let motions = motions_of(animation, &skeleton, frames);
    let skin = fit_weights(&sequence, &motions, INFLUENCES, exec).map_err(refused)?;
    let off = played.written_error(skeleton.joints.len(), [skin.rms, skin.max]);
    let parts = SkinParts {
        frames: motions.iter().map(|m| moved_joints(&skeleton.joints, m)).collect(),
        joints: skeleton.joints,
        influences: skin.influences,
    };
    Ok(bones_file(write_parts(played, frames, &parts, None)?, off))
}

/// Writes frames as a GLB with the bones of the rig, the model's own weights where the clip is its own, and up to `most`
/// correctives.
///
/// # Errors
/// As [`write_rig_frames`].
fn write_corrected_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    most: usize,
    exec: &Exec<'_>,
) -> Result<PlayedClipFile, F::Failure> {
    let animation = played.animation;
    let model = &animation.model().0;
    let rest: Vec<DVec3> = played.vertices.iter().map(|v| played.rest[*v]).collect();
    let mut wanted: Vec<Vec<Vec3>> = Vec::with_capacity(frames.count());
    for frame in 0..frames.count() {
        let places = frames.positions(frame)?;
        wanted.push(played.vertices.iter().map(|v| places[*v]).collect());
    }
    let rig = animation.moving_rig();
    let all = match animation.own_clip() {
        Some(_) => influences_of_skin(model, rig)?,
        None => bind_model(model, rig, INFLUENCES, exec)?.influences,
    };
    let influences: Vec<BoneInfluences> = played.vertices.iter().map(|v| all[*v]).collect();
    let skeleton = RigSkeleton::of_rig(rig, false);
    let motions = motions_of(animation, &skeleton, frames);
    let skinned = SkinnedFrames {
        rest: &rest,
        influences: &influences,
        motions: &motions,
        wanted: &wanted,
    };
    let found = fit_correctives(&skinned, most, exec).map_err(|_| Error::Cancelled)?;
    let still: Vec<Vec3> = played.rest.iter().map(|p| p.as_vec3()).collect();
    let shape = |shifts: &Vec<DVec3>| {
        let mut shape = still.clone();
        for ((vertex, p), shift) in played.vertices.iter().zip(&rest).zip(shifts) {
            shape[*vertex] = (*p + *shift).as_vec3();
        }
        shape
    };
    let shapes: Vec<Vec<Vec3>> = found.shifts.iter().map(shape).collect();
    let parts = SkinParts {
        frames: motions.iter().map(|m| moved_joints(&skeleton.joints, m)).collect(),
        joints: skeleton.joints,
        influences,
    };
    let correctives = PlayedCorrectives {
        shapes: &shapes,
        weights: &found.weights,
    };
    let files = write_parts(played, frames, &parts, Some(correctives))?;
    let before = played.written_error(parts.joints.len(), found.before);
    let mut error = played.written_error(found.frames.len(), found.after);
    let of: Vec<String> = found
        .frames
        .iter()
        .map(|frame| (animation.range().start + frame).to_string())
        .collect();
    error.message = format!(
        "{} bones are off by {:.3} % of the diagonal (root mean square), {:.3} % at worst; with correctives of frames {} by {:.3} % \
         and {:.3} %",
        before.parts,
        before.rms_percent,
        before.max_percent,
        of.join(", "),
        error.rms_percent,
        error.max_percent
    );
    let error = Some(error);
    Ok(PlayedClipFile { files, error })
}

/// For each frame, how joints move points of the rest pose, as positions are kept.
fn motions_of(animation: &Animation, skeleton: &RigSkeleton, frames: &impl FrameSource) -> Vec<Vec<RigidMotion>> {
    let of_frame = |frame: usize| {
        let seconds = animation.times().at(animation.range().start + frame);
        let pose = animation.driver().pose_at(seconds);
        skeleton.motions_in(animation.moving_rig(), &pose, &frames.root(frame))
    };
    (0..frames.count()).map(of_frame).collect()
}

/// Joints, where they are in each frame, and which of them carry each vertex that is played.
struct SkinParts {
    joints: Vec<PlayedJoint>,
    frames: Vec<Vec<NodePlace>>,
    influences: Vec<BoneInfluences>,
}

/// Writes a skin that plays, with correctives where there are some.
fn write_parts(
    played: &PlayedModel<'_>,
    frames: &impl FrameSource,
    parts: &SkinParts,
    correctives: Option<PlayedCorrectives<'_>>,
) -> Result<WrittenFiles, Error> {
    let times: Vec<f64> = (0..frames.count()).map(|frame| played.seconds(frame)).collect();
    let roots = RootPlaces::of_frames(frames);
    let mut influences = vec![CarryingJoints::default(); played.rest.len()];
    for (vertex, own) in played.vertices.iter().zip(&parts.influences) {
        influences[*vertex] = carrying_joints(own);
    }
    let clip = SkinnedClip {
        name: played.clip_name(),
        influences: &influences,
        joints: &parts.joints,
        times: &times,
        frames: &parts.frames,
        correctives,
        root: roots.keys_of_node(played, &times),
        beside: played.beside(roots.keys_around(played, &times)),
    };
    Ok(played.animation.model().0.write_skinned_clip(&clip)?)
}

/// A file of bones, with the line that reports their error.
fn bones_file(files: WrittenFiles, mut error: WrittenError) -> PlayedClipFile {
    error.message = format!(
        "{} bones play the frames to within {:.3} % of the diagonal (root mean square), {:.3} % at worst",
        error.parts, error.rms_percent, error.max_percent
    );
    let error = Some(error);
    PlayedClipFile { files, error }
}

/// The shapes of all frames, of the vertices that are played.
fn sequence_of<F: FrameSource>(played: &PlayedModel<'_>, frames: &mut F) -> Result<ShapeSequence, F::Failure> {
    let own = &played.vertices;
    let rest: Vec<DVec3> = own.iter().map(|v| played.rest[*v]).collect();
    let mut sequence = ShapeSequence::new(&rest).map_err(refused)?;
    sequence.join(&played.triangles());
    for frame in 0..frames.count() {
        let places = frames.positions(frame)?;
        let places: Vec<DVec3> = own.iter().map(|v| places[*v].as_dvec3()).collect();
        sequence.push(&places).map_err(refused)?;
    }
    Ok(sequence)
}

fn refused(e: DecompositionError) -> Error {
    match e {
        DecompositionError::Cancelled(_) => Error::Cancelled,
        _ => RigError::field("as", format!("is skin, but {e}")).into(),
    }
}

/// Each bone as a joint in the middle of what it carries.
fn resting_joints(skin: &SkinDecomposition) -> Vec<PlayedJoint> {
    let joint = |(bone, centre): (usize, &DVec3)| PlayedJoint {
        name: format!("bone {}", bone + 1),
        parent: None,
        rest: NodePlace {
            translation: *centre,
            rotation: DQuat::IDENTITY,
        },
    };
    skin.centres.iter().enumerate().map(joint).collect()
}
