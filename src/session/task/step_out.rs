//! An unused session leaves memory: first what is derived and quickly rebuilt, later all of it.

use crate::session::error::{Error, ErrorCode};
use crate::session::keeping::residence::Residence;
use crate::session::store::now_ms;
use crate::session::task::session_task::SessionTask;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use tokio::time::Instant;

impl SessionTask {
    /// When the next step out of memory is due; `None` while the session stays as it is.
    pub fn next_step_out(&self) -> Option<Instant> {
        self.kept.as_ref()?;
        if self.is_pinned() {
            return None;
        }
        let (used, idle) = (self.session.lease.last_use(), self.shared.config.idle);
        Some(match self.residence {
            Residence::Whole => used + idle / 2,
            Residence::Lean => used + idle,
        })
    }

    /// Whether a stream or an animation needs the session as it is.
    fn is_pinned(&self) -> bool {
        !self.session.streams.all().is_empty() || self.session.animations.is_any()
    }

    /// Takes the next step out of memory if it is due, or all of them when another session needs room. Returns whether
    /// the session is to end here.
    pub async fn step_out(&mut self) -> bool {
        let is_asked = self.session.leave.load(SeqCst) || self.is_to_be_given_back();
        if self.kept.is_none() || self.is_pinned() {
            self.session.leave.store(false, SeqCst);
            return false;
        }
        let is_due = self.next_step_out().is_some_and(|due| due <= Instant::now());
        if !is_due && !is_asked {
            return false;
        }
        if self.residence == Residence::Whole && !is_asked {
            self.make_lean();
            return false;
        }
        self.leave_memory().await
    }

    /// Whether other nodes wait for the session, since this one is about to stop.
    fn is_to_be_given_back(&self) -> bool {
        let is_shared = || self.kept.as_ref().is_some_and(|kept| kept.store.ownership().is_some());
        self.shared.draining.load(SeqCst) && is_shared()
    }

    fn make_lean(&mut self) {
        self.residence = Residence::Lean;
        if let Some(deformer) = &mut self.deformer {
            deformer.drop_derived();
        }
        self.history.drop_snapshots();
        self.count_memory();
    }

    /// Keeps the newest shape, so that the session reopens fast, and takes no more calls. Earlier calls are served.
    async fn leave_memory(&mut self) -> bool {
        if let Err(error) = self.keep_shape_now().await {
            tracing::warn!(session.id = %self.session.id, "an idle session stays in memory: {error}");
            self.session.leave.store(false, SeqCst);
            // Tried again after another idle time.
            self.session.lease.renew();
            return false;
        }
        let session = Arc::clone(&self.session);
        let lock = self.shared.locks.lock(&session.id).await;
        let text = "the session leaves memory; ask again";
        // Before the place for streams ends: who finds it ended has to know why.
        session.unloaded.store(true, SeqCst);
        if !session.streams.close_if_none() {
            session.unloaded.store(false, SeqCst);
            return false;
        }
        self.shared.registry.remove_this(&session);
        self.commands.close();
        while let Some(command) = self.commands.recv().await {
            self.serve_command(command).await;
        }
        session.close(Error::new(ErrorCode::Unavailable, text));
        self.give_back().await;
        tracing::info!(session.id = %session.id, "idle session left memory");
        drop(lock);
        true
    }

    /// Where several nodes share the store, another one may have it now.
    async fn give_back(&mut self) {
        let Some(ownership) = self.kept.as_ref().and_then(|kept| kept.store.ownership()) else {
            return;
        };
        let ago = u64::try_from(self.session.lease.last_use().elapsed().as_millis()).unwrap_or(u64::MAX);
        let used_ms = now_ms().saturating_sub(ago);
        if let Err(error) = ownership.release(self.session.held.clone(), used_ms).await {
            tracing::warn!(session.id = %self.session.id, "the session stays this node's: {error}");
        }
    }
}
