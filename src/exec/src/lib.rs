//! Where work runs and who watches it: the pool of threads, progress, cancellation.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod pool;
pub mod progress;
mod run;
pub mod stage_clock;

pub use run::*;
