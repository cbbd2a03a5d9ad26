//! Words for regions of a model.

mod figure;
mod file_names;
mod joints;
mod resolve;
mod sides;
mod tips;
mod vertex_set;

pub(crate) use figure::RestFigure;
pub(crate) use joints::Joints;
pub(crate) use resolve::{Found, Resolver, plain_words};
pub(crate) use vertex_set::VertexSet;
