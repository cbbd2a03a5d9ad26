//! When a node of several had a word with the store that they share.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// When this node had a word with the store.
#[derive(Debug, Default)]
pub(in crate::session) struct LeaseWatch {
    times: Mutex<WordTimes>,
    /// Held by who speaks.
    pub speaking: tokio::sync::Mutex<()>,
}

/// When words were said.
#[derive(Debug, Default, Clone, Copy)]
pub(in crate::session) struct WordTimes {
    /// When the last one was begun that was answered.
    pub heard: Option<Instant>,
    /// When the last one was begun.
    pub tried: Option<Instant>,
}

impl LeaseWatch {
    /// When words were said.
    pub fn times(&self) -> WordTimes {
        *self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a word that was begun then.
    pub fn note(&self, begun: Instant, is_heard: bool) {
        let mut times = self.times.lock().unwrap_or_else(PoisonError::into_inner);
        times.tried = Some(begun);
        if is_heard {
            times.heard = Some(begun);
        }
    }
}
