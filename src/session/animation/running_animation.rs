//! An animation under way: what was prepared for it, and its place among the others.

use crate::engine::{Animation, Shader};
use crate::session::metrics::{GaugeUnit, Metrics};
use crate::session::quota::tenant_account::TenantStream;
use crate::session::registry::OpenSession;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;

/// An animation that is ready to be solved. What becomes of the session's deformer does not affect it.
pub(in crate::session) struct PreparedAnimation {
    pub animation: Animation,
    /// What makes normals and tangents, when they are wanted.
    pub shader: Option<Arc<Shader>>,
    /// The session's revision when it was prepared.
    pub revision: u64,
    /// Milliseconds by stage.
    pub build_ms: BTreeMap<String, f64>,
}

impl PreparedAnimation {
    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.animation.byte_size() + self.shader.as_ref().map_or(0, |s| s.byte_size())
    }
}

impl std::fmt::Debug for PreparedAnimation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PreparedAnimation(frames {:?})", self.animation.range())
    }
}

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
