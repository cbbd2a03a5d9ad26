//! One animation under way, with its place among the others.

use crate::session::metrics::{GaugeUnit, Metrics};
use crate::session::registry::OpenSession;
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// One animation under way, until it is dropped.
#[derive(Debug)]
pub(in crate::session) struct RunningAnimation {
    session: Arc<OpenSession>,
    _counted: GaugeUnit,
    _permit: OwnedSemaphorePermit,
}

impl RunningAnimation {
    /// Counts one more; `permit` is its place among all of the server's.
    pub fn on_session(session: &Arc<OpenSession>, permit: OwnedSemaphorePermit, metrics: &Metrics) -> Self {
        session.animations.count_one_more();
        Self {
            session: Arc::clone(session),
            _counted: GaugeUnit::add_to(&metrics.animations),
            _permit: permit,
        }
    }
}

impl Drop for RunningAnimation {
    fn drop(&mut self) {
        self.session.animations.count_one_less();
        self.session.lease.renew();
    }
}
