//! Bytes of uploads that are on their way: they belong to no session yet, so they are counted here.

use crate::session::{Error, ErrorCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What all uploads under way may hold together.
#[derive(Debug, Clone)]
pub(super) struct Budget {
    used: Arc<AtomicU64>,
    total: u64,
    each: u64,
}

/// What one upload holds; given back when dropped.
#[derive(Debug)]
pub(super) struct Held {
    budget: Budget,
    bytes: u64,
}

impl Budget {
    /// `each` bytes for one upload, `total` for all together.
    pub fn new(each: u64, total: u64) -> Self {
        Self {
            used: Arc::default(),
            total: total.max(each),
            each,
        }
    }

    /// Starts an upload.
    pub fn hold(&self) -> Held {
        Held {
            budget: self.clone(),
            bytes: 0,
        }
    }

    /// Refuses an announced length before any of it is read.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` as too large.
    pub fn announce(&self, bytes: u64) -> Result<(), Error> {
        if bytes > self.each {
            Err(self.too_large(bytes))
        } else {
            Ok(())
        }
    }

    fn too_large(&self, bytes: u64) -> Error {
        Error::new(
            ErrorCode::TooLarge,
            format!(
                "the upload has {bytes} bytes or more, at most {} are allowed",
                self.each
            ),
        )
    }
}

impl Held {
    /// Takes `bytes` more.
    ///
    /// # Errors
    /// Too large when this upload passes its limit; exhausted when all uploads together do.
    pub fn grow(&mut self, bytes: usize) -> Result<(), Error> {
        let bytes = bytes as u64;
        let mine = self.bytes.saturating_add(bytes);
        if mine > self.budget.each {
            return Err(self.budget.too_large(mine));
        }
        let before = self.budget.used.fetch_add(bytes, Ordering::Relaxed);
        self.bytes = mine;
        if before.saturating_add(bytes) > self.budget.total {
            return Err(Error::exhausted("too many uploads are under way", 2));
        }
        Ok(())
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_upload_and_all_together_are_bounded_and_given_back() {
        let budget = Budget::new(100, 150);
        assert_eq!(budget.announce(101).unwrap_err().http_status(), 413);
        let mut first = budget.hold();
        first.grow(100).unwrap();
        assert_eq!(first.grow(1).unwrap_err().http_status(), 413);
        let mut second = budget.hold();
        second.grow(50).unwrap();
        assert_eq!(second.grow(1).unwrap_err().http_status(), 429);
        drop((first, second));
        assert_eq!(budget.used.load(Ordering::Relaxed), 0);
    }
}
