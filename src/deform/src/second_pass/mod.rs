//! The second pass: positions that agree best with the local frames (paper section 2.2, equations 8 and 11).

mod coarse_first;
mod drag;
pub(super) mod equations;
pub(super) mod refine;
pub(super) mod single_precision;
pub(super) mod state;
pub(super) mod volume;

pub use equations::SecondPassEquations;
pub use state::SolveState;
