//! The ways in and out: which codec reads a model, and which one writes it, by patching, building or editing.

use super::codec::{EditedOutput, FormatCodec, PatchedOutput, Translation};
use super::edited::{self, CarriedAttributes, EditedModel, PrimitiveRun, RunFaces};
use super::files::ReadWatch;
use super::formats::{codec_of, reader_of, translator_of};
use super::model::is_same;
use super::neutral::{HeldLooks, NeutralModel, RunAttributes, RunPart};
use super::{
    Error, FileSet, Following, Format, Limits, Model, ModelNode, Primitive, ShapeFollowers, VertexAttributes,
    WrittenFiles, WrittenWarning,
};
use glam::DVec3;
use pliant_exec::progress::{Progress, Silent};
use pliant_mesh::BoundingBox;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

/// The extension of Gaussian splats.
const SPLATS_OF_GLTF: &str = "KHR_gaussian_splatting";

impl Model {
    /// Reads a model. The format is `format` when given, else what the bytes say, else what the file name says. A format
    /// that is read only ([`Format::READ`]) becomes a model of another one, with that one's files.
    ///
    /// # Errors
    /// [`Error`] with the place and what is allowed; nothing is read outside `files`.
    ///
    /// # Example
    /// ```
    /// use pliant_asset::{FileSet, Format, Limits, Model};
    ///
    /// let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 # a face\n";
    /// let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default())?;
    /// assert_eq!((model.positions.len(), model.triangles.len()), (3, 1));
    ///
    /// let limits = Limits { vertices: 2, ..Limits::default() };
    /// let error = Model::read(FileSet::single("one.obj", text), Some(Format::OBJ), &limits).unwrap_err();
    /// assert_eq!(error.to_string(), "vertices is 3, at most 2 is allowed");
    /// # Ok::<(), pliant_asset::Error>(())
    /// ```
    pub fn read(files: FileSet, format: Option<Format>, limits: &Limits) -> Result<Self, Error> {
        Self::read_watched(files, format, limits, &Silent)
    }

    /// As [`Model::read`], until `progress` is cancelled.
    ///
    /// # Errors
    /// Those of [`Model::read`], and [`Error::Cancelled`].
    pub fn read_watched(
        files: FileSet,
        format: Option<Format>,
        limits: &Limits,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let model = Self::read_passenger(files, format, limits, progress)?;
        model.geometry.require_triangles(model.format).map_err(|error| {
            let beyond = model.codec().beyond_conversion(&model, false).unwrap_or_default();
            match beyond.iter().any(|name| name == SPLATS_OF_GLTF) {
                true => Error::NoMesh {
                    format: model.format,
                    problem: "Gaussian splats and no triangle; as ply, splat or spz they are a model of their own"
                        .into(),
                },
                false => error,
            }
        })?;
        Ok(model)
    }

    /// As [`Model::read_watched`], for a model that is carried and not deformed: it may be of points or lines alone.
    ///
    /// # Errors
    /// Those of [`Model::read_watched`].
    pub fn read_passenger(
        files: FileSet,
        format: Option<Format>,
        limits: &Limits,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let recognised = || Format::from_file(&files.name, &files.main);
        let Some(format) = format.or_else(recognised) else {
            let place = if files.name.is_empty() {
                "the model".into()
            } else {
                files.name
            };
            let allowed = Format::read_name_list("and");
            return Err(Error::UnknownFormat { place, allowed });
        };
        let watch = ReadWatch::new(limits, progress, files.total_bytes());
        if let Some(translator) = translator_of(format) {
            let Translation {
                files,
                format,
                warnings,
            } = translator.translate(&files, &watch)?;
            let mut model = Self::read_passenger(files, Some(format), limits, progress)?;
            model.geometry.warnings.splice(0..0, warnings);
            return Ok(model);
        }
        let (geometry, notes) = reader_of(&files, format).read(&files, format, &watch)?;
        geometry.check(format, limits)?;
        Ok(Self {
            format,
            geometry,
            files,
            notes,
            apart: limits.apart,
            attributes: OnceLock::new(),
        })
    }

    /// What the files give to the vertices beside their positions, to be compared. Read again when first asked for, then
    /// kept.
    ///
    /// # Errors
    /// [`Error::Cancelled`]. Where something cannot be read, no two vertices are alike.
    pub fn vertex_attributes(&self, progress: &dyn Progress) -> Result<&VertexAttributes, Error> {
        if self.attributes.get().is_none() {
            let codec = self.codec();
            let read =
                VertexAttributes::gather(&self.geometry, |keys| codec.distinguish_vertices(self, keys), progress)?;
            // Another thread may have read the same meanwhile.
            let _ = self.attributes.set(read);
        }
        Ok(self.attributes.get_or_init(VertexAttributes::default))
    }

    /// Writes the model with new positions (one per render vertex, in model space) in `format`.
    ///
    /// In the model's own format (GLB and glTF count as one) the uploaded files are edited: what the deformation did not
    /// change stays as it was, byte for byte, and authored normals, tangents and morph targets follow the deformation. In another
    /// format a fresh file is made of the positions, faces, names, normals, one set of texture coordinates, colours and
    /// base-colour materials with their pictures, as far as both formats know them.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when the count differs from the model's, when a position is not finite, or when it does not
    /// fit the format's numbers.
    ///
    /// # Example
    /// ```
    /// use pliant_asset::{FileSet, Format, Limits, Model};
    ///
    /// let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 # a face\n";
    /// let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default())?;
    /// let mut positions = model.positions.clone();
    /// positions[1].z = 0.5;
    ///
    /// // In its own format one number changes, and the comment stays.
    /// let written = model.write(&positions, Format::OBJ)?;
    /// assert_eq!(written.main, b"v 0 0 0\nv 1 0 0.5\nv 0 1 0\nf 1 2 3 # a face\n");
    ///
    /// // Another format is rebuilt.
    /// let written = model.write(&positions, Format::OFF)?;
    /// assert_eq!(written.main, b"OFF\n3 1 0\n0 0 0\n1 0 0.5\n0 1 0\n3 0 1 2\n");
    /// # Ok::<(), pliant_asset::Error>(())
    /// ```
    pub fn write(&self, positions: &[DVec3], format: Format) -> Result<WrittenFiles, Error> {
        self.write_following(positions, format, Following::default())
    }

    /// As [`Model::write`], with a choice of what else follows the shape; there, everything does.
    ///
    /// # Errors
    /// Those of [`Model::write`].
    pub fn write_following<'a>(
        &self,
        positions: &[DVec3],
        format: Format,
        followers: impl Into<ShapeFollowers<'a>>,
    ) -> Result<WrittenFiles, Error> {
        let (seen, count) = (positions.len(), self.positions.len());
        if seen != count {
            return Err(Error::unwritable(
                format,
                format!("{seen} positions are given, the model has {count} vertices"),
            ));
        }
        if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::unwritable(
                format,
                format!("the position of vertex {i} is {}, not finite", positions[i]),
            ));
        }
        let followers = followers.into();
        let mut written = self.write_checked(positions, format, &followers)?;
        if codec_of(format).patches_files_of(self.format) {
            written.followed.count_nodes(followers.nodes);
        }
        for (number, passenger) in self.geometry.primitives.iter().enumerate() {
            let own = passenger.vertices();
            let has_moved = !is_same(&self.positions[own.clone()], &positions[own]);
            self.count_passenger(number, has_moved, format, &mut written)?;
        }
        Ok(written)
    }

    /// Counts a primitive that rides along, where a file of `format` has it.
    fn count_passenger(
        &self,
        number: usize,
        has_moved: bool,
        format: Format,
        written: &mut WrittenFiles,
    ) -> Result<(), Error> {
        let primitive = &self.geometry.primitives[number];
        let is_drawn = primitive.index_count == 0;
        if primitive.is_passenger && (!is_drawn || codec_of(format).patches_files_of(self.format)) {
            let moves = has_moved && !(is_drawn && self.codec().stays_stored(self, number)?);
            written.followed.count_passenger(moves);
        }
        Ok(())
    }

    fn write_checked(
        &self,
        positions: &[DVec3],
        format: Format,
        followers: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, Error> {
        if format == self.format && is_same(&self.positions, positions) {
            return Ok(WrittenFiles {
                followed: codec_of(format).nothing_followed(self)?,
                ..WrittenFiles::from_upload(&self.files)
            });
        }
        check_precision(format, positions, &self.geometry.triangles)?;
        let codec = self.writer(format)?;
        if codec.patches_files_of(self.format) {
            return codec.patch_positions(&PatchedOutput {
                model: self,
                positions,
                format,
                followers,
            });
        }
        self.geometry.require_triangles(self.format).map_err(|_| {
            let problem = format!("points and lines without triangles come back as {} alone", self.format);
            Error::unwritable(format, problem)
        })?;
        let neutral = if codec.held_looks() == HeldLooks::NONE {
            NeutralModel::from_geometry(self.geometry.deformed(positions))
        } else {
            neutral_model(self, positions, format)?
        };
        let mut written = codec.build(&neutral, format)?;
        let mut beyond = self.codec().beyond_conversion(self, false)?;
        beyond.extend(edited::with_whole_model(self, |edited| {
            looks_beyond(edited, positions, format)
        })?);
        written.warnings.extend(WrittenWarning::left_out(&beyond, format, ""));
        written.warnings.extend(unit_warning(self, format));
        Ok(written)
    }

    /// The names of the joints of the model, of its skins in the order of the alphabet.
    ///
    /// # Errors
    /// [`Error`] when the files cannot be read again.
    pub fn joint_names(&self) -> Result<Vec<String>, Error> {
        Ok(self.codec().joint_names(self)?.into_iter().collect())
    }

    /// The nodes of the model's file, by their index there; `None` for a model of a format without nodes, which all but glTF are.
    ///
    /// # Errors
    /// [`Error`] when the files cannot be read again.
    pub fn nodes(&self) -> Result<Option<Vec<ModelNode>>, Error> {
        self.codec().nodes(self)
    }
}

/// The names of files that a model refers to and that are not in the set: buffers and images of a glTF,
/// material libraries of an OBJ and their pictures, pictures of an FBX. They are
/// relative to the folder of the main file and never lead out of it. Companions may name more files: call this again
/// until it returns no new name.
///
/// # Example
/// ```
/// use pliant_asset::{FileSet, missing_companions};
///
/// let json = r#"{"asset":{"version":"2.0"},"images":[{"uri":"red%20brick.png"},{"uri":"../up.png"}]}"#;
/// let files = FileSet::single("wall.gltf", json);
/// assert_eq!(missing_companions(&files), ["red brick.png"]);
/// ```
pub fn missing_companions(files: &FileSet) -> Vec<String> {
    let Some(format) = Format::from_file(&files.name, &files.main) else {
        return Vec::new();
    };
    let mut names = match translator_of(format) {
        Some(translator) => translator.companion_names(files),
        None => codec_of(format).companion_names(files, format),
    };
    names.retain(|name| !files.companions.contains_key(name));
    names
}

/// The segments of the lines of an edited model, by its vertices: those of the files, as edits have divided and shortened them. Of
/// points of glTF both ends are one.
///
/// # Errors
/// [`Error::Malformed`] for lines that cannot be read.
pub fn line_segments(edited: &EditedModel<'_>) -> Result<Vec<[u32; 2]>, Error> {
    edited::segments_of(edited, |model| model.codec().segments(model))
}

/// Writes an edited model with its vertices at `positions` (in world space, one per vertex of the blends).
///
/// In the first base's own format (GLB and glTF count as one) the first base's file is the frame: whatever the edit did
/// not touch stays. Other bases join it: with nodes, materials and images where both are glTF, as plain geometry
/// otherwise. In another format a fresh file is made.
///
/// # Errors
/// [`Error::Unwritable`] when the description does not hold together, a position is not finite or does not fit the
/// format's numbers, no triangle is left, or the result is too large.
///
/// # Example
/// A triangle is cut in two: the new vertex lies in the middle of an edge, and its colour between those of the ends.
/// ```
/// use glam::{DAffine3, DVec3};
/// use pliant_asset::{BaseModel, CapLooks, EditedModel, FileSet, Format, Limits, Model, PrimitiveRun, VertexBlends};
///
/// let text = "v 0 0 0 1 0 0\nv 1 0 0 0 0 1\nv 0 1 0 0 0 0\nf 1 2 3\n";
/// let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default())?;
/// let mut blends = VertexBlends::identity(3);
/// blends.push_blend(&[(0, 0.5), (1, 0.5)]);
/// let edited = EditedModel {
///     bases: &[BaseModel { model: &model, world_from_model: DAffine3::IDENTITY }],
///     runs: &[PrimitiveRun { base: 0, primitive: 0, first_vertex: 0, vertex_count: 4, first_triangle: 0, triangle_count: 2 }],
///     blends: &blends,
///     triangles: &[[0, 3, 2], [3, 1, 2]],
///     origins: &[],
///     bare: &[],
///     caps: CapLooks::default(),
/// };
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X * 0.5];
/// let written = pliant_asset::write_edited_model(&edited, &positions, Format::OBJ)?;
/// let text = String::from_utf8_lossy(&written.main);
/// assert_eq!(text, "v 0 0 0 1 0 0\nv 1 0 0 0 0 1\nv 0 1 0 0 0 0\nv 0.5 0 0 0.5 0 0.5\nf 1 4 3\nf 4 2 3\n");
/// # Ok::<(), pliant_asset::Error>(())
/// ```
pub fn write_edited_model(
    edited: &EditedModel<'_>,
    positions: &[DVec3],
    format: Format,
) -> Result<WrittenFiles, Error> {
    write_edited_model_following(edited, positions, format, Following::default())
}

/// As [`write_edited_model`], with a choice of what else follows the shape; there, everything does.
///
/// # Errors
/// Those of [`write_edited_model`].
pub fn write_edited_model_following<'a>(
    edited: &EditedModel<'_>,
    positions: &[DVec3],
    format: Format,
    followers: impl Into<ShapeFollowers<'a>>,
) -> Result<WrittenFiles, Error> {
    edited::check(edited, positions, format)?;
    check_precision(format, positions, edited.triangles)?;
    let followers = followers.into();
    let mut written = write_checked_edit(edited, positions, format, &followers)?;
    if (edited.bases.first()).is_some_and(|base| codec_of(format).patches_files_of(base.model.format)) {
        written.followed.count_nodes(followers.nodes);
    }
    for run in edited.runs.iter().filter(|run| edited.primitive(run).is_passenger) {
        let before = CarriedAttributes::before(edited, run);
        let has_moved = !is_same(&before, &positions[run.vertices()]);
        let model = edited.base(run).model;
        model.count_passenger(run.primitive as usize, has_moved, format, &mut written)?;
    }
    Ok(written)
}

fn write_checked_edit(
    edited: &EditedModel<'_>,
    positions: &[DVec3],
    format: Format,
    followers: &ShapeFollowers<'_>,
) -> Result<WrittenFiles, Error> {
    let Some(first) = edited.bases.first() else {
        return Err(Error::unwritable(format, "there is no base"));
    };
    let codec = first.model.writer(format)?;
    let is_whole = codec.patches_files_of(first.model.format);
    let mut beyond = Vec::new();
    for (k, base) in edited.bases.iter().enumerate().skip(usize::from(is_whole)) {
        let is_merged = is_whole && codec.patches_files_of(base.model.format);
        let things = base.model.codec().beyond_conversion(base.model, is_merged)?;
        let of = if k == 0 {
            String::new()
        } else {
            format!("of merged model {k} ")
        };
        beyond.extend(WrittenWarning::left_out(&things, format, &of));
        beyond.extend(unit_warning(base.model, format));
    }
    let looks = looks_beyond(edited, positions, format)?;
    beyond.extend(WrittenWarning::left_out(&looks, format, ""));
    let mut written = if codec.edits(first.model.format) {
        write_into_frame(codec, edited, positions, format, followers)?
    } else {
        codec.build(&neutral_edited_model(edited, positions, format)?, format)?
    };
    written.warnings.extend(beyond);
    Ok(written)
}

/// The warning of numbers in another unit than metres in a glTF, which has no other.
fn unit_warning(model: &Model, format: Format) -> Option<WrittenWarning> {
    let is_in_metres = codec_of(Format::GLB).patches_files_of(format);
    let (unit, metres) = model.codec().unit_of(model).filter(|_| is_in_metres)?;
    let message = format!(
        "the {format} has the numbers of the {}, of which the unit is {unit}, and is in metres: scale it by {metres}",
        model.format
    );
    (metres != 1.0).then(|| WrittenWarning::new("unit", message, ""))
}

/// What a file of `format` does not hold of how bases of other formats look, in words.
fn looks_beyond(edited: &EditedModel<'_>, positions: &[DVec3], format: Format) -> Result<Vec<String>, Error> {
    let codec = codec_of(format);
    let held = codec.held_looks();
    let mut neutral = NeutralModel::default();
    for (base, k) in edited.bases.iter().zip(0..) {
        if held != HeldLooks::ALL && !codec.patches_files_of(base.model.format) {
            // As a GLB would hold it, whose parts have one material each.
            add_base(&mut neutral, edited, k, positions, Format::GLB)?;
        }
    }
    Ok(neutral.looks_beyond(held))
}

/// Writes an edited model into the file of its first base.
fn write_into_frame(
    codec: &dyn FormatCodec,
    edited: &EditedModel<'_>,
    positions: &[DVec3],
    format: Format,
    followers: &ShapeFollowers<'_>,
) -> Result<WrittenFiles, Error> {
    let neutral_base = |base: u32| {
        let mut neutral = NeutralModel::default();
        add_base(&mut neutral, edited, base, positions, format)?;
        Ok(neutral)
    };
    codec.write_edited(&EditedOutput {
        edited,
        positions,
        format,
        followers,
        neutral_base: &neutral_base,
        run_faces: &|run| faces_of_run(edited, run),
    })
}

/// The name of a file without folders and extension, of plain characters.
fn file_stem(name: &str) -> String {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let stem = last.rsplit_once('.').map_or(last, |(stem, _)| stem);
    let plain = |c: char| {
        if c.is_alphanumeric() || "-_".contains(c) {
            c
        } else {
            '_'
        }
    };
    stem.chars().take(80).map(plain).collect()
}

/// The faces of a run, where some have more than three corners.
fn faces_of_run(edited: &EditedModel<'_>, run: &PrimitiveRun) -> Option<RunFaces> {
    let model = edited.base(run).model;
    let outlines = model.codec().face_outlines(model)?;
    RunFaces::of_run(edited, run, outlines)
}

/// The neutral form of an edited model, for files of `format`.
fn neutral_edited_model(edited: &EditedModel<'_>, positions: &[DVec3], format: Format) -> Result<NeutralModel, Error> {
    let first = edited.bases.first().map(|base| base.model);
    let at_rest = first.map(|model| BoundingBox::of(&model.geometry.positions).origin());
    let mut neutral = NeutralModel {
        stem: file_stem(first.map_or("", |model| &model.files.name)),
        origin: at_rest.unwrap_or_default(),
        in_metres: first.is_some_and(|model| codec_of(Format::GLB).patches_files_of(model.format)),
        ..NeutralModel::default()
    };
    for base in 0..edited.bases.len() as u32 {
        add_base(&mut neutral, edited, base, positions, format)?;
    }
    Ok(neutral)
}

/// The neutral form of a model that no edit has changed, at new positions: as if an edit had kept every vertex.
pub(super) fn neutral_model(model: &Model, positions: &[DVec3], format: Format) -> Result<NeutralModel, Error> {
    edited::with_whole_model(model, |edited| neutral_edited_model(edited, positions, format))
}

/// Adds what comes from one base of an edited model.
fn add_base(
    neutral: &mut NeutralModel,
    edited: &EditedModel<'_>,
    base: u32,
    positions: &[DVec3],
    format: Format,
) -> Result<(), Error> {
    let runs: Vec<&PrimitiveRun> = edited.runs_with_triangles(base).collect();
    let Some(held) = edited.bases.get(base as usize).filter(|_| !runs.is_empty()) else {
        return Ok(());
    };
    let source = held.model.codec();
    let divides = codec_of(format).divides_at_seams();
    // Read once for all runs, and not at all for those that are divided.
    let mut attributes = None;
    for (&run, object) in runs.iter().zip(objects_of(&held.model.geometry.primitives, &runs)) {
        let mut parts = None;
        let cap = edited.cap_material(run);
        if (divides || source.divides_by_look()) && cap.is_none() {
            parts = source.seam_parts(edited, run, positions)?;
        }
        if parts.is_none() {
            let attributes = match &mut attributes {
                Some(attributes) => attributes,
                none => none.insert(source.run_attributes(edited, &runs)?.into_iter()),
            };
            let mut own = attributes.next().unwrap_or_default();
            if let Some(name) = cap {
                own = RunAttributes::of_cap(name, edited.cap_uv(run));
            }
            let mut part = RunPart::of_run(edited, run, positions, own);
            if divides && !part.attributes.corner_uv.is_empty() {
                part.divide();
            } else {
                part.attributes.faces = faces_of_run(edited, run);
            }
            parts = Some(vec![part]);
        }
        for part in parts.into_iter().flatten() {
            neutral.push_part(edited, run, positions, part, format)?;
            if let Some(own) = neutral.attributes.last_mut() {
                own.of_object = object;
            }
        }
    }
    Ok(())
}

/// For each run the first triangle of the object that it is a part of. Runs of one primitive are parts of one object, and so are primitives
/// of one mesh at one node; formats without nodes give all their primitives the same place.
fn objects_of(primitives: &[Primitive], runs: &[&PrimitiveRun]) -> Vec<u32> {
    let place = |own: &Primitive| (own.node, own.mesh, own.primitive);
    let has_nodes = primitives.iter().map(place).collect::<BTreeSet<_>>().len() == primitives.len();
    let mut first_triangles = BTreeMap::new();
    let of_run = |run: &&PrimitiveRun| {
        let key = match primitives.get(run.primitive as usize).filter(|_| has_nodes) {
            Some(own) => (own.node, own.mesh),
            None => (run.primitive, 0),
        };
        *first_triangles.entry(key).or_insert(run.first_triangle)
    };
    runs.iter().map(of_run).collect()
}

/// Rejects a model whose every triangle collapses in the format's positions. One remaining triangle makes a model that
/// opens. A model that had no triangle before is not rejected here.
pub(super) fn check_precision(format: Format, positions: &[DVec3], triangles: &[[u32; 3]]) -> Result<(), Error> {
    let origin = codec_of(format).single_origin(&BoundingBox::of(positions));
    let Some(origin) = origin.filter(|_| !triangles.is_empty()) else {
        return Ok(());
    };
    let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
    let is_apart = |[a, b, c]: [DVec3; 3]| a != b && b != c && c != a;
    let rounded = |p: DVec3| (p - origin).as_vec3().as_dvec3();
    let mut was_apart = triangles.iter().filter(|t| is_apart(corners(t))).peekable();
    if was_apart.peek().is_none() || was_apart.any(|t| is_apart(corners(t).map(rounded))) {
        return Ok(());
    }
    let far = positions.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let problem = format!(
        "its positions have seven digits, and at coordinates of {far:.3e} every one of {} triangles collapses in them; \
         move the model nearer to the origin, or write obj, ply or off",
        triangles.len()
    );
    Err(Error::unwritable(format, problem))
}
