//! What a model looks like, whatever its format.

use super::formats::codec_of;
use super::look::SurfaceLook;
use super::{Error, FileSet, Format, Limits, Model};

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
