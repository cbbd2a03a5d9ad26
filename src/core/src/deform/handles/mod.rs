//! Handles on a body: which of them holds which node, and what follows from it for parts and positions.

pub(super) mod free_parts;
pub(super) mod motion;
pub(super) mod ownership;
mod placement;
pub(super) mod setup;
pub(super) mod system;
mod way_between;

pub use free_parts::FreePartPolicy;
pub use motion::{HandleMotion, carry};
pub use setup::{HandleConstraint, HandleSetup};
pub use system::HandleSystem;
pub use way_between::{HandleShares, shares_difference};
