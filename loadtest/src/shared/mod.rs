//! What several commands share: the clock, measurements as JSON and as a table, models and jobs from disk, and the drag
//! that all of them play.

pub(crate) mod drag_scene;
pub(crate) mod input_files;
pub(crate) mod measurements;
pub(crate) mod subdivide;
pub(crate) mod timing;
