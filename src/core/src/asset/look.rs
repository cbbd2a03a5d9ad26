//! What the surface of a model looks like: base colours, pictures, texture coordinates, vertex colours.
//!
//! What a model looks like, whatever its format.

use super::formats::codec_of;
use super::{Error, FileSet, Format, Limits, Model};
use bytes::Bytes;

/// How texture coordinates beyond 0 to 1 are taken back into the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TextureWrap {
    /// The picture stands beside itself.
    #[default]
    Repeat,
    /// Every other picture is mirrored.
    Mirror,
    /// The border goes on.
    Clamp,
}

/// What the opacity of a surface means.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum AlphaMode {
    /// Nothing: the surface is opaque.
    #[default]
    Opaque,
    /// Below this number there is no surface.
    Mask(f32),
    /// What lies behind shines through.
    Blend,
}

/// A picture on a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureUse {
    /// Index in [`SurfaceLook::images`].
    pub image: usize,
    /// Along u and along v.
    pub wrap: [TextureWrap; 2],
    /// Whether texels are not blended into each other.
    pub nearest: bool,
}

/// What a material looks like without lamps: its base colour.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseMaterial {
    /// Its name, else its number.
    pub name: String,
    /// Red, green and blue as linear light, and opacity; each 0 to 1.
    pub factor: [f32; 4],
    /// The picture that the factor multiplies.
    pub texture: Option<TextureUse>,
    /// What opacity means.
    pub alpha: AlphaMode,
    /// Whether the back of a face is seen.
    pub double_sided: bool,
    /// Whether it is drawn without light and shade.
    pub unlit: bool,
}

impl Default for BaseMaterial {
    /// White, opaque, seen from the front: what glTF says of a primitive without a material.
    fn default() -> Self {
        Self {
            name: String::new(),
            factor: [1.0; 4],
            texture: None,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
        }
    }
}

impl BaseMaterial {
    /// Whether it says no more than no material does.
    fn is_bare(&self) -> bool {
        self.factor == [1.0; 4] && self.texture.is_none() && self.alpha == AlphaMode::Opaque
    }
}

/// What the surface of a model looks like.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfaceLook {
    /// The materials in use.
    pub materials: Vec<BaseMaterial>,
    /// For each primitive of the model the index of its material.
    pub material_of: Vec<u32>,
    /// For each render vertex where it lies on its material's picture, from the upper left corner; empty without pictures.
    pub uv: Vec<[f32; 2]>,
    /// For each render vertex linear red, green and blue, and opacity; empty when no primitive has any.
    pub colours: Vec<[f32; 4]>,
    /// The files of the pictures, undecoded, or why there is none.
    pub images: Vec<Result<Bytes, String>>,
}

impl SurfaceLook {
    /// Whether the model says nothing of looks.
    pub fn is_bare(&self) -> bool {
        self.colours.is_empty() && self.materials.iter().all(BaseMaterial::is_bare)
    }
}

impl Model {
    /// The look of the model, and the model that it describes: for a format that indexes attributes by corner, the GLB
    /// that would be written, with vertices divided at seams. `None` when the model has no look.
    ///
    /// # Errors
    /// [`Error`] when attributes that are there cannot be read. A problem of a picture is in its place in
    /// [`SurfaceLook::images`] instead.
    ///
    /// # Example
    /// ```
    /// use pliant_core::asset::{FileSet, Limits, Model};
    ///
    /// let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
    ///     property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
    ///     property list uchar int vertex_indices\nend_header\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n";
    /// let model = Model::read(FileSet::single("red.ply", text), None, &Limits::default())?;
    /// let (drawn, look) = model.surface_look()?.expect("it has vertex colours");
    /// assert_eq!(drawn.positions, model.positions);
    /// assert_eq!(look.colours, [[1.0, 0.0, 0.0, 1.0]; 3]);
    /// # Ok::<(), pliant_core::asset::Error>(())
    /// ```
    pub fn surface_look(&self) -> Result<Option<(Model, SurfaceLook)>, Error> {
        let codec = codec_of(self.format);
        let (drawn, look) = match codec.surface_look(self)? {
            Some(look) => (self.clone(), look),
            None if codec.takes_attributes() => {
                let mut files = FileSet::single("look.glb", self.write(&self.positions, Format::GLB)?.main);
                // A picture that the file names by its path came with the model.
                files.companions = self.files.companions.clone();
                let drawn = Model::read(files, Some(Format::GLB), &Limits::default())?;
                let Some(mut look) = codec_of(Format::GLB).surface_look(&drawn)? else {
                    return Ok(None);
                };
                // These formats know no sides; where a face looks is often left to chance.
                look.materials.iter_mut().for_each(|m| m.double_sided = true);
                (drawn, look)
            }
            None => return Ok(None),
        };
        Ok((!look.is_bare()).then_some((drawn, look)))
    }
}
