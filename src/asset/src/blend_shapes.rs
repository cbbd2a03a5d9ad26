//! Blend shapes of a model (morph targets of glTF) as values in model space: read, and put on a model of any format as a GLB.

use super::moving_scene::ChannelInterpolation;
use super::moving_scene::PlayedClip;
use super::{Error, Format, Model, WrittenFiles};
use glam::Vec3;

/// A shape that a model can be blended towards.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BlendShape {
    /// Its name; `shape` and a number for one that the file does not name.
    pub name: String,
    /// How far it moves each render vertex, in model space.
    pub moves: Vec<Vec3>,
    /// How much of it the model shows without a clip.
    pub weight: f32,
}

/// A clip of the weights of blend shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct BlendClip {
    /// Its name; may be empty.
    pub name: String,
    /// Seconds, rising.
    pub times: Vec<f64>,
    /// How weights run from key to key.
    pub interpolation: ChannelInterpolation,
    /// Shapes with their weights, one for each time; three for a spline.
    pub weights: Vec<(usize, Vec<f64>)>,
}

/// The blend shapes of a model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BlendShapes {
    /// The shapes. One name on several meshes of a model is one shape.
    pub shapes: Vec<BlendShape>,
    /// The clips that play them.
    pub clips: Vec<BlendClip>,
    /// Whether shapes turn normals, too.
    pub has_normals: bool,
    /// Whether shapes turn tangents, too.
    pub has_tangents: bool,
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
