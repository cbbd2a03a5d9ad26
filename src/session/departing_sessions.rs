//! Removed sessions whose memory is not free yet: a call that needs room waits for them before it is rejected.

use crate::session::answers::Tenant;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio_util::sync::CancellationToken;

/// Removed sessions.
#[derive(Debug, Default)]
pub(super) struct DepartingSessions(Mutex<Departures>);

#[derive(Debug, Default)]
struct Departures {
    /// Tenant of each, and the token of its free memory.
    under_way: Vec<(Tenant, CancellationToken)>,
    /// Whether one has ended since the last query.
    ended: bool,
}

impl Departures {
    fn settle(&mut self) {
        let before = self.under_way.len();
        self.under_way.retain(|(_, ended)| !ended.is_cancelled());
        self.ended |= self.under_way.len() < before;
    }
}

impl DepartingSessions {
    fn lock(&self) -> MutexGuard<'_, Departures> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds one; `ended` is raised when its memory is free.
    pub fn add(&self, tenant: Tenant, ended: CancellationToken) {
        let mut departures = self.lock();
        departures.settle();
        departures.under_way.push((tenant, ended));
    }

    /// Whether a session has ended since this was asked for the last time: there may be room again.
    pub fn take_ended(&self) -> bool {
        let mut departures = self.lock();
        departures.settle();
        std::mem::take(&mut departures.ended)
    }

    /// The tokens of those that have not ended, of one tenant where it is named.
    pub fn under_way(&self, tenant: Option<&Tenant>) -> Vec<CancellationToken> {
        let departures = self.lock();
        let own = departures
            .under_way
            .iter()
            .filter(|(whose, _)| tenant.is_none_or(|tenant| whose == tenant));
        own.map(|(_, ended)| ended.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_is_told_once_and_until_then_it_can_be_waited_for() {
        let departing = DepartingSessions::default();
        let (one, other) = (CancellationToken::new(), CancellationToken::new());
        let tenant = |name: &str| Tenant(name.into());
        departing.add(tenant("a"), one.clone());
        departing.add(tenant("b"), other.clone());
        assert!(!departing.take_ended());
        assert_eq!(departing.under_way(None).len(), 2);
        assert_eq!(departing.under_way(Some(&tenant("b"))).len(), 1);
        other.cancel();
        // What ends before somebody else goes is not forgotten.
        departing.add(tenant("b"), CancellationToken::new());
        assert!(departing.take_ended() && !departing.take_ended());
        one.cancel();
        assert!(departing.take_ended());
        assert_eq!(departing.under_way(Some(&tenant("a"))).len(), 0);
    }
}
