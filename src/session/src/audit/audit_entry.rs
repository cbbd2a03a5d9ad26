//! One entry of the trail.

use crate::answers::Tenant;
use pliant_wire::record::LoggedCommit;
use std::fmt;
use std::sync::Arc;

/// An action on a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AuditedAction {
    /// It was opened on a model.
    Create,
    /// Its handles were set, changed or removed.
    Handles,
    /// A pose was committed.
    Pose,
    /// Its topology was edited.
    Edit,
    /// A commit was undone.
    Undo,
    /// An undone commit was redone.
    Redo,
    /// A stream was opened on it.
    Stream,
    /// Its model or its positions were exported.
    Export,
    /// A picture of it was drawn, or its regions were named.
    Look,
    /// Something was carried along with it.
    Carry,
    /// Crossings of its surface were looked for.
    Crossings,
    /// A rig was made of its model.
    Rig,
    /// Something came to its model from another one, and was returned.
    Transfer,
    /// It was driven by a clip.
    Animate,
    /// It was deleted.
    Delete,
    /// It expired.
    Expire,
}

impl AuditedAction {
    /// The word for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Create => "create",
            Self::Handles => "handles",
            Self::Pose => "pose",
            Self::Edit => "edit",
            Self::Undo => "undo",
            Self::Redo => "redo",
            Self::Stream => "stream",
            Self::Export => "export",
            Self::Look => "look",
            Self::Carry => "carry",
            Self::Crossings => "crossings",
            Self::Rig => "rig",
            Self::Transfer => "transfer",
            Self::Animate => "animate",
            Self::Delete => "delete",
            Self::Expire => "expire",
        }
    }

    /// The action of a commit.
    pub(crate) const fn of_commit(commit: &LoggedCommit) -> Self {
        match commit {
            LoggedCommit::Create { .. } => Self::Create,
            LoggedCommit::Handles { .. } => Self::Handles,
            LoggedCommit::Pose { .. } => Self::Pose,
            LoggedCommit::Edit { .. } => Self::Edit,
            LoggedCommit::Step { forward: false, .. } => Self::Undo,
            LoggedCommit::Step { forward: true, .. } => Self::Redo,
        }
    }
}

impl fmt::Display for AuditedAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Who did what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditEntry {
    /// The tenant concerned.
    pub tenant: Tenant,
    /// The caller, as authentication names it; "pliant" without one.
    pub who: Arc<str>,
    /// What was done.
    pub what: AuditedAction,
    /// The session concerned.
    pub session: String,
}

impl AuditEntry {
    /// An entry without a caller.
    pub(crate) fn by_itself(tenant: &Tenant, what: AuditedAction, session: &str) -> Self {
        Self {
            tenant: tenant.clone(),
            who: "pliant".into(),
            what,
            session: session.to_owned(),
        }
    }

    /// Writes it as a line of the log, under the target `pliant::audit`.
    pub(crate) fn log(&self) {
        let Self {
            tenant,
            who,
            what,
            session,
        } = self;
        tracing::info!(
            target: "pliant::audit",
            tenant = &*tenant.0,
            caller = &**who,
            action = what.name(),
            session.id = %session,
            "{what} by {who}"
        );
    }
}

/// An entry as a store gives it back.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct StoredAuditEntry {
    /// When, in milliseconds since 1970.
    #[serde(skip)]
    pub at_ms: u64,
    /// The tenant concerned.
    pub tenant: String,
    /// The caller.
    pub caller: String,
    /// What was done: the name of an [`AuditedAction`], or one of a later version.
    pub action: String,
    /// The session concerned.
    pub session: String,
}
