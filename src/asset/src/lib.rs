//! Models in and out of bytes, byte-faithful: glTF and GLB, OBJ, PLY, OFF, STL; and FBX, which becomes a GLB.
//!
//! Owns formats. Knows nothing of welding, graphs or solving. A [`Model`] keeps the uploaded files; writing it with new
//! positions changes those places only that the deformation changed.
//!
//! # Layout
//! On the ground are the types that every format shares and that know no format: [`Error`], [`Format`], [`FileSet`] and
//! [`WrittenFiles`], [`Geometry`], [`Model`], [`EditedModel`] (a model whose triangles an edit has changed), and
//! `NeutralModel` (a model on its way from one format to another). Above them stands the trait `FormatCodec` in
//! `codec`, which each format implements once (one that is read only implements `FormatTranslator`). `formats` is the registry and holds one folder or file for each
//! format; its page says how to add one. [`write`] is on top: [`Model::read`], [`Model::write`] and
//! [`write_edited_model`] choose the codec. [`sample`] and [`shapes`] make models where no file is at hand. A file
//! imports files below its own only.
//!
//! # Four ways through a format
//! - *Read*: bytes become a [`Geometry`] and notes for the writers.
//! - *Patch positions*: the uploaded bytes, with those numbers replaced that a deformation changed.
//! - *Build*: a fresh file of a neutral model that came in another format.
//! - *Write an edited model*: every attribute follows its vertices into a file of the first base's format.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod apart;
mod codec;
mod edited;
mod files;
mod following;
mod format;
mod formats;
mod geometry;
mod look;
mod model;
mod model_scene;
mod moving_scene;
mod names;
mod neutral;
pub mod sample;
pub mod shapes;
mod usd;
mod vertex_attributes;
mod write;

pub use apart::{ParserProcess, ParserStarter};
pub use edited::{BaseModel, CapLooks, EditedModel, PrimitiveRun, VertexBlend, VertexBlends};
pub use files::{FileSet, Limits, WrittenFiles, WrittenWarning};
pub use following::{
    BoneLengthRule, BoundSplats, FollowedCounts, Following, JointTravel, LargeSplatRule, ModelNode, MorphTargetRule,
    NodeMotions, RigRule, ShapeFollowers,
};
pub use format::{Error, Format};
pub use formats::{SplatMotion, SplatPlaces, Splats, answer_parser_calls, gltf_extension_table};
pub use geometry::{Geometry, Primitive, VertexCache};
pub use look::{AlphaMode, BaseMaterial, DrawnModel, SurfaceLook, TextureUse, TextureWrap};
pub use model::Model;
pub use moving_scene::{
    BlendClip, BlendShape, BlendShapes, CarryingJoints, ChannelInterpolation, ChannelValues, ClipBeside,
    JointInfluences, MorphClip, MovingScene, NodeKeys, NodePlace, PlayedCorrectives, PlayedJoint, PrimitiveShapes,
    SceneChannel, SceneClip, SceneNode, ScenePrimitive, SkinnedClip,
};
pub use names::{is_hidden, name_words};
pub use usd::{UsdClip, UsdModel};
pub use vertex_attributes::{VertexAttributes, agrees_with_facet, facet_normal, normal_key};
pub use write::{line_segments, missing_companions, write_edited_model, write_edited_model_following};
