//! Parts of a model hold together: what lay side by side stays side by side when the model bends.

mod cost;
#[expect(dead_code, reason = "other tests read single files")]
#[path = "../../../../tests/support/data.rs"]
mod data;
mod engine;
mod laws;
mod shapes;
mod sweep;
