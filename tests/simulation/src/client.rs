//! A client of one session: it repeats each call under its key until it is answered, and knows from the answers alone what the session
//! must be.

use crate::calls::{Answered, Call, carry_out};
use crate::engine::NO_MEMORY;
use crate::faults::Faults;
use crate::post::Post;
use crate::random::Random;
use crate::report::Report;
use futures::FutureExt as _;
use pliant_session::{Error, ErrorCode, Manager};
use pliant_wire::pb;
use std::sync::Arc;
use std::time::Duration;

/// Calls of one session.
const CALLS: u64 = 25;

/// A commit as a client knows it: revision and digest.
pub type KnownCommit = (u64, String);

/// What a client knows of its session.
#[derive(Debug, Clone, Default)]
pub struct KnownSession {
    pub id: String,
    /// The commits that can be gone to.
    commits: Vec<KnownCommit>,
    at: usize,
    is_bar: bool,
    /// All that was acknowledged, undo and redo among them.
    pub acknowledged: Vec<KnownCommit>,
    /// What histories were before.
    past: Vec<(Vec<KnownCommit>, u64)>,
}

/// A client.
pub struct Client {
    pub name: String,
    pub nodes: Vec<String>,
    pub calls: Arc<Post<Manager>>,
    pub random: Random,
    pub faults: Faults,
    pub report: Report,
    /// The node that answered last.
    pub node: String,
    pub session: KnownSession,
}

impl Client {
    /// Lives the life of a session; returns what must be stored of it.
    pub async fn run(mut self) -> KnownSession {
        // Half of the clients have the bar, and the product's engine.
        let points = self.random.below(0..2) * self.random.below(1..40);
        self.session.is_bar = points == 0;
        let created = Call::Create { points };
        self.make(0, created).await;
        let on_bar = self.session.is_bar;
        self.make(1, Call::Handles { count: 2, on_bar }).await;
        for number in 2..CALLS {
            tokio::time::sleep(self.random.span(0..1500)).await;
            if self.random.happens(80) {
                // Long enough for the session to leave memory.
                tokio::time::sleep(Duration::from_secs(7)).await;
            }
            let call = self.next_call();
            self.make(number, call).await;
        }
        // What was seen while all was well again is what is stored.
        while self.faults.are_active() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        tokio::time::sleep(Duration::from_secs(15)).await;
        self.session.past.clear();
        self.make(CALLS, Call::Look).await;
        if self.random.happens(200) {
            self.make(CALLS + 1, Call::Delete).await;
            self.session.acknowledged.clear();
        }
        self.session
    }

    fn next_call(&self) -> Call {
        let (can_undo, can_redo) = (self.session.at > 1, self.session.at + 1 < self.session.commits.len());
        loop {
            match self.random.below(0..12) {
                0 => {
                    let (count, on_bar) = (self.random.below(1..4), self.session.is_bar);
                    return Call::Handles { count, on_bar };
                }
                1 | 2 if can_undo => return Call::Undo,
                3 | 4 if can_redo => return Call::Redo,
                5 => return Call::Look,
                6 if self.session.is_bar => {
                    let height = self.random.below(20..200);
                    return Call::Cut { height };
                }
                7 | 8 => {
                    let poses = self.random.below(2..30);
                    let x = self.random.below(0..1000);
                    return Call::Drag { poses, x };
                }
                9.. => {
                    let x = self.random.below(0..1000);
                    return Call::Solve { x };
                }
                _ => {}
            }
        }
    }

    /// Makes a call until it is answered.
    async fn make(&mut self, number: u64, call: Call) {
        let key = format!("{}-{number}", self.name);
        for attempt in 1u64.. {
            let (id, at, asked) = (self.session.id.clone(), key.clone(), call.clone());
            let question = move |manager: Manager| async move { carry_out(&manager, &id, asked, at).await }.boxed();
            let patience = self.random.span(1000..15_000);
            let answer = self.calls.ask(&self.node, patience, question).await;
            let answer = match answer {
                Ok(answer) => answer,
                Err(_) => Err(Error::new(ErrorCode::Unavailable, "no answer came")),
            };
            match answer {
                Ok(answered) => {
                    self.report.count_operation();
                    self.report
                        .line(format_args!("{key} {call:?} by {} in {attempt}: {answered}", self.node));
                    self.take(&key, &call, answered);
                    return;
                }
                Err(error) if error.code == ErrorCode::NotFound && matches!(call, Call::Delete) => return,
                // What is left of the bar may lie above a cut, and have no lower end.
                Err(error)
                    if matches!(call, Call::Cut { .. } | Call::Handles { on_bar: true, .. }) && is_of_bar(&error) =>
                {
                    self.report.line(format_args!("{key} {call:?}: {}", error.message));
                    return;
                }
                Err(error) => self.refused(&key, &call, &error).await,
            }
            if self.report.is_violated() {
                return;
            }
        }
    }

    /// Goes on after an error that may pass; notes one that must not be.
    async fn refused(&mut self, key: &str, call: &Call, error: &Error) {
        let passes = matches!(
            error.code,
            ErrorCode::Unavailable
                | ErrorCode::Aborted
                | ErrorCode::ResourceExhausted
                | ErrorCode::DeadlineExceeded
                | ErrorCode::Cancelled
        ) || error.message.contains(NO_MEMORY);
        let line = format!("{key} {call:?} by {}: {:?} {}", self.node, error.code, error.message);
        match passes {
            true => self.report.line(line),
            false => self.report.violation(line),
        }
        match &error.owner {
            Some(owner) if !owner.node.is_empty() => self.node.clone_from(&owner.node),
            _ => {
                let other = self.random.below(0..self.nodes.len() as u64);
                self.node.clone_from(&self.nodes[other as usize]);
            }
        }
        tokio::time::sleep(self.random.span(20..600)).await;
    }

    /// Compares an answer with what is known, and learns from it.
    fn take(&mut self, key: &str, call: &Call, answered: Answered) {
        let session = &mut self.session;
        let before = session.clone();
        match call {
            Call::Create { .. } => {
                session.id = answered.id;
                session.commits = vec![(answered.revision, String::new())];
            }
            Call::Handles { .. } | Call::Solve { .. } | Call::Drag { .. } | Call::Cut { .. } => {
                session.commits.truncate(session.at + 1);
                session.commits.push((answered.revision, String::new()));
                session.at += 1;
            }
            Call::Undo => session.at -= 1,
            Call::Redo => session.at += 1,
            Call::Look | Call::Delete => {}
        }
        if let Some(wrong) = answered.wrong {
            self.report.violation(format!("{key}: {wrong}"));
        }
        let Some(history) = answered.history else {
            // Another node has it by now, or it is deleted.
            self.acknowledge(call, answered.revision);
            return;
        };
        let seen = (commits_of(&history), history.current);
        if !session.fits(&seen) {
            let is_past = before.past.contains(&seen) || before.fits(&seen);
            if !is_past || !matches!(call, Call::Look) {
                let text = format!(
                    "{key}: history {seen:?}, expected {:?} at {}",
                    session.commits, session.at
                );
                self.report.violation(text);
            }
            return;
        }
        session.commits.clone_from(&seen.0);
        session.past.push(seen);
        self.acknowledge(call, answered.revision);
    }

    /// Adds a call to what must be stored.
    fn acknowledge(&mut self, call: &Call, revision: u64) {
        if !matches!(call, Call::Look | Call::Delete) {
            let digest = self.session.commits[self.session.at].1.clone();
            self.session.acknowledged.push((revision, digest));
        }
    }
}

fn is_of_bar(error: &Error) -> bool {
    matches!(
        error.code,
        ErrorCode::FailedPrecondition | ErrorCode::InvalidArgument { .. }
    )
}

fn commits_of(history: &pb::HistoryResponse) -> Vec<KnownCommit> {
    let commits = history.commits.iter();
    commits.map(|commit| (commit.revision, commit.digest.clone())).collect()
}

impl KnownSession {
    /// Whether a history is this one; digests that no answer named yet may be any.
    fn fits(&self, (commits, current): &(Vec<KnownCommit>, u64)) -> bool {
        let same =
            |known: &KnownCommit, seen: &KnownCommit| known.0 == seen.0 && (known.1.is_empty() || known.1 == seen.1);
        let pairs = self.commits.iter().zip(commits);
        self.commits.len() == commits.len()
            && pairs.into_iter().all(|(known, seen)| same(known, seen))
            && self.commits.get(self.at).is_some_and(|at| at.0 == *current)
    }
}
