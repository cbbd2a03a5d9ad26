//! Frames as a GLB with morph targets.

use super::kept_frames::{KeptFrames, PlayedModel, RootPlaces, WrittenOff};
use super::key_frames::choose_key_frames;
use crate::asset::{MorphClip, WrittenFiles};
use crate::wire::Error;

/// Writes frames as a GLB with `most` morph targets, and the motion of the root as a node; and what there is to say of it.
///
/// # Errors
/// When a frame cannot be read again, or the model cannot be written as a GLB.
pub fn write_morph_frames<F: KeptFrames>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    most: usize,
) -> Result<(WrittenFiles, Option<WrittenOff>), F::Failure> {
    let count = frames.count();
    let keys = choose_key_frames(frames, played.vertices, most)?;
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
    let written = played.model.write_morph_clip(&clip).map_err(Error::from)?;
    if keys.chosen.len() == count {
        return Ok((written, None));
    }
    let off = played.written_error(keys.chosen.len(), [keys.rms, keys.error]);
    let told = format!(
        "{count} frames are blended from {} shapes; at worst a vertex is off by {:.3} % of the diagonal",
        off.parts, off.max_percent
    );
    Ok((written, Some((off, told))))
}
