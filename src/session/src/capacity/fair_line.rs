//! Which work computes next: a line in which drags come before other work. In both classes tenants take turns, in a
//! tenant its sessions, and in a session the oldest work is first.
//!
//! A tenant that asks for much delays only itself: new work of another tenant waits for one piece of work of each
//! tenant at most. A user watches a drag, and its client asks for the next frame as soon as one is there. So drags have
//! slots that nothing else gets, and on the others they get as many turns as take [`DRAGS_TIME`] times as long as one
//! turn of the rest: neither drags nor the rest ever stop. Work may take minutes, and then turns do not help: while one
//! tenant has all slots, there is one more for the others. Only the expected durations depend on time.
//!
//! Waiting work in the order of turns: tenants take turns, in a tenant its sessions, and in a session the oldest is
//! first.

use crate::answers::{Tenant, WorkOwner};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// How much the newest piece of work counts in a mean.
const NEWEST: f64 = 0.125;

/// While both wait, drags get this many times as much time as the rest.
const DRAGS_TIME: f64 = 3.0;
/// The fewest and the most turns of drags between two turns of the rest while both wait.
const DRAGS_BETWEEN: (u32, u32) = (3, 32);

/// What kind of work waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TurnClass {
    /// A dragged pose.
    Drag,
    /// Everything else.
    Other,
}

/// Why there is no place in the line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LineRefusal {
    /// No more may wait.
    Full,
    /// It would wait this long, which is too long.
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
    class: TurnClass,
    tenant: Tenant,
    is_reserve: bool,
    begun: Option<Instant>,
}

/// How much computes at once.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineSlots {
    /// How many pieces of work.
    pub all: usize,
    /// How many more when there are drags among them.
    pub for_drags: usize,
    /// Whether there is one more, not for drags, while one other tenant has all slots.
    pub one_for_another_tenant: bool,
}

/// A waiting tenant, and where its turn goes.
type TurnWaiter = (Tenant, TurnSender);

/// A place in the line. Given up when dropped.
#[derive(Debug)]
pub(super) struct WaitingPlace {
    line: Arc<FairLine>,
    class: TurnClass,
    ticket: u64,
    turn: TurnReceiver,
}

type TurnSender = oneshot::Sender<Result<LinePermit, LineRefusal>>;
type TurnReceiver = oneshot::Receiver<Result<LinePermit, LineRefusal>>;

/// The line.
#[derive(Debug)]
pub(super) struct FairLine {
    slots: LineSlots,
    /// How many of a class may wait.
    most: usize,
    state: Mutex<LineState>,
}

#[derive(Debug, Default)]
struct LineState {
    drags: ClassState,
    others: ClassState,
    /// The tenants of work other than drags, on slots that any tenant gets.
    holders: Vec<Tenant>,
    /// The tenant on the slot for another tenant.
    reserve_holder: Option<Tenant>,
    next_ticket: u64,
    /// Turns of drags since the last turn of the rest, as far as these waited meanwhile.
    drags_since: u32,
    /// The mean of what that comes to.
    drags_between: f64,
}

#[derive(Debug, Default)]
struct ClassState {
    waiting: TurnQueue<TurnWaiter>,
    /// How many compute.
    busy: usize,
    /// How long a piece of work takes, in seconds.
    mean: f64,
}

impl FairLine {
    /// An empty line for `most` of each class.
    pub fn new(slots: LineSlots, most: usize) -> Arc<Self> {
        Arc::new(Self {
            slots,
            most,
            state: Mutex::default(),
        })
    }

    fn lock(&self) -> MutexGuard<'_, LineState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a place for work that may wait as long as `patience`, without limit for `None`. In a full line the last
    /// work of the tenant that has most makes way for a tenant that has fewer.
    pub fn enter(
        self: &Arc<Self>,
        class: TurnClass,
        owner: &WorkOwner,
        patience: Option<Duration>,
    ) -> Result<LinePlace, LineRefusal> {
        let mut state = self.lock();
        if self.has_room(&state, class) {
            state.note_turn(class, &owner.tenant, self.slots.all);
            return Ok(LinePlace::Free(LinePermit::of(self, class, &owner.tenant)));
        }
        let all_of = self.only_holder(&state);
        if class == TurnClass::Other && all_of.is_some_and(|holder| *holder != owner.tenant) {
            state.reserve_holder = Some(owner.tenant.clone());
            return Ok(LinePlace::Free(LinePermit::of_reserve(self, &owner.tenant)));
        }
        if let Some(patience) = patience {
            let seconds = self.expected_wait(&state, class, owner);
            let expected = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
            if expected > patience {
                return Err(LineRefusal::TooLong(expected));
            }
            let waiting = &mut state.class(class).waiting;
            if waiting.refusable() >= self.most {
                let (_, displaced) = waiting.displace_for(&owner.tenant).ok_or(LineRefusal::Full)?;
                let _ = displaced.send(Err(LineRefusal::Full));
            }
        }
        let (give, turn) = oneshot::channel();
        let ticket = state.next_ticket;
        state.next_ticket += 1;
        let queued = QueuedTurn {
            ticket,
            refusable: patience.is_some(),
            waiter: (owner.tenant.clone(), give),
        };
        state.class(class).waiting.push(owner, queued);
        Ok(LinePlace::Waiting(WaitingPlace {
            line: Arc::clone(self),
            class,
            ticket,
            turn,
        }))
    }

    /// How many compute now.
    pub fn busy(&self) -> usize {
        let state = self.lock();
        state.busy() + usize::from(state.reserve_holder.is_some())
    }

    /// The tenant that has all slots, where the one for another tenant is free.
    fn only_holder<'a>(&self, state: &'a LineState) -> Option<&'a Tenant> {
        let (first, others) = state.holders.split_first()?;
        let is_kept = self.slots.one_for_another_tenant && state.reserve_holder.is_none();
        let has_all = state.holders.len() >= self.slots.all && others.iter().all(|tenant| tenant == first);
        (is_kept && has_all).then_some(first)
    }

    /// Whether one more of a class may compute.
    fn has_room(&self, state: &LineState, class: TurnClass) -> bool {
        let LineSlots { all, for_drags, .. } = self.slots;
        let is_below = state.busy() < all + for_drags;
        is_below && (class == TurnClass::Drag || state.others.busy < all)
    }

    /// The expected wait of new work in seconds: the turns of its class up to its own, and those of the other class
    /// between them.
    fn expected_wait(&self, state: &LineState, class: TurnClass, owner: &WorkOwner) -> f64 {
        let LineState { drags, others, .. } = state;
        let (turns, slots) = match class {
            TurnClass::Drag => {
                let own = drags.waiting.rank(owner) + 1;
                let between = own.div_ceil(state.most_drags_between() as usize);
                let of_others = between.min(others.waiting.waiting_count());
                let turns = own as f64 * drags.mean + of_others as f64 * others.mean;
                (turns, self.slots.all + self.slots.for_drags)
            }
            TurnClass::Other => {
                let own = others.waiting.rank(owner) + 1;
                // Drags ask for the next turn when they have had one, so that those which wait now say nothing about demand.
                let turn = others.mean + state.drags_between * drags.mean;
                (own as f64 * turn, self.slots.all)
            }
        };
        turns / slots.max(1) as f64
    }

    /// Ends a turn and starts the next one.
    fn release(self: &Arc<Self>, permit: &LinePermit, took: Option<Duration>) {
        let mut state = self.lock();
        state.end_turn(permit.class, &permit.tenant);
        if let Some(took) = took {
            state.class(permit.class).note_service(took);
        }
        while let Some(next) = self.next_class(&state) {
            let Some(turn) = state.class(next).waiting.pop() else {
                break;
            };
            let (tenant, give) = turn.waiter;
            match give.send(Ok(LinePermit::of(self, next, &tenant))) {
                Ok(()) => state.note_turn(next, &tenant, self.slots.all),
                // It has gone meanwhile. The permit must not come back here while the state is locked.
                Err(Ok(permit)) => permit.forget(),
                Err(Err(_)) => {}
            }
        }
        while let Some(holder) = self.only_holder(&state).cloned() {
            let Some(turn) = state.others.waiting.pop_other_than(&holder) else {
                break;
            };
            let (tenant, give) = turn.waiter;
            match give.send(Ok(LinePermit::of_reserve(self, &tenant))) {
                Ok(()) => state.reserve_holder = Some(tenant),
                Err(Ok(permit)) => permit.forget(),
                Err(Err(_)) => {}
            }
        }
    }

    /// Which class gets the next turn; `None` when no waiting work may compute.
    fn next_class(&self, state: &LineState) -> Option<TurnClass> {
        let may = |class: TurnClass, of: &ClassState| !of.waiting.is_empty() && self.has_room(state, class);
        let may_drag = may(TurnClass::Drag, &state.drags);
        let may_other = may(TurnClass::Other, &state.others);
        match (may_drag, may_other) {
            (true, true) if state.drags_since >= state.most_drags_between() => Some(TurnClass::Other),
            (true, _) => Some(TurnClass::Drag),
            (false, true) => Some(TurnClass::Other),
            (false, false) => None,
        }
    }
}

impl LineState {
    fn class(&mut self, class: TurnClass) -> &mut ClassState {
        match class {
            TurnClass::Drag => &mut self.drags,
            TurnClass::Other => &mut self.others,
        }
    }

    fn busy(&self) -> usize {
        self.drags.busy + self.others.busy
    }

    /// How many turns drags get before one of the rest while both wait.
    fn most_drags_between(&self) -> u32 {
        let (least, most) = DRAGS_BETWEEN;
        if self.drags.mean <= 0.0 {
            return least;
        }
        // Saturates.
        ((DRAGS_TIME * self.others.mean / self.drags.mean) as u32).clamp(least, most)
    }

    /// Counts a turn of a class that begins.
    fn note_turn(&mut self, class: TurnClass, tenant: &Tenant, slots: usize) {
        match class {
            // On a slot that others may not have it holds none of them up.
            TurnClass::Drag if !self.others.waiting.is_empty() && self.others.busy < slots => {
                self.drags_since = self.drags_since.saturating_add(1);
            }
            TurnClass::Drag => {}
            TurnClass::Other => {
                self.drags_between += (f64::from(self.drags_since) - self.drags_between) * NEWEST;
                self.drags_since = 0;
                self.holders.push(tenant.clone());
            }
        }
        self.class(class).busy += 1;
    }

    /// A piece of work of a tenant is done. What is on the slot for another tenant counts as one on a slot that any tenant gets as soon
    /// as one of those is free.
    fn end_turn(&mut self, class: TurnClass, tenant: &Tenant) {
        if class == TurnClass::Drag {
            self.drags.busy -= 1;
        } else if self.reserve_holder.take_if(|holder| holder == tenant).is_none() {
            let held = self.holders.iter().position(|holder| holder == tenant);
            held.map(|at| self.holders.swap_remove(at));
            self.holders.extend(self.reserve_holder.take());
            self.others.busy = self.holders.len();
        }
    }
}

impl ClassState {
    fn note_service(&mut self, took: Duration) {
        let took = took.as_secs_f64();
        self.mean += if self.mean == 0.0 {
            took
        } else {
            (took - self.mean) * NEWEST
        };
    }
}

impl LinePermit {
    fn of(line: &Arc<FairLine>, class: TurnClass, tenant: &Tenant) -> Self {
        Self {
            line: Some(Arc::clone(line)),
            class,
            tenant: tenant.clone(),
            is_reserve: false,
            begun: None,
        }
    }

    fn of_reserve(line: &Arc<FairLine>, tenant: &Tenant) -> Self {
        let mut permit = Self::of(line, TurnClass::Other, tenant);
        permit.is_reserve = true;
        permit
    }

    /// Whether it is that of the slot which is there while another tenant has all.
    pub fn is_reserve(&self) -> bool {
        self.is_reserve
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
            line.release(self, self.begun.map(|begun| begun.elapsed()));
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
        self.line.lock().class(self.class).waiting.remove(self.ticket);
    }
}

#[cfg(test)]
impl FairLine {
    /// As if a piece of work of a class had taken so long.
    pub(super) fn note_service(&self, class: TurnClass, took: Duration) {
        self.lock().class(class).note_service(took);
    }
}

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

#[cfg(test)]
#[path = "fair_line_tests.rs"]
mod tests;
