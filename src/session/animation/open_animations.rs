//! The animations under way on one session.

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// How many animations are under way on a session, which does not expire meanwhile.
#[derive(Debug, Default)]
pub(in crate::session) struct OpenAnimations(AtomicUsize);

impl OpenAnimations {
    /// One more is under way.
    pub fn count_one_more(&self) {
        self.0.fetch_add(1, Relaxed);
    }

    /// One has ended.
    pub fn count_one_less(&self) {
        self.0.fetch_sub(1, Relaxed);
    }

    /// Whether there is one.
    pub fn is_any(&self) -> bool {
        self.0.load(Relaxed) > 0
    }
}
