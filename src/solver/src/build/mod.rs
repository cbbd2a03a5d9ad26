//! From a graph to its hierarchy: order, aggregates, coarse edges, and rows laid out for sweeps.

mod bundling;
pub(crate) mod coarsen;
pub(crate) mod draft;
pub(crate) mod hierarchy;
pub(crate) mod layout;
pub(crate) mod level;
pub(crate) mod operator;

pub use self::hierarchy::Hierarchy;
