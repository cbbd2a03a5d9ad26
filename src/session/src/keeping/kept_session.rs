//! A session that is kept: what its task knows of the log, how it is listed from the store alone, and how much of it is in memory.

use crate::store::{ListedSession, NewSession, Store, StoreError, calendar_text, millis};
use pliant_wire::record::LoggedCommit;
use pliant_wire::{add_found_turns, handle_poses_message, pb};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Where the parts of a state are in the log: the numbers of the commits that brought them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct CommitPlace {
    pub facts_at: u64,
    pub poses_at: u64,
    pub shape_at: u64,
}

/// What a session's task knows of its log.
#[derive(Debug)]
pub(crate) struct KeptSession {
    pub store: Arc<Store>,
    /// Build and processor of this process.
    pub build: String,
    /// Number of the newest commit.
    pub sequence: u64,
    /// Where the states of commits are, by revision.
    pub places: BTreeMap<u64, CommitPlace>,
    /// The commit whose shape is kept.
    pub shape_at: u64,
    /// Solved commits since.
    pub solved_since: u32,
}

impl KeptSession {
    /// The log of a session that was just created.
    pub fn new(store: Arc<Store>) -> Self {
        Self {
            build: store.build(),
            store,
            sequence: 0,
            places: BTreeMap::from([(1, CommitPlace::default())]),
            shape_at: 0,
            solved_since: 0,
        }
    }

    /// A new session with what the log knows of its first commit.
    pub fn first_of(&self, mut session: NewSession) -> NewSession {
        session.first.commit.build.clone_from(&self.build);
        session
    }

    /// Where the state of a revision is.
    pub fn place(&self, revision: u64) -> CommitPlace {
        self.places.get(&revision).copied().unwrap_or_default()
    }

    /// Where the state after a commit of number `sequence` is, made from the state of `from`.
    pub fn place_after(&self, commit: &LoggedCommit, from: u64, sequence: u64) -> CommitPlace {
        let before = self.place(from);
        match commit {
            LoggedCommit::Handles { .. } => CommitPlace {
                facts_at: sequence,
                poses_at: sequence,
                ..before
            },
            LoggedCommit::Pose { .. } => CommitPlace {
                poses_at: sequence,
                shape_at: sequence,
                ..before
            },
            LoggedCommit::Create { .. } | LoggedCommit::Edit { .. } => CommitPlace {
                facts_at: sequence,
                poses_at: sequence,
                shape_at: sequence,
            },
            LoggedCommit::Step { target, .. } => self.place(*target),
        }
    }
}

/// A session that is not in memory, as its owner sees it on a server that began at `started_ms`.
pub(crate) fn listed_facts(session: &ListedSession, started_ms: u64) -> Result<pb::Session, StoreError> {
    let record = &session.record;
    let ttl = millis(record.ttl);
    let end = session.used_ms.max(started_ms).saturating_add(ttl);
    Ok(pb::Session {
        id: record.id.clone(),
        revision: session.newest.revision,
        created_at: calendar_text(record.created_ms),
        expires_at: calendar_text(end),
        label: record.label.clone(),
        ..state_facts(&session.facts, &session.poses)?
    })
}

/// The facts and poses of a state, from the commits that recorded them.
pub(crate) fn state_facts(facts: &LoggedCommit, poses: &LoggedCommit) -> Result<pb::Session, StoreError> {
    let wrong = || StoreError::Damaged("a commit names one of another kind".into());
    let mut session = match facts {
        LoggedCommit::Create { facts } | LoggedCommit::Handles { facts, .. } | LoggedCommit::Edit { facts, .. } => {
            (**facts).clone()
        }
        _ => return Err(wrong()),
    };
    match poses {
        LoggedCommit::Create { .. } => {}
        LoggedCommit::Handles { poses, .. } | LoggedCommit::Edit { poses, .. } => {
            handle_poses_message(&mut session.handles, poses);
        }
        LoggedCommit::Pose {
            chain,
            warnings,
            found_turns,
            ..
        } => {
            session.warnings.extend(warnings.iter().cloned());
            add_found_turns(&mut session.handles, found_turns);
            handle_poses_message(&mut session.handles, &chain.pose.poses);
        }
        LoggedCommit::Step { .. } => return Err(wrong()),
    }
    Ok(session)
}

/// How much of an idle session is in memory still.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum MemoryState {
    /// All of it.
    #[default]
    Full,
    /// Without shapes that can be solved again and what is derived from the engine.
    Trimmed,
}
