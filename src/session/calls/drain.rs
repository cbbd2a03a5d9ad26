//! How a server stops: nothing new, a word to those inside, then wait, then an end.

use crate::session::calls::manager::Manager;
use crate::session::error::Error;
use std::sync::atomic::Ordering::SeqCst;

impl Manager {
    /// Whether new sessions are welcome: not draining, and memory below the high-water mark.
    pub fn admits(&self) -> bool {
        let ledger = &self.shared.ledger;
        let mark = ledger.total() as f64 * self.shared.config.high_water;
        !self.shared.draining.load(SeqCst) && ledger.used() as f64 <= mark
    }

    /// Takes no new sessions and streams from now on, and tells the open streams.
    pub fn start_drain(&self) {
        if self.shared.draining.swap(true, SeqCst) {
            return;
        }
        for session in self.shared.registry.all() {
            for mailbox in session.streams.all() {
                mailbox.send_notice(
                    "going-away",
                    "the server is shutting down; commit and open the stream again elsewhere",
                );
            }
        }
    }

    /// Waits until no call and no stream is under way.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn drained(&self) {
        self.shared.gate.empty().await;
    }

    /// Stops everything at once: work, calls and streams end with `UNAVAILABLE`, sessions are gone.
    pub fn abort(&self) {
        self.shared.draining.store(true, SeqCst);
        self.shared.aborted.cancel();
        self.shared.abort_flag.cancel();
        for session in self.shared.registry.all() {
            session.close(Error::draining());
        }
    }
}
