//! Topology changes at the price of the edit: a hierarchy follows its graph.
//!
//! On every level a few rows change: on the finest those that the caller names, on the others those whose members
//! changed. They leave their places, which become filling, and are appended in blocks of their own; rows that border on
//! them only have their entries written anew. The aggregates that lost a member are dissolved, and their rows and the
//! new ones coarsened by the rule that built the level, old seeds first, so that what the change does not reach keeps
//! its aggregate. What this yields are the rows that change on the next level. Levels of a few thousand rows are not
//! worth the care: those above the first such level are built anew.
//!
//! The one pass over all vertices is that which gives them their new numbers.

mod change;
mod compact;
mod follow;
#[cfg(test)]
mod irregular_tests;
mod marks;
mod place;
mod regroup;
mod rows;
#[cfg(test)]
mod tests;

pub use self::change::{GraphChange, RepairReport};
