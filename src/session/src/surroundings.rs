//! What sessions take from the machine they run on, beside its clock for spans of time, which is tokio's: a simulation replaces all of it.

use crate::error::{Error, ErrorCode};
use crate::store::{millis, now_ms};
use std::fmt::Debug;
use std::time::Duration;

/// The machine.
pub trait Surroundings: Send + Sync + Debug + 'static {
    /// Milliseconds since 1970.
    fn now_ms(&self) -> u64;

    /// Random bits.
    ///
    /// # Errors
    /// `INTERNAL` where the machine has none.
    fn random(&self) -> Result<u128, Error>;

    /// Whether work runs while its caller waits, and not beside it, so that a simulation is the same each time.
    fn computes_inline(&self) -> bool {
        false
    }
}

/// The machine that this process runs on.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealSurroundings;

impl Surroundings for RealSurroundings {
    fn now_ms(&self) -> u64 {
        now_ms()
    }

    fn random(&self) -> Result<u128, Error> {
        let mut bytes = [0u8; 16];
        getrandom::fill(&mut bytes).map_err(|e| Error::new(ErrorCode::Internal, format!("no random numbers: {e}")))?;
        Ok(u128::from_be_bytes(bytes))
    }
}

impl dyn Surroundings {
    /// When something was used so long ago, in milliseconds since 1970.
    pub(crate) fn ms_ago(&self, ago: Duration) -> u64 {
        self.now_ms().saturating_sub(millis(ago))
    }
}
