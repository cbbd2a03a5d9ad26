//! Handles on a body: which of them holds which node, and what follows from it for parts and positions.

pub(super) mod free_parts;
pub(super) mod motion;
pub(super) mod ownership;
pub(super) mod pulled_places;
pub(super) mod pulled_points;
pub(super) mod stiff;
pub(super) mod system;
pub(super) mod targets;

pub use free_parts::FreePartPolicy;
pub use motion::{HandleMotion, HandleShares, carry, shares_difference};
pub use ownership::{HandleConstraint, HandleSetup, NodeOwnership, StiffNodes, UNHELD};
pub use pulled_places::HoldTargets;
pub use pulled_points::PulledPoint;
pub use system::HandleSystem;
