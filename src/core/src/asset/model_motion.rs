//! What moves in a model's scene, whatever its format.

use super::formats::codec_of;
use super::moving_scene::{MovingScene, PrimitiveShapes, SceneClip};
use super::{Error, Model};

impl Model {
    /// What moves in the model's scene; `None` for formats that know no motion.
    ///
    /// # Errors
    /// [`Error`] when what places vertices cannot be read.
    pub fn moving_scene(&self) -> Result<Option<MovingScene>, Error> {
        codec_of(self.format).moving_scene(self)
    }

    /// Reads a clip by its number in [`MovingScene::clip_names`]; `None` where there is none.
    ///
    /// # Errors
    /// [`Error`] with the channel that cannot be read: one that names what is not there, or whose numbers do not fit.
    pub fn scene_clip(&self, index: usize) -> Result<Option<SceneClip>, Error> {
        codec_of(self.format).scene_clip(self, index)
    }

    /// Where the vertices of all primitives are stored, and what their morph targets do to them, in the order of
    /// [`MovingScene::primitives`]; `None` for formats that know no motion.
    ///
    /// # Errors
    /// [`Error`] for targets that cannot be read, or are too many.
    pub fn primitive_shapes(&self) -> Result<Option<Vec<PrimitiveShapes>>, Error> {
        codec_of(self.format).primitive_shapes(self)
    }
}
