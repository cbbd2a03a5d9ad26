//! What a session's task knows of the log that it keeps.

use crate::session::store::{NewSession, ReadSessions};
use crate::wire::record::LoggedCommit;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Where the parts of a state are in the log: the numbers of the commits that brought them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::session) struct CommitPlace {
    pub facts_at: u64,
    pub poses_at: u64,
    pub shape_at: u64,
}

/// What a session's task knows of its log.
#[derive(Debug)]
pub(in crate::session) struct KeptSession {
    pub store: Arc<dyn ReadSessions>,
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
    pub fn new(store: Arc<dyn ReadSessions>) -> Self {
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
