//! Topology changes at the cost of the edit: a hierarchy follows its graph.
//!
//! On every level a few rows change: on the finest those that the caller names, on the others those whose members
//! changed. They leave their places, which become filling, and are appended in blocks of their own; only the entries of
//! rows that border on them are rewritten. Aggregates that lost a member are dissolved. Their rows and the new ones are
//! coarsened by the rule that built the level, old seeds first, so that rows beyond the change keep their aggregates.
//! The result is the rows that change on the next level. Levels of a few thousand rows are not worth a repair: those
//! above the first such level are rebuilt.
//!
//! Only one pass visits all vertices: it gives them their new numbers.

mod change;
mod follow;
#[cfg(test)]
mod irregular_tests;
mod marks;
mod regroup;
#[cfg(test)]
mod tests;

pub use self::change::{GraphChange, RepairReport};
