//! What every format implements: reading, patching positions, building, and writing an edited model.
//!
//! Knows no format. The formats implement [`FormatCodec`] in [`formats`](super::formats), or [`FormatTranslator`] where they
//! are read only; [`write`](super::write) and
//! [`Model::read`](super::Model::read) call it.

use super::edited::{EditedModel, FaceOutlines, PrimitiveRun, RunFaces};
use super::files::ReadWatch;
use super::look::SurfaceLook;
use super::model::FileNotes;
use super::moving_scene::{BlendShapes, MovingScene, PlayedClip, PrimitiveShapes, SceneClip};
use super::neutral::{HeldLooks, NeutralModel, RunAttributes, RunPart};
use super::vertex_attributes::AttributeKeys;
use super::{Error, FileSet, FollowedCounts, Format, Geometry, Model, ModelNode, ShapeFollowers, WrittenFiles};
use glam::DVec3;
use pliant_mesh::BoundingBox;
use std::collections::BTreeSet;
use std::sync::Arc;

/// What a reader returns: the mesh that the files describe, and what the writers have to remember of the files.
pub(super) type ReadFile = (Geometry, Arc<dyn FileNotes>);

/// Patches a model that is one text file: `patch` gets the text, the notes, the rest mesh and the new positions.
pub(super) fn patch_text_file<N: FileNotes>(
    output: &PatchedOutput<'_>,
    patch: impl FnOnce(&[u8], &N, &Geometry, &[DVec3]) -> Vec<u8>,
) -> Result<WrittenFiles, Error> {
    let model = output.model;
    let notes = model.notes_or_refuse(output.format)?;
    Ok(WrittenFiles {
        main: patch(&model.files.main, notes, &model.geometry, output.positions),
        ..WrittenFiles::from_upload(&model.files)
    })
}

/// Reads and writes one format, or the forms of one (GLB and glTF).
pub(super) trait FormatCodec: Sync {
    /// Whether a model that was read as `source` is written by patching its files; others are rebuilt.
    fn patches_files_of(&self, source: Format) -> bool;

    /// Reads a model in the form `format`. The caller checks it with [`Geometry::check`].
    fn read(&self, files: &FileSet, format: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error>;

    /// The names of the files that a model's main file and its companions so far name, relative to the main file's
    /// folder and inside of it, each once. Nothing is checked: what cannot be taken apart names none.
    fn companion_names(&self, files: &FileSet, format: Format) -> Vec<String> {
        let _ = (files, format);
        Vec::new()
    }

    /// Writes the files of a model of this codec with its vertices in other places. Bytes that neither the deformation nor its
    /// followers change stay as uploaded.
    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error>;

    /// The counts of a model of this codec that is returned unchanged: what could follow its shape.
    fn nothing_followed(&self, model: &Model) -> Result<FollowedCounts, Error> {
        let _ = model;
        Ok(FollowedCounts::default())
    }

    /// Whether a primitive of points or lines of a model that this codec has read stays as it is stored, wherever its vertices go.
    fn stays_stored(&self, model: &Model, primitive: usize) -> Result<bool, Error> {
        let _ = (model, primitive);
        Ok(false)
    }

    /// The names of the joints of a model that this codec has read.
    fn joint_names(&self, model: &Model) -> Result<BTreeSet<String>, Error> {
        let _ = model;
        Ok(BTreeSet::new())
    }

    /// Makes fresh files of a model that came in another format.
    fn build(&self, neutral: &NeutralModel, format: Format) -> Result<WrittenFiles, Error>;

    /// What a model of this codec has that no other format takes, or none but this one when it is merged into another
    /// model: so many of each, in words.
    fn beyond_conversion(&self, model: &Model, is_merged: bool) -> Result<Vec<String>, Error> {
        let _ = (model, is_merged);
        Ok(Vec::new())
    }

    /// The unit of the numbers of a model of this codec and how many metres it has; `None` where the format says none.
    fn unit_of(&self, model: &Model) -> Option<(String, f64)> {
        let _ = model;
        None
    }

    /// What positions within `bounds` are relative to in this format where they are single precision there; `None` where they are doubles.
    fn single_origin(&self, bounds: &BoundingBox) -> Option<DVec3> {
        let _ = bounds;
        None
    }

    /// What files of this format hold of how models of other formats look.
    fn held_looks(&self) -> HeldLooks {
        HeldLooks::ALL
    }

    /// Whether [`FormatCodec::write_edited`] takes a model whose first base came in `format`; others are built from
    /// their neutral form.
    fn edits(&self, format: Format) -> bool {
        self.patches_files_of(format)
    }

    /// Writes an edited model.
    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error>;

    /// What a model that this codec has read looks like; `None` for formats that say it by way of a GLB.
    fn surface_look(&self, model: &Model) -> Result<Option<SurfaceLook>, Error> {
        let _ = model;
        Ok(None)
    }

    /// The nodes of a model that this codec has read, by their index in the file; `None` for formats without nodes.
    fn nodes(&self, model: &Model) -> Result<Option<Vec<ModelNode>>, Error> {
        let _ = model;
        Ok(None)
    }

    /// What moves in the scene of a model that this codec has read; `None` for formats that know no motion.
    fn moving_scene(&self, model: &Model) -> Result<Option<MovingScene>, Error> {
        let _ = model;
        Ok(None)
    }

    /// The primitives of that scene with their morph targets.
    fn primitive_shapes(&self, model: &Model) -> Result<Option<Vec<PrimitiveShapes>>, Error> {
        let _ = model;
        Ok(None)
    }

    /// A clip of that scene.
    fn scene_clip(&self, model: &Model, index: usize) -> Result<Option<SceneClip>, Error> {
        let _ = (model, index);
        Ok(None)
    }

    /// The blend shapes of a model that this codec has read; none for formats that know none.
    fn blend_shapes(&self, model: &Model) -> Result<BlendShapes, Error> {
        let _ = model;
        Ok(BlendShapes::default())
    }

    /// Writes the rest pose of a model that this codec has read, with a clip. `vertices`: for each of its vertices the
    /// one of the clip that it is or copies. Counts and times have been checked.
    fn write_played(&self, rest: &Model, vertices: &[u32], clip: &PlayedClip<'_>) -> Result<WrittenFiles, Error> {
        let _ = (vertices, clip);
        Err(Error::unwritable(rest.format, "it holds no clips"))
    }

    /// Which faces of a model that this codec has read have more than three corners; `None` when all are triangles.
    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        let _ = model;
        None
    }

    /// The segments of the lines of a model that this codec has read, by their render vertices; of points of glTF both ends are one.
    fn segments(&self, model: &Model) -> Result<Vec<[u32; 2]>, Error> {
        let _ = model;
        Ok(Vec::new())
    }

    /// Texture coordinates, colours and materials of runs of one base that this codec has read, for other formats: one
    /// for each run, or none for any.
    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        let _ = (edited, runs);
        Ok(Vec::new())
    }

    /// A run of a base of this codec, divided so that every vertex has one texture coordinate, normal and material.
    /// `None` for formats that have no more than that anyway.
    fn seam_parts(
        &self,
        edited: &EditedModel<'_>,
        run: &PrimitiveRun,
        positions: &[DVec3],
    ) -> Result<Option<Vec<RunPart>>, Error> {
        let _ = (edited, run, positions);
        Ok(None)
    }

    /// Whether [`FormatCodec::seam_parts`] divides runs for every format, as triangles of one run look different by their material.
    fn divides_by_look(&self) -> bool {
        false
    }

    /// Adds to `keys` what a model's files give to each vertex or to the faces around it, beside positions, normals and
    /// tangents. Vertices that no reader can distinguish get equal keys.
    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        let _ = (model, keys);
        Ok(())
    }

    /// Whether models built in this format have their vertices divided at seams, as [`FormatCodec::seam_parts`] does it,
    /// and by [`RunAttributes::corner_uv`] where a format has no more than those.
    fn divides_at_seams(&self) -> bool {
        false
    }
}

/// A model with a new shape on its way to a file.
pub(super) struct PatchedOutput<'a> {
    /// The model.
    pub model: &'a Model,
    /// Where its vertices are, in world space: one for each, and finite.
    pub positions: &'a [DVec3],
    /// The format of the file.
    pub format: Format,
    /// What else of the file follows.
    pub followers: &'a ShapeFollowers<'a>,
}

/// An edited model on its way to a file. It has been checked.
pub(super) struct EditedOutput<'a> {
    /// The model.
    pub edited: &'a EditedModel<'a>,
    /// Where its vertices are, in world space.
    pub positions: &'a [DVec3],
    /// The format of the file.
    pub format: Format,
    /// What else of the file follows.
    pub followers: &'a ShapeFollowers<'a>,
    /// The neutral form of what comes from the base of that number, for bases of other formats.
    pub neutral_base: &'a dyn Fn(u32) -> Result<NeutralModel, Error>,
    /// For each run of the edited model its faces, where some have more than three corners.
    pub run_faces: &'a dyn Fn(&PrimitiveRun) -> Option<RunFaces>,
}

/// Reads a format that is not written: its files become those of one that is, and from there on the model is one of that.
pub(super) trait FormatTranslator: Sync {
    /// As [`FormatCodec::companion_names`].
    fn companion_names(&self, files: &FileSet) -> Vec<String>;

    /// Makes the files of the other format, for a reader with the same limits.
    fn translate(&self, files: &FileSet, watch: &ReadWatch<'_>) -> Result<Translation, Error>;
}

/// What a [`FormatTranslator`] makes of a model.
pub(super) struct Translation {
    /// The files of the other format.
    pub files: FileSet,
    /// The other format, which has a codec.
    pub format: Format,
    /// Places where a choice was made: (code, message, where).
    pub warnings: Vec<(String, String, String)>,
}
