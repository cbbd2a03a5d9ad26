//! What a model looks like, what moves in its scene, and its rest pose with the frames of an animation, as a GLB that any engine plays.

use super::formats::writer_of;
use super::look::{DrawnModel, SurfaceLook};
use super::moving_scene::{
    BlendShapes, ClipBeside, MorphClip, MovingScene, NodeKeys, PlayedClip, PlayedJoint, PrimitiveShapes, SceneClip,
    SkinnedClip,
};
use super::neutral::HeldLooks;
use super::write::neutral_model;
use super::{Error, Format, Model, WrittenFiles};

impl Model {
    /// The surface of the model and its look.
    ///
    /// # Errors
    /// [`Error`] when attributes that are there cannot be read. A problem of a picture is in its place in
    /// [`SurfaceLook::images`] instead.
    ///
    /// # Example
    /// ```
    /// use pliant_asset::{FileSet, Limits, Model};
    ///
    /// let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
    ///     property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
    ///     property list uchar int vertex_indices\nend_header\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n";
    /// let model = Model::read(FileSet::single("red.ply", text), None, &Limits::default())?;
    /// let drawn = model.drawn()?;
    /// assert_eq!(drawn.geometry.positions, model.positions);
    /// assert_eq!(drawn.look.colours, [[1.0, 0.0, 0.0, 1.0]; 3]);
    /// # Ok::<(), pliant_asset::Error>(())
    /// ```
    pub fn drawn(&self) -> Result<DrawnModel, Error> {
        let codec = self.codec();
        let look = match codec.surface_look(self)? {
            None if codec.held_looks() != HeldLooks::NONE => return self.drawn_with_copies(),
            None => SurfaceLook::of_materials(self.primitives.iter().map(|_| None)),
            Some(look) => look,
        };
        Ok(DrawnModel {
            vertices: (0..self.positions.len() as u32).collect(),
            triangles: (0..self.geometry.triangles.len() as u32).collect(),
            geometry: self.geometry.clone(),
            look,
        })
    }

    /// As the model would be written as a GLB, with vertices copied at seams.
    fn drawn_with_copies(&self) -> Result<DrawnModel, Error> {
        let neutral = neutral_model(self, &self.positions, Format::GLB)?;
        let materials = neutral.attributes.iter().map(|own| own.material.as_deref());
        let mut look = SurfaceLook::of_materials(materials);
        look.uv = neutral.uv;
        look.colours = neutral.colours;
        Ok(DrawnModel {
            geometry: neutral.geometry,
            look,
            vertices: neutral.copy_of,
            triangles: neutral.source_triangles,
        })
    }
}

impl Model {
    /// What moves in the model's scene; `None` for formats that know no motion.
    ///
    /// # Errors
    /// [`Error`] when what places vertices cannot be read.
    pub fn moving_scene(&self) -> Result<Option<MovingScene>, Error> {
        self.codec().moving_scene(self)
    }

    /// Reads a clip by its number in [`MovingScene::clip_names`]; `None` where there is none.
    ///
    /// # Errors
    /// [`Error`] with the channel that cannot be read: one that names what is not there, or whose numbers do not fit.
    pub fn scene_clip(&self, index: usize) -> Result<Option<SceneClip>, Error> {
        self.codec().scene_clip(self, index)
    }

    /// Where the vertices of all primitives are stored, and what their morph targets do to them, in the order of
    /// [`MovingScene::primitives`]; `None` for formats that know no motion.
    ///
    /// # Errors
    /// [`Error`] for targets that cannot be read, or are too many.
    pub fn primitive_shapes(&self) -> Result<Option<Vec<PrimitiveShapes>>, Error> {
        self.codec().primitive_shapes(self)
    }
}

impl Model {
    /// The blend shapes of the model; none for formats that know none.
    ///
    /// # Errors
    /// [`Error`] for targets or clips that cannot be read, or are too many.
    pub fn blend_shapes(&self) -> Result<BlendShapes, Error> {
        self.codec().blend_shapes(self)
    }

    /// Writes the model as a GLB with these blend shapes. What they move gets them in place of those that it has, and clips lose
    /// the weights of the latter; all else stays.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when a shape has another number of vertices or a number that is not finite, or the model does not
    /// fit a GLB.
    ///
    /// # Example
    /// ```
    /// use glam::Vec3;
    /// use pliant_asset::{BlendShape, BlendShapes, FileSet, Limits, Model};
    ///
    /// let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    /// let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default())?;
    /// let lift = BlendShape { name: "lift".into(), moves: vec![Vec3::ZERO, Vec3::Z, Vec3::ZERO], weight: 0.0 };
    /// let shapes = BlendShapes { shapes: vec![lift], ..BlendShapes::default() };
    /// let written = model.write_blend_shapes(&shapes)?;
    /// let read = Model::read(FileSet::single("one.glb", written.main), None, &Limits::default())?;
    /// assert_eq!(read.blend_shapes()?, shapes);
    /// # Ok::<(), pliant_asset::Error>(())
    /// ```
    pub fn write_blend_shapes(&self, shapes: &BlendShapes) -> Result<WrittenFiles, Error> {
        for shape in &shapes.shapes {
            let (seen, count) = (shape.moves.len(), self.positions.len());
            if seen != count {
                let problem = format!("\"{}\" moves {seen} vertices, the model has {count}", shape.name);
                return Err(Error::unwritable(Format::GLB, problem));
            }
            if let Some(i) = shape.moves.iter().position(|m| !m.is_finite()) {
                let problem = format!("\"{}\" moves vertex {i} by {}, not finite", shape.name, shape.moves[i]);
                return Err(Error::unwritable(Format::GLB, problem));
            }
        }
        self.write_played(&PlayedClip::Shapes(shapes))
    }
}

impl Model {
    /// Writes the rest pose as a GLB, with a morph target for each shape of a clip and an animation of their weights.
    ///
    /// Materials, textures and whatever else the model has stay. Meshes that a skin placed are drawn in model space without
    /// it; morph targets that were there go; and so do clips that moved those joints or targets.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when counts or times do not fit, or the model does not fit a GLB.
    ///
    /// # Example
    /// ```
    /// use glam::Vec3;
    /// use pliant_asset::{FileSet, Format, Limits, Model, MorphClip};
    ///
    /// let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    /// let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default())?;
    /// let rest: Vec<Vec3> = model.positions.iter().map(|p| p.as_vec3()).collect();
    /// let bent = vec![rest[0], rest[1] + Vec3::Z, rest[2]];
    /// let clip = MorphClip { name: "bend", times: &[0.0, 0.5], shapes: &[rest, bent], root: None, beside: None };
    /// let written = model.write_morph_clip(&clip)?;
    /// let played = Model::read(FileSet::single("one.glb", written.main), None, &Limits::default())?;
    /// assert_eq!(played.positions, model.positions);
    /// assert_eq!(played.moving_scene()?.expect("a scene").clip_names, ["bend"]);
    /// # Ok::<(), pliant_asset::Error>(())
    /// ```
    pub fn write_morph_clip(&self, clip: &MorphClip<'_>) -> Result<WrittenFiles, Error> {
        check_keys(clip.times, clip.shapes.len(), [clip.root, around(clip.beside)])?;
        for shape in clip.shapes {
            self.check_count("positions", shape.len())?;
            if let Some(i) = shape.iter().position(|p| !p.is_finite()) {
                let problem = format!("the position of vertex {i} is {}, not finite", shape[i]);
                return Err(Error::unwritable(Format::GLB, problem));
            }
        }
        self.write_played(&PlayedClip::Morphs(*clip))
    }

    /// Writes the rest pose as a GLB in which joints move every vertex, with an animation of the joints if there are
    /// frames.
    ///
    /// Materials, textures and whatever else the model has stay; skins, morph targets and the clips that moved them do not.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when counts, times or joints do not fit, or the model does not fit a GLB.
    pub fn write_skinned_clip(&self, clip: &SkinnedClip<'_>) -> Result<WrittenFiles, Error> {
        let refuse = |problem: String| Err(Error::unwritable(Format::GLB, problem));
        if !(clip.times.is_empty() && clip.frames.is_empty() && clip.root.is_none()) {
            check_keys(clip.times, clip.frames.len(), [clip.root, around(clip.beside)])?;
        }
        self.check_count("influences", clip.influences.len())?;
        let joints = clip.joints.len();
        if joints == 0 || joints > usize::from(u16::MAX) {
            return refuse(format!("there are {joints} joints, 1 to {} are possible", u16::MAX));
        }
        let above = |(at, joint): (usize, &PlayedJoint)| joint.parent.is_some_and(|p| p >= at);
        if let Some(joint) = clip.joints.iter().enumerate().position(above) {
            return refuse(format!(
                "the parent of joint {joint} does not come before it; parents come first"
            ));
        }
        if let Some(frame) = clip.frames.iter().find(|f| f.len() != joints) {
            return refuse(format!("a frame has {} of {joints} joints", frame.len()));
        }
        if let Some(correctives) = &clip.correctives {
            for shape in correctives.shapes {
                self.check_count("positions of a corrective", shape.len())?;
            }
            let fits = |weights: &Vec<f64>| weights.len() == correctives.shapes.len();
            if correctives.weights.len() != clip.frames.len() || !correctives.weights.iter().all(fits) {
                return refuse("a frame does not have a weight for each corrective".into());
            }
        }
        let mut entries = clip.influences.iter().flatten();
        let is_wrong = |w: f32| !(w.is_finite() && w >= 0.0);
        if let Some((joint, weight)) = entries.find(|(j, w)| *j as usize >= joints || is_wrong(*w)) {
            return refuse(format!("a vertex follows joint {joint} of {joints} by {weight}"));
        }
        self.write_played(&PlayedClip::Joints(*clip))
    }

    fn check_count(&self, what: &str, seen: usize) -> Result<(), Error> {
        let count = self.positions.len();
        if seen == count {
            return Ok(());
        }
        let problem = format!("{seen} {what} are given, the model has {count} vertices");
        Err(Error::unwritable(Format::GLB, problem))
    }

    fn write_played(&self, clip: &PlayedClip<'_>) -> Result<WrittenFiles, Error> {
        let writer = writer_of(Format::GLB)?;
        let rest = &self.positions;
        let (written, vertices) = if writer.patches_files_of(self.format) {
            (self.write(rest, Format::GLB)?, (0..rest.len() as u32).collect())
        } else {
            let mut neutral = neutral_model(self, rest, Format::GLB)?;
            let vertices = std::mem::take(&mut neutral.copy_of);
            (writer.build(&neutral, Format::GLB)?, vertices)
        };
        let files = written.into_files(self.files.name.clone());
        let still = Self::read(files, Some(Format::GLB), &self.limits_of_written())?;
        let seen = still.positions.len();
        if seen != vertices.len() {
            let problem = format!("as a GLB the model has {seen} vertices, not {}", vertices.len());
            return Err(Error::unwritable(Format::GLB, problem));
        }
        writer.write_played(&still, &vertices, clip)
    }
}

fn around(beside: Option<ClipBeside<'_>>) -> Option<NodeKeys<'_>> {
    beside.and_then(|beside| beside.around)
}

/// Refuses times that do not fit what they are of, or do not rise as 32-bit floats.
fn check_keys(times: &[f64], count: usize, nodes: [Option<NodeKeys<'_>>; 2]) -> Result<(), Error> {
    let refuse = |problem: String| Err(Error::unwritable(Format::GLB, problem));
    let of_nodes = nodes.iter().flatten().map(|keys| (keys.times, keys.places.len()));
    for (times, count) in [(times, count)].into_iter().chain(of_nodes) {
        if times.len() != count || count == 0 {
            return refuse(format!("a clip has {} times and {count} keys", times.len()));
        }
        if !times.iter().all(|t| t.is_finite() && *t >= 0.0) {
            return refuse("a time of a clip is not finite, or below 0".into());
        }
        let falls = |pair: &&[f64]| pair[0] as f32 >= pair[1] as f32;
        if let Some(pair) = times.windows(2).find(falls) {
            let problem = format!("the times {} and {} do not rise as 32-bit floats", pair[0], pair[1]);
            return refuse(problem);
        }
    }
    Ok(())
}
