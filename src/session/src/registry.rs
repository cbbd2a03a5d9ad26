//! The sessions of this process, and what all tasks may use of each.
//!
//! Lookups hand out clones of `Arc`s; no guard of the map leaves this file.
//!
//! Removed sessions whose memory is not free yet: a call that needs room waits for them before it is rejected.

use crate::answers::{Tenant, WorkOwner};
use crate::calls::command::SessionCommand;
use crate::capacity::call_queue::{CallQueue, SessionLease};
use crate::capacity::work_watch::{WorkKind, WorkWatch};
use crate::config::SessionConfig;
use crate::error::{Error, ErrorCode};
use crate::history::commit_history::ShownCommits;
use crate::history::session_state::CommittedHandles;
use crate::store::{HeldSession, calendar_text};
use crate::stream::mailbox::Mailbox;
use dashmap::DashMap;
use glam::DVec3;
use pliant_asset::Format;
use pliant_core::engine::HandlePoses;
use pliant_exec::progress::CancelFlag;
use pliant_wire::{handle_poses_message, pb};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering::{Relaxed, SeqCst};
use std::sync::atomic::{AtomicBool, AtomicUsize};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock};
use std::time::Duration;
use tokio::sync::{Notify, mpsc};
use tokio_util::sync::CancellationToken;

/// What a session looks like after its newest change. Replaced as a whole by the session's task.
#[derive(Debug)]
pub(super) struct SessionView {
    pub revision: u64,
    pub facts: Arc<pb::Session>,
    pub handles: Arc<CommittedHandles>,
    pub poses: HandlePoses,
    pub build_ms: BTreeMap<String, f64>,
    pub positions: Arc<Vec<DVec3>>,
    pub digest: String,
    pub history: ShownCommits,
}

/// One session, as seen from outside its task.
#[derive(Debug)]
pub(super) struct OpenSession {
    pub id: String,
    /// The session as its store knows it.
    pub held: HeldSession,
    pub tenant: Tenant,
    /// Sessions are numbered in the order of their creation.
    pub number: u64,
    pub label: String,
    /// When it was opened, in milliseconds since 1970.
    pub created_ms: u64,
    pub format: Format,
    pub lease: SessionLease,
    pub commands: mpsc::Sender<SessionCommand>,
    /// The calls that wait for answers.
    pub line: CallQueue,
    pub streams: OpenStreams,
    pub animations: OpenAnimations,
    /// Wakes the session's task when a stream has work for it.
    pub wake: Arc<Notify>,
    /// Stops the session's work.
    pub cancel: Arc<CancelFlag>,
    /// Raised when the session is to end.
    pub closing: CancellationToken,
    /// Raised when it has ended and its memory is on its way back.
    pub ended: CancellationToken,
    pub view: RwLock<Arc<SessionView>>,
    pub why: OnceLock<Error>,
    /// Raised when the session is to leave memory once unused.
    pub leave: AtomicBool,
    /// Raised when it has left memory and is in its store alone: late calls find it there.
    pub unloaded: AtomicBool,
    /// Whether its task works.
    pub busy: AtomicBool,
    /// The work that runs.
    pub work: Mutex<Option<(WorkKind, Arc<WorkWatch>)>>,
}

impl OpenSession {
    /// Whose work on it is.
    pub fn work_owner(&self) -> WorkOwner {
        WorkOwner {
            tenant: self.tenant.clone(),
            session: self.id.clone(),
        }
    }

    /// The state after the newest change.
    pub fn view(&self) -> Arc<SessionView> {
        Arc::clone(&self.view.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Shows a new state.
    pub fn publish(&self, view: SessionView) {
        *self.view.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(view);
    }

    /// The session as its owner sees it.
    pub fn describe(&self) -> pb::Session {
        let view = self.view();
        let mut session = pb::Session {
            id: self.id.clone(),
            revision: view.revision,
            build_ms: view.build_ms.clone(),
            created_at: calendar_text(self.created_ms),
            expires_at: self.lease.end_text(),
            label: self.label.clone(),
            ..(*view.facts).clone()
        };
        handle_poses_message(&mut session.handles, &view.poses);
        session
    }

    /// The same with the work that runs.
    pub fn describe_with_work(&self) -> pb::Session {
        let work = self.work().as_ref().map(|(kind, watch)| {
            let (stage, fraction) = watch.newest_report().unwrap_or_default();
            pb::Work {
                kind: kind.name().into(),
                stage: stage.into(),
                fraction: f64::from(fraction),
                elapsed_ms: watch.elapsed().as_secs_f64() * 1e3,
            }
        });
        pb::Session {
            work,
            ..self.describe()
        }
    }

    /// The work that runs.
    pub fn work(&self) -> MutexGuard<'_, Option<(WorkKind, Arc<WorkWatch>)>> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Strong entity tag of the current shape in a representation, with its quotes.
    pub fn etag(view: &SessionView, representation: &str) -> String {
        let digest = view.digest.rsplit(':').next().unwrap_or_default();
        format!("\"{}-{representation}-{digest}\"", view.revision)
    }

    /// Whether it has left memory.
    pub fn has_left(&self) -> bool {
        self.unloaded.load(SeqCst)
    }

    /// Ends the session: its work stops, its streams say why, later calls do too.
    pub fn close(&self, why: Error) {
        let why = self.why.get_or_init(|| why);
        self.cancel.cancel();
        self.streams.close(why);
        self.closing.cancel();
    }

    /// Why calls on this session fail once it is closing.
    pub fn why(&self) -> Error {
        self.why.get().cloned().unwrap_or_else(|| Error::no_session(&self.id))
    }
}

/// The streams open on one session.
#[derive(Debug)]
pub(super) struct OpenStreams {
    /// `None` once the session has ended.
    open: Mutex<Option<Vec<Arc<Mailbox>>>>,
    most: usize,
}

impl OpenStreams {
    pub fn new(config: &SessionConfig) -> Self {
        Self {
            open: Mutex::new(Some(Vec::new())),
            most: config.streams,
        }
    }

    fn open(&self) -> MutexGuard<'_, Option<Vec<Arc<Mailbox>>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a stream.
    pub fn add(&self, mailbox: Arc<Mailbox>) -> Result<(), Error> {
        let mut open = self.open();
        let Some(list) = open.as_mut() else {
            return Err(Error::new(ErrorCode::NotFound, "the session has ended"));
        };
        if list.len() >= self.most {
            let text = format!(
                "{} streams are open on this session, at most {} are allowed",
                list.len(),
                self.most
            );
            return Err(Error::exhausted(text, 1));
        }
        list.push(mailbox);
        Ok(())
    }

    pub fn remove(&self, mailbox: &Arc<Mailbox>) {
        if let Some(list) = self.open().as_mut() {
            list.retain(|m| !Arc::ptr_eq(m, mailbox));
        }
    }

    /// The streams open now.
    pub fn all(&self) -> Vec<Arc<Mailbox>> {
        self.open().as_ref().map_or_else(Vec::new, Vec::clone)
    }

    /// Ends the place for streams unless there are some. False when there are.
    pub fn close_if_none(&self) -> bool {
        let mut open = self.open();
        if open.as_ref().is_some_and(|list| !list.is_empty()) {
            return false;
        }
        *open = None;
        true
    }

    fn close(&self, why: &Error) {
        let list = self.open().take();
        list.into_iter().flatten().for_each(|m| m.close(why.clone()));
    }
}

/// How many animations are under way on a session, which does not expire meanwhile.
#[derive(Debug, Default)]
pub(super) struct OpenAnimations(AtomicUsize);

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

/// Every session of the process by id.
#[derive(Debug, Default)]
pub(super) struct SessionRegistry {
    sessions: DashMap<String, Arc<OpenSession>>,
    /// Those that were removed and have not ended.
    pub departing: DepartingSessions,
}

impl SessionRegistry {
    pub fn insert(&self, session: Arc<OpenSession>) {
        self.sessions.insert(session.id.clone(), session);
    }

    pub fn remove(&self, id: &str) {
        self.note_departure(self.sessions.remove(id));
    }

    /// Removes this session, and not one that came back under its id. Returns whether it was there.
    pub fn remove_this(&self, session: &Arc<OpenSession>) -> bool {
        let removed = (self.sessions).remove_if(&session.id, |_, there| Arc::ptr_eq(there, session));
        let was_there = removed.is_some();
        self.note_departure(removed);
        was_there
    }

    fn note_departure(&self, removed: Option<(String, Arc<OpenSession>)>) {
        if let Some((_, session)) = removed {
            self.departing.add(session.tenant.clone(), session.ended.clone());
        }
    }

    /// Whether a session is in memory.
    pub fn holds(&self, id: &str) -> bool {
        self.sessions.contains_key(id)
    }

    /// A session in memory, its lease left as it is.
    pub fn peek(&self, id: &str) -> Option<Arc<OpenSession>> {
        self.sessions.get(id).map(|entry| Arc::clone(entry.value()))
    }

    /// How long it takes until the first of the tenant's sessions in memory expires without use.
    pub fn soonest_end(&self, tenant: &Tenant) -> Duration {
        let own = self.all().into_iter().filter(|session| session.tenant == *tenant);
        let soonest = own.map(|session| session.lease.end()).min();
        soonest.map_or(Duration::from_secs(60), |end| {
            end.saturating_duration_since(tokio::time::Instant::now())
        })
    }

    /// The tenant's session of that id, its lease renewed.
    ///
    /// # Errors
    /// `NOT_FOUND`, also for another tenant's session.
    pub fn find(&self, tenant: &Tenant, id: &str) -> Result<Arc<OpenSession>, Error> {
        let found = self.sessions.get(id).map(|entry| Arc::clone(entry.value()));
        let session = found
            .filter(|s| s.tenant == *tenant)
            .ok_or_else(|| Error::no_session(id))?;
        if session.closing.is_cancelled() {
            return Err(session.why());
        }
        session.lease.renew();
        Ok(session)
    }

    /// Every session, oldest first.
    pub fn all(&self) -> Vec<Arc<OpenSession>> {
        let mut all: Vec<_> = self.sessions.iter().map(|entry| Arc::clone(entry.value())).collect();
        all.sort_unstable_by_key(|session| session.number);
        all
    }
}

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
mod departing_sessions_tests {
    use super::*;

    #[test]
    fn an_end_is_reported_once_and_until_then_it_can_be_waited_for() {
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
