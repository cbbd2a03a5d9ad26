//! How large a clip may be.

use crate::motion::error::Error;

/// How large a clip may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClipLimits {
    /// Bytes of the file.
    pub bytes: u64,
    /// Joints, end sites among them.
    pub joints: usize,
    /// Frames, or keys of a curve.
    pub frames: usize,
    /// Numbers in all frames together.
    pub numbers: usize,
}

impl Default for ClipLimits {
    fn default() -> Self {
        Self {
            bytes: 64 << 20,
            joints: 4096,
            frames: 1_000_000,
            numbers: 8_000_000,
        }
    }
}

/// What a clip has too much of, if anything.
pub(super) fn check_count(what: &'static str, seen: usize, limit: usize) -> Result<(), Error> {
    let (seen, limit) = (seen as u64, limit as u64);
    if seen > limit {
        return Err(Error::TooMany { what, seen, limit });
    }
    Ok(())
}
