//! Frames as a GLB with morph targets.

use super::frames_file::FramesFile;
use super::key_frames::choose_key_frames;
use super::taken_frames::PlayedAnimation;
use crate::asset::{MorphClip, NodeKeys, NodePlace};
use crate::cli::failure::CliFailure;
use crate::motion::rig::RigidMotion;
use crate::wire::{Error, pb};
use std::path::Path;

/// Writes frames as a GLB with `most` morph targets, and the motion of the root as a node where `has_root`; tells how
/// far it is off.
pub(super) fn write_morphs(
    path: &Path,
    played: &PlayedAnimation<'_>,
    frames: &mut FramesFile,
    (most, has_root): (usize, bool),
    report: &mut pb::AnimationReport,
) -> Result<(), CliFailure> {
    let count = played.range.len();
    let keys = choose_key_frames(frames, &played.played_vertices(), count, most)?;
    let first = played.range.start;
    let seconds = |frame: usize| played.seconds(first + frame);
    let times: Vec<f64> = keys.chosen.iter().map(|frame| seconds(*frame)).collect();
    let all: Vec<f64> = (0..count).map(seconds).collect();
    let roots = frames.frames.iter().take(count);
    let places: Vec<NodePlace> = roots.map(|frame| node_place(&frame.root)).collect();
    let moves = places.iter().any(|place| *place != NodePlace::IDENTITY);
    let back: Vec<NodePlace> = places.iter().map(back_from).collect();
    let [root, around] = [(&places, has_root), (&back, !has_root)]
        .map(|(places, is_wanted)| (moves && is_wanted).then_some(NodeKeys { times: &all, places }));
    let clip = MorphClip {
        name: if played.clip.is_empty() { "clip" } else { played.clip },
        times: &times,
        shapes: &keys.shapes,
        root,
        beside: played.beside(around),
    };
    let model = played.deformer.model();
    let written = model.write_morph_clip(&clip).map_err(Error::from)?;
    played
        .permission
        .write_model(path, &written, played.model, played.files)?;
    if keys.chosen.len() == count {
        return Ok(());
    }
    let off = written_error(played, keys.chosen.len(), [keys.rms, keys.error]);
    report.warnings.push(format!(
        "{count} frames are blended from {} shapes; at worst a vertex is off by {:.3} % of the diagonal",
        keys.chosen.len(),
        off.max_percent
    ));
    report.written_error = Some(off);
    Ok(())
}

/// Where a node is that moves as a root does.
pub(super) fn node_place(root: &RigidMotion) -> NodePlace {
    NodePlace {
        translation: root.to - root.rotation * root.from,
        rotation: root.rotation,
    }
}

/// What takes what a node moves back to where it was.
pub(super) fn back_from(place: &NodePlace) -> NodePlace {
    let rotation = place.rotation.inverse();
    NodePlace {
        translation: -(rotation * place.translation),
        rotation,
    }
}

/// How far so many parts are off, of a root mean square and a largest distance.
pub(super) fn written_error(
    played: &PlayedAnimation<'_>,
    parts: usize,
    lengths: [f64; 2],
) -> pb::animation_report::WrittenError {
    let diagonal = played.deformer.diagonal();
    let [rms_percent, max_percent] = lengths.map(|length| match diagonal > 0.0 {
        true => 100.0 * length / diagonal,
        false => 0.0,
    });
    pb::animation_report::WrittenError {
        rms_percent,
        max_percent,
        parts: u32::try_from(parts).unwrap_or(u32::MAX),
    }
}
