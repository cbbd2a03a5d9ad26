//! What animations are to show: clips on models, row by row, beside what they must reach.
//!
//! [`command`] runs the rows that are asked for and prints them, [`figure`] is one measured number with its bounds, [`stage`] a model
//! with a rig and a clip on it. The rows: [`ballet`] (a dancing armadillo), [`wrist`] (a hand that is turned over), [`speed`],
//! [`equality`] (same bits however it is solved), [`models`] (other models and skins). [`blend_skinning`] is what all is compared with.

mod ballet;
mod blend_skinning;
pub(crate) mod command;
mod equality;
mod figure;
mod models;
mod speed;
mod stage;
mod wrist;
