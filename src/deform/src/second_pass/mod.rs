//! The second pass: positions that agree best with the local frames (paper section 2.2, equations 8 and 11).

mod borders;
mod coarse_first;
mod drag;
pub(super) mod equations;
pub(super) mod points;
pub(super) mod refine;
pub(super) mod single_precision;
mod smoother;
pub(super) mod state;
mod stiff_parts;
pub(super) mod turn_steps;
mod turning;
mod volume;

pub use equations::SecondPassEquations;
pub use smoother::{TurnChange, TurnChangeKind};
pub use state::SolveState;
