//! Waiting work in the order of turns: tenants take turns, in a tenant its sessions, and in a session the oldest is
//! first.

use crate::session::answers::Tenant;
use crate::session::capacity::work_owner::WorkOwner;
use std::collections::VecDeque;

/// Waiting work. `W` is stored for each.
#[derive(Debug)]
pub(super) struct TurnQueue<W> {
    /// In the order of their turns.
    tenants: VecDeque<TenantQueue<W>>,
}

/// Waiting work.
#[derive(Debug)]
pub(super) struct QueuedTurn<W> {
    pub ticket: u64,
    /// Whether it counts against the limit and may be rejected when that is reached.
    pub refusable: bool,
    pub waiter: W,
}

#[derive(Debug)]
struct TenantQueue<W> {
    tenant: Tenant,
    /// In the order of their turns; none is empty.
    sessions: VecDeque<SessionQueue<W>>,
}

#[derive(Debug)]
struct SessionQueue<W> {
    session: String,
    waiting: VecDeque<QueuedTurn<W>>,
}

impl<W> Default for TurnQueue<W> {
    fn default() -> Self {
        Self {
            tenants: VecDeque::new(),
        }
    }
}

impl<W> TurnQueue<W> {
    /// How many wait.
    pub fn waiting_count(&self) -> usize {
        self.tenants.iter().map(TenantQueue::len).sum()
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.tenants.is_empty()
    }

    /// How many of them count against the limit.
    pub fn refusable(&self) -> usize {
        self.tenants.iter().map(TenantQueue::refusable).sum()
    }

    /// How many turns come before that of new work, if no more comes.
    pub fn rank(&self, owner: &WorkOwner) -> usize {
        let at = self.tenants.iter().position(|t| t.tenant == owner.tenant);
        let own = at.map_or(0, |at| {
            let sessions = &self.tenants[at].sessions;
            let within = sessions.iter().position(|s| s.session == owner.session);
            let first = within.map_or(0, |k| sessions[k].waiting.len());
            let lengths: Vec<usize> = sessions.iter().map(|s| s.waiting.len()).collect();
            turns_before(&lengths, within, first)
        });
        let lengths: Vec<usize> = self.tenants.iter().map(TenantQueue::len).collect();
        turns_before(&lengths, at, own)
    }

    /// Adds waiting work.
    pub fn push(&mut self, owner: &WorkOwner, turn: QueuedTurn<W>) {
        let at = self.tenants.iter().position(|t| t.tenant == owner.tenant);
        let at = at.unwrap_or_else(|| {
            self.tenants.push_back(TenantQueue {
                tenant: owner.tenant.clone(),
                sessions: VecDeque::new(),
            });
            self.tenants.len() - 1
        });
        let sessions = &mut self.tenants[at].sessions;
        match sessions.iter_mut().find(|s| s.session == owner.session) {
            Some(line) => line.waiting.push_back(turn),
            None => sessions.push_back(SessionQueue {
                session: owner.session.clone(),
                waiting: VecDeque::from([turn]),
            }),
        }
    }

    /// Takes the next. Its tenant, and in it its session, goes behind the others.
    pub fn pop(&mut self) -> Option<QueuedTurn<W>> {
        self.pop_at(0)
    }

    /// As [`TurnQueue::pop`], but of other tenants.
    pub fn pop_other_than(&mut self, tenant: &Tenant) -> Option<QueuedTurn<W>> {
        self.pop_at(self.tenants.iter().position(|queue| queue.tenant != *tenant)?)
    }

    fn pop_at(&mut self, at: usize) -> Option<QueuedTurn<W>> {
        let mut tenant = self.tenants.remove(at)?;
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
    pub fn remove(&mut self, ticket: u64) -> Option<QueuedTurn<W>> {
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

    /// Removes one that makes way for a tenant that has fewer: the last of the longest session of the tenant that has
    /// most.
    pub fn displace_for(&mut self, tenant: &Tenant) -> Option<W> {
        let own = self.tenants.iter().find(|t| t.tenant == *tenant);
        let own = own.map_or(0, TenantQueue::refusable);
        let largest = self.tenants.iter().max_by_key(|t| t.refusable());
        let largest = largest.filter(|t| t.refusable() > own + 1)?;
        let of_session = |s: &&SessionQueue<W>| s.waiting.iter().filter(|w| w.refusable).count();
        let longest = largest.sessions.iter().max_by_key(of_session)?;
        let ticket = longest.waiting.iter().rev().find(|w| w.refusable)?.ticket;
        self.remove(ticket).map(|turn| turn.waiter)
    }
}

impl<W> TenantQueue<W> {
    fn len(&self) -> usize {
        self.sessions.iter().map(|s| s.waiting.len()).sum()
    }

    fn refusable(&self) -> usize {
        let waiting = self.sessions.iter().flat_map(|s| &s.waiting);
        waiting.filter(|w| w.refusable).count()
    }
}

/// How many turns come before turn `own`, from 0, of queue `at`. Queues of these `lengths` take turns in their order;
/// without `at` the queue is behind them all. Its own earlier turns count as well.
fn turns_before(lengths: &[usize], at: Option<usize>, own: usize) -> usize {
    let at = at.unwrap_or(lengths.len());
    let others = lengths.iter().enumerate().filter(|(k, _)| *k != at);
    own + others
        .map(|(k, len)| *len.min(&(own + usize::from(k < at))))
        .sum::<usize>()
}
