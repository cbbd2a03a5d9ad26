//! Who computes next: a line in which tenants take turns, in a tenant its sessions, and in a session whoever came first.
//!
//! A tenant that asks for much waits behind itself and not before others: whoever comes new waits for one piece of work of each
//! tenant at most. Nothing here depends on time but what is expected of it.

use crate::session::answers::Tenant;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// How much the newest piece of work counts in the mean.
const NEWEST: f64 = 0.125;

/// Whose work it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::session) struct WorkOwner {
    pub tenant: Tenant,
    /// Empty for sessions that are being opened: those of one tenant share a line.
    pub session: String,
}

/// Why there is no place in the line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LineRefusal {
    /// As many wait as may.
    Full,
    /// It would wait so long, which is longer than it may.
    TooLong(Duration),
}

/// A place in the line, or the right to compute at once.
#[derive(Debug)]
pub(super) enum LinePlace {
    Free(LinePermit),
    Waiting(WaitingPlace),
}

/// The right to compute. The next one gets it when it is dropped.
#[derive(Debug)]
pub(super) struct LinePermit {
    line: Option<Arc<FairLine>>,
    begun: Option<Instant>,
}

/// A place in the line. Given up when dropped.
#[derive(Debug)]
pub(super) struct WaitingPlace {
    line: Arc<FairLine>,
    ticket: u64,
    turn: oneshot::Receiver<Result<LinePermit, LineRefusal>>,
}

/// The line.
#[derive(Debug)]
pub(super) struct FairLine {
    slots: usize,
    /// How many may wait.
    most: usize,
    state: Mutex<LineState>,
}

#[derive(Debug)]
struct LineState {
    free: usize,
    /// In the order of their turns.
    tenants: VecDeque<TenantLine>,
    next_ticket: u64,
    /// How long a piece of work takes, in seconds.
    mean: f64,
}

#[derive(Debug)]
struct TenantLine {
    tenant: Tenant,
    /// In the order of their turns; none is empty.
    sessions: VecDeque<SessionLine>,
}

#[derive(Debug)]
struct SessionLine {
    session: String,
    waiting: VecDeque<Waiter>,
}

#[derive(Debug)]
struct Waiter {
    ticket: u64,
    /// Whether it counts among those that may wait, and may be told that there are too many.
    refusable: bool,
    turn: oneshot::Sender<Result<LinePermit, LineRefusal>>,
}

impl FairLine {
    /// Nobody waits; `most` may.
    pub fn new(slots: usize, most: usize) -> Arc<Self> {
        Arc::new(Self {
            slots,
            most,
            state: Mutex::new(LineState {
                free: slots,
                tenants: VecDeque::new(),
                next_ticket: 0,
                mean: 0.0,
            }),
        })
    }

    fn lock(&self) -> MutexGuard<'_, LineState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a place for work that may wait as long as `patience`, for ever without one. When as many wait as may, whoever of them
    /// came last of the tenant that has most makes way for one that has fewer.
    pub fn enter(self: &Arc<Self>, owner: &WorkOwner, patience: Option<Duration>) -> Result<LinePlace, LineRefusal> {
        let mut state = self.lock();
        if state.free > 0 {
            state.free -= 1;
            return Ok(LinePlace::Free(LinePermit::of(self)));
        }
        if let Some(patience) = patience {
            let turns = (state.rank(owner) + 1) as f64 / self.slots.max(1) as f64;
            let expected = Duration::try_from_secs_f64(turns * state.mean).unwrap_or(Duration::MAX);
            if expected > patience {
                return Err(LineRefusal::TooLong(expected));
            }
            if state.refusable() >= self.most && !state.displace_for(&owner.tenant) {
                return Err(LineRefusal::Full);
            }
        }
        let (give, turn) = oneshot::channel();
        let ticket = state.next_ticket;
        state.next_ticket += 1;
        state.push(
            owner,
            Waiter {
                ticket,
                refusable: patience.is_some(),
                turn: give,
            },
        );
        Ok(LinePlace::Waiting(WaitingPlace {
            line: Arc::clone(self),
            ticket,
            turn,
        }))
    }

    /// How many compute now.
    pub fn busy(&self) -> usize {
        self.slots - self.lock().free
    }

    /// Somebody is done: whoever is next may compute.
    fn release(self: &Arc<Self>, took: Option<Duration>) {
        let mut state = self.lock();
        if let Some(took) = took {
            state.note_service(took);
        }
        while let Some(next) = state.pop() {
            let Err(unheard) = next.turn.send(Ok(LinePermit::of(self))) else {
                return;
            };
            // It has gone meanwhile. The permit must not come back here while the state is locked.
            if let Ok(permit) = unheard {
                permit.forget();
            }
        }
        state.free += 1;
    }
}

impl LineState {
    fn note_service(&mut self, took: Duration) {
        let took = took.as_secs_f64();
        self.mean += if self.mean == 0.0 {
            took
        } else {
            (took - self.mean) * NEWEST
        };
    }

    /// How many get their turn before one that comes now, if nobody else comes.
    fn rank(&self, owner: &WorkOwner) -> usize {
        let at = self.tenants.iter().position(|t| t.tenant == owner.tenant);
        let own = at.map_or(0, |at| {
            let sessions = &self.tenants[at].sessions;
            let within = sessions.iter().position(|s| s.session == owner.session);
            let first = within.map_or(0, |k| sessions[k].waiting.len());
            let lengths: Vec<usize> = sessions.iter().map(|s| s.waiting.len()).collect();
            turns_before(&lengths, within, first)
        });
        let lengths: Vec<usize> = self.tenants.iter().map(TenantLine::len).collect();
        turns_before(&lengths, at, own)
    }

    fn refusable(&self) -> usize {
        self.tenants.iter().map(TenantLine::refusable).sum()
    }

    fn push(&mut self, owner: &WorkOwner, waiter: Waiter) {
        let at = self.tenants.iter().position(|t| t.tenant == owner.tenant);
        let at = at.unwrap_or_else(|| {
            self.tenants.push_back(TenantLine {
                tenant: owner.tenant.clone(),
                sessions: VecDeque::new(),
            });
            self.tenants.len() - 1
        });
        let sessions = &mut self.tenants[at].sessions;
        match sessions.iter_mut().find(|s| s.session == owner.session) {
            Some(line) => line.waiting.push_back(waiter),
            None => sessions.push_back(SessionLine {
                session: owner.session.clone(),
                waiting: VecDeque::from([waiter]),
            }),
        }
    }

    /// Takes whoever is next out of the line. Its tenant, and in it its session, goes behind the others.
    fn pop(&mut self) -> Option<Waiter> {
        let mut tenant = self.tenants.pop_front()?;
        let mut session = tenant.sessions.pop_front()?;
        let next = session.waiting.pop_front();
        if !session.waiting.is_empty() {
            tenant.sessions.push_back(session);
        }
        if !tenant.sessions.is_empty() {
            self.tenants.push_back(tenant);
        }
        next
    }

    /// Removes a place that is given up.
    fn remove(&mut self, ticket: u64) -> Option<Waiter> {
        let mut removed = None;
        for tenant in &mut self.tenants {
            for session in &mut tenant.sessions {
                let at = session.waiting.iter().position(|w| w.ticket == ticket);
                removed = removed.or_else(|| session.waiting.remove(at?));
            }
            tenant.sessions.retain(|session| !session.waiting.is_empty());
        }
        self.tenants.retain(|tenant| !tenant.sessions.is_empty());
        removed
    }

    /// Makes room for one of a tenant that has fewer waiting than another.
    fn displace_for(&mut self, tenant: &Tenant) -> bool {
        let own = self.tenants.iter().find(|t| t.tenant == *tenant);
        let own = own.map_or(0, TenantLine::refusable);
        let largest = self.tenants.iter().max_by_key(|t| t.refusable());
        let Some(largest) = largest.filter(|t| t.refusable() > own + 1) else {
            return false;
        };
        let of_session = |s: &&SessionLine| s.waiting.iter().filter(|w| w.refusable).count();
        let longest = largest.sessions.iter().max_by_key(of_session);
        let last = longest.and_then(|s| s.waiting.iter().rev().find(|w| w.refusable));
        let Some(ticket) = last.map(|waiter| waiter.ticket) else {
            return false;
        };
        if let Some(waiter) = self.remove(ticket) {
            let _ = waiter.turn.send(Err(LineRefusal::Full));
        }
        true
    }
}

/// How many turns there are before turn number `own`, from 0, of the one at `at` among some that take turns in their order and have so
/// many each; without `at` it is behind them all. Its own turns before that one count as well.
fn turns_before(lengths: &[usize], at: Option<usize>, own: usize) -> usize {
    let at = at.unwrap_or(lengths.len());
    let others = lengths.iter().enumerate().filter(|(k, _)| *k != at);
    own + others
        .map(|(k, len)| *len.min(&(own + usize::from(k < at))))
        .sum::<usize>()
}

impl TenantLine {
    fn len(&self) -> usize {
        self.sessions.iter().map(|s| s.waiting.len()).sum()
    }

    fn refusable(&self) -> usize {
        let waiting = self.sessions.iter().flat_map(|s| &s.waiting);
        waiting.filter(|w| w.refusable).count()
    }
}

impl LinePermit {
    fn of(line: &Arc<FairLine>) -> Self {
        Self {
            line: Some(Arc::clone(line)),
            begun: None,
        }
    }

    /// The work begins; how long it takes is counted from here.
    pub fn begin(&mut self) {
        self.begun = Some(Instant::now());
    }

    /// Drops it without passing it on.
    fn forget(mut self) {
        self.line = None;
    }
}

impl Drop for LinePermit {
    fn drop(&mut self) {
        if let Some(line) = self.line.take() {
            line.release(self.begun.map(|begun| begun.elapsed()));
        }
    }
}

impl WaitingPlace {
    /// Waits for its turn.
    ///
    /// # Cancel safety
    /// The place is kept until this is dropped.
    pub async fn turn(&mut self) -> Result<LinePermit, LineRefusal> {
        (&mut self.turn).await.unwrap_or(Err(LineRefusal::Full))
    }
}

impl Drop for WaitingPlace {
    fn drop(&mut self) {
        // What was given meanwhile goes back with the receiver, after this.
        self.line.lock().remove(self.ticket);
    }
}

#[cfg(test)]
impl FairLine {
    /// As if a piece of work had taken so long.
    pub(super) fn note_service(&self, took: Duration) {
        self.lock().note_service(took);
    }
}

#[cfg(test)]
#[path = "fair_line_tests.rs"]
mod tests;
