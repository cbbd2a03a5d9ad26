//! glTF 2.0 and GLB, patched instead of rebuilt.
//!
//! What a deformation does not change comes back as it was: the JSON text outside the changed places to the byte, the
//! binary data outside the changed attributes, unknown extensions, extras, custom attributes, animations, skins. Existing indices never change; what is new is appended.
//!
//! Displacements of morph targets turn and grow with the surface around their vertices ([`targets`]), and skeletons follow
//! the body ([`rig`]), unless they are to stay. Other nodes follow on request. [`deformed`] counts what followed.
//!
//! Reading: [`container`] takes a GLB apart, [`document`] parses the sections that geometry needs out of the JSON
//! [`text`], [`references`] checks references and ranges, [`buffers`] finds bytes ([`stored`]) and what URIs name (with [`compressed`]),
//! [`accessors`] reads them, [`draco`] decodes Draco, [`scene`] places meshes and [`placement`] their vertices, [`read`]
//! puts triangles together. A model owns its parsed document for life. [`moving`] reads nodes and clips, [`blends`] blend shapes,
//! [`looks`] materials.
//!
//! Writing: [`deformed`] computes what each attribute should become, [`sharing`] decides what must be copied (with
//! [`used_bytes`]), [`patch`] edits text and bytes ([`patched`]), [`package`] makes the files and puts files beside a .gltf into a GLB.
//! [`builder`] writes every new accessor, buffer view and embedded buffer. [`fresh`] makes an asset from other formats'
//! geometry. After edits of the topology, [`edited`] rewrites primitives; [`references`] finds where a document names
//! accessors and views as well.
//!
//! # Conventions
//! - Positions are in world space; a skinned mesh stands where its joints put it in the rest pose of the scene, its node's
//!   transform ignored. Morph targets are not applied, whatever their default weights.
//! - Triangles of a mesh that is mirrored into the world (negative determinant) are wound the other way round than the
//!   file's indices, so that the outside is outside. The file's indices are never changed.
//! - Quantised and sparse attributes that change come back as plain floats in an accessor of their own.
//! - A vertex whose world position is bit-identical in the rest pose keeps its stored bytes.
//!
//! # What is taken of the `gltf` crate
//! Only its component types. Its document types would read files that this module must read otherwise:
//! - Transforms are 32-bit floats there. Placed positions are computed in 64 bits here, and would change.
//! - A document is read whole, so a wrong value in an animation is an error of the whole file, and an attribute name
//!   that is neither the standard's nor begins with `_` is lost. Here, what geometry does not need is never read.
//! - Numbers such as `3.0` are refused where an index is meant; exporters write them, and here they are read.
//! - Extensions that it does not know become maps of values, whose numbers are reformatted (`1e-05` as `1e-5`); only
//!   `extras` keep their text. Positions in the text, which patching needs, are lost.
//! - Its errors name a path but not what is allowed, and `meshopt` compression and fallback buffers are unknown to it.
//!
//! # Why edits splice text as well
//! An edited document is repacked, but nodes, materials and all that the edit does not change keep their text to the
//! byte: `serde_json::Value` would round-trip numbers (`0.10`, `1e-05`), escapes and white space differently, and
//! refuses values more than 128 levels deep, which `extras` may be.
//!
//! # Clips of solved frames
//! [`played`] adds them to a rest GLB: as morph targets, or as joints that move every vertex; and blend shapes of another model.
//!
//! Must not: open files, fetch URIs, know of solving.

mod accessors;
mod blends;
mod buffers;
mod builder;
mod compressed;
mod container;
mod deformed;
mod document;
mod draco;
mod edited;
mod elements;
mod extensions;
mod fresh;
mod looks;
mod moving;
mod package;
mod patch;
mod patched;
mod placement;
mod played;
mod read;
mod references;
mod rig;
mod scene;
mod schema;
mod sharing;
mod splats;
mod stored;
mod targets;
#[cfg(test)]
mod tests;
mod text;
mod used_bytes;

pub(super) use buffers::media_type_of;
pub(super) use buffers::of_file_name as uri_of_name;
pub(super) use builder::GlbWriter;
pub(super) use compressed::{DECODER as MESHOPT_DECODER, answer as answer_meshopt};
pub(super) use document::{GLB_FORMAT, GLTF_FORMAT};
pub(super) use extensions::extension_table;
pub(super) use fresh::unit_normals;

use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile};
use crate::edited::{EditedModel, PrimitiveRun};
use crate::files::ReadWatch;
use crate::look::SurfaceLook;
use crate::model::is_same;
use crate::moving_scene::{BlendShapes, MovingScene, PlayedClip, PrimitiveShapes, SceneClip};
use crate::neutral::{NeutralModel, RunAttributes};
use crate::vertex_attributes::AttributeKeys;
use crate::{Error, FileSet, FollowedCounts, Format, Model, ModelNode, MorphTargetRule, WrittenFiles};
use glam::DVec3;
use pliant_mesh::BoundingBox;
use pliant_mesh::local_turns::local_turns;
use read::GltfNotes;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Reads and writes GLB and glTF.
pub(super) struct GltfCodec;

impl FormatCodec for GltfCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == GLB_FORMAT || format == GLTF_FORMAT
    }

    fn single_origin(&self, bounds: &BoundingBox) -> Option<DVec3> {
        Some(bounds.origin())
    }

    fn read(&self, files: &FileSet, format: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        let (geometry, notes) = read::read(files, format, watch)?;
        Ok((geometry, Arc::new(notes)))
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        let PatchedOutput {
            model,
            positions,
            format,
            followers,
        } = *output;
        let notes: &GltfNotes = model.notes_or_refuse(format)?;
        let doc = notes.document_to_write(model, followers.exec.map(|exec| exec.progress))?;
        let rest = &model.geometry;
        let tree = rig::FollowedNodeTree::fit(&doc, notes, followers, || {
            rig::shape_of_rows(&doc, notes, rest, positions)
        })?;
        let positions = tree.as_ref().map_or(positions, |tree| &tree.to_write);
        let follows = followers.rules.morph_targets == MorphTargetRule::Follow && targets::has_targets(&doc);
        let shape = deformed::NewShape {
            rest,
            positions,
            turns: follows.then(|| local_turns(&rest.positions, positions, &rest.triangles)),
            fault: container::GltfFault(format),
            exec: followers.exec,
        };
        let mut tally = targets::TargetTally::default();
        let wanted = deformed::wanted_attributes(&doc, notes, &shape, &mut tally)?;
        let plan = sharing::plan_overwrites(&doc, notes, &model.geometry, wanted);
        let written = package::package(notes.files(model), patch::patch(&doc, &plan)?, format)?;
        let clips = doc.items(&doc.animations);
        let mut written = rig::rewrite::finish(tree.as_ref(), written, format, &doc, clips, &tally)?;
        if !is_same(&model.geometry.positions, positions) {
            written
                .warnings
                .extend(extensions::doubtful_extensions(&doc, false, followers.rules.rig));
            let rounded = deformed::rounded_places(&doc, notes, positions, format)?;
            written.warnings.extend(rounded);
            written.warnings.extend(splats::unsound(&doc, notes)?);
        }
        self_contained_if_new(written, model.format, format)
    }

    fn build(&self, neutral: &NeutralModel, format: Format) -> Result<WrittenFiles, Error> {
        fresh::build(neutral, format)
    }

    fn nothing_followed(&self, model: &Model) -> Result<FollowedCounts, Error> {
        let notes: &GltfNotes = model.notes_or_refuse(model.format)?;
        let doc = notes.document(model)?;
        Ok(deformed::nothing_followed(&doc, notes))
    }

    fn beyond_conversion(&self, model: &Model, is_merged: bool) -> Result<Vec<String>, Error> {
        let notes: &GltfNotes = model.notes_or_refuse(model.format)?;
        Ok(extensions::beyond_conversion(&notes.document(model)?, is_merged))
    }

    fn stays_stored(&self, model: &Model, primitive: usize) -> Result<bool, Error> {
        let notes: &GltfNotes = model.notes_or_refuse(model.format)?;
        let row = &notes.rows[primitive];
        let doc = notes.loaded_document(model)?;
        let stored = &doc.meshes.values[row.mesh].primitives[row.primitive];
        Ok(row.triangles.is_empty() && row.placement.transforms(&doc, stored)?.inverse().is_none())
    }

    fn joint_names(&self, model: &Model) -> Result<BTreeSet<String>, Error> {
        let notes: &GltfNotes = model.notes_or_refuse(model.format)?;
        let doc = notes.document(model)?;
        let joints = placement::joint_nodes(&doc).into_iter();
        Ok(joints
            .filter_map(|joint| doc.nodes.values[joint].name.clone())
            .collect())
    }

    fn divides_at_seams(&self) -> bool {
        true
    }

    fn surface_look(&self, model: &Model) -> Result<Option<SurfaceLook>, Error> {
        let notes = model.notes_or_refuse(model.format)?;
        looks::surface_look(model, notes).map(Some)
    }

    fn nodes(&self, model: &Model) -> Result<Option<Vec<ModelNode>>, Error> {
        let notes = model.notes_or_refuse(model.format)?;
        moving::model_nodes(model, notes).map(Some)
    }

    fn moving_scene(&self, model: &Model) -> Result<Option<MovingScene>, Error> {
        moving::moving_scene(model, model.notes_or_refuse(model.format)?).map(Some)
    }

    fn primitive_shapes(&self, model: &Model) -> Result<Option<Vec<PrimitiveShapes>>, Error> {
        moving::primitive_shapes(model, model.notes_or_refuse(model.format)?).map(Some)
    }

    fn blend_shapes(&self, model: &Model) -> Result<BlendShapes, Error> {
        blends::read(model, model.notes_or_refuse(model.format)?)
    }

    fn scene_clip(&self, model: &Model, index: usize) -> Result<Option<SceneClip>, Error> {
        moving::scene_clip(model, model.notes_or_refuse(model.format)?, index)
    }

    fn write_played(&self, rest: &Model, vertices: &[u32], clip: &PlayedClip<'_>) -> Result<WrittenFiles, Error> {
        played::write(rest, rest.notes_or_refuse(rest.format)?, vertices, clip)
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        let first = output
            .edited
            .bases
            .first()
            .map_or(output.format, |base| base.model.format);
        self_contained_if_new(edited::write(output)?, first, output.format)
    }

    fn companion_names(&self, files: &FileSet, format: Format) -> Vec<String> {
        package::companion_names(files, format)
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        edited::run_attributes(edited, runs)
    }

    fn segments(&self, model: &Model) -> Result<Vec<[u32; 2]>, Error> {
        let notes: &GltfNotes = model.notes_or_refuse(model.format)?;
        edited::segments(&notes.loaded_document(model)?, notes)
    }

    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        edited::distinguish_vertices(model, model.notes_or_refuse(model.format)?, keys)
    }
}

/// A GLB that was made of a .gltf needs no file beside it; one that came with files keeps them.
fn self_contained_if_new(written: WrittenFiles, from: Format, to: Format) -> Result<WrittenFiles, Error> {
    if from == GLTF_FORMAT && to == GLB_FORMAT {
        return package::embed_companions(written, container::GltfFault(to));
    }
    Ok(written)
}
