//! The place of an animation under way among the others.

use crate::session::metrics::{GaugeUnit, Metrics};
use crate::session::quota::tenant_account::TenantStream;
use crate::session::registry::OpenSession;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;

/// One animation under way, until it is dropped.
#[derive(Debug)]
pub(in crate::session) struct RunningAnimation {
    session: Arc<OpenSession>,
    _counted: GaugeUnit,
    places: (OwnedSemaphorePermit, TenantStream),
}

impl RunningAnimation {
    /// Counts one more; `places` are those among all of the server's, and among the tenant's streams.
    pub fn on_session(
        session: &Arc<OpenSession>,
        places: (OwnedSemaphorePermit, TenantStream),
        metrics: &Metrics,
    ) -> Self {
        session.animations.count_one_more();
        Self {
            session: Arc::clone(session),
            _counted: GaugeUnit::add_to(&metrics.animations),
            places,
        }
    }

    /// Counts work that was done for it.
    pub fn charge_work(&self, time: Duration) {
        self.places.1.charge_work(time);
    }
}

impl Drop for RunningAnimation {
    fn drop(&mut self) {
        self.session.animations.count_one_less();
        self.session.lease.renew();
        self.session.wake.notify_one();
    }
}
