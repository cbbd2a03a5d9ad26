//! Parts of a model hold together: what lay side by side stays side by side when the model bends.

mod cost;
mod engine;
mod laws;
mod shapes;
mod sweep;
