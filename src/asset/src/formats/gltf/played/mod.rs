//! Clips of solved frames in a GLB: as morph targets ([`morphs`]), or as joints that move every vertex ([`joints`]); and blend shapes
//! with their own clips ([`shapes`]), which leave skins as they are.
//!
//! The rest file stays as it is except for what is played: [`document`] tracks nodes and meshes that change and makes
//! the files, puts nodes into scenes, decides which clips stay and writes the new clip; [`morphs`] computes rest positions
//! in their own space and rewrites primitives, and [`beside`] carries on what of the file's own clip moves the rest.
//!
//! # Decisions
//! - A mesh that a skin placed is drawn in model space by a node of its own at the top of the scene. Its old node stays
//!   where it was, without the mesh. Joints stay as plain nodes: they may have other children.
//! - A mesh that several nodes draw becomes one for each of them.
//! - Morph targets that were there go. So do clips that move joints of an unused skin, parents of such joints, or
//!   weights of removed morph targets; all other clips stay.
//! - Where the frames are of a clip of the file, nodes without a skin are not played: the new clip moves them, and what joints
//!   carry, as that clip did. Its keys are cut to the frames' time.
//! - Primitives without triangles in a mesh that is played keep their place in their own space; their targets are zero,
//!   because all primitives of a mesh must have as many.
//! - Data that nothing uses any more stays in the file's buffer.

mod beside;
mod document;
mod joints;
mod morphs;
mod shapes;

use super::read::GltfNotes;
use crate::moving_scene::PlayedClip;
use crate::{Error, Model, WrittenFiles};
use document::PlayedDocument;

/// Writes a model's rest pose with a clip. `vertices`: for each vertex of the model that of the clip.
pub(super) fn write(
    rest: &Model,
    notes: &GltfNotes,
    vertices: &[u32],
    clip: &PlayedClip<'_>,
) -> Result<WrittenFiles, Error> {
    let doc = notes.loaded_document(rest)?;
    let mut played = PlayedDocument::new(&doc);
    let sections = match clip {
        PlayedClip::Morphs(clip) => morphs::add_clip(&mut played, rest, notes, vertices, clip)?,
        PlayedClip::Joints(clip) => joints::add_clip(&mut played, rest, notes, vertices, clip)?,
        PlayedClip::Shapes(shapes) => shapes::add_shapes(&mut played, rest, notes, vertices, shapes)?,
    };
    played.finish(notes.files(rest), sections)
}
