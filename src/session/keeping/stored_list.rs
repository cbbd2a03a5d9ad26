//! Listed sessions, from the store alone: no session is opened.

use crate::session::store::{ListedSession, StoreError, calendar_text};
use crate::wire::record::LoggedCommit;
use crate::wire::{handle_poses_message, pb};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// A session that is not in memory, as its owner sees it on a server that began at `started_ms`.
pub(in crate::session) fn listed_facts(session: &ListedSession, started_ms: u64) -> Result<pb::Session, StoreError> {
    let ttl = u64::try_from(session.ttl.as_millis()).unwrap_or(u64::MAX);
    let end = Duration::from_millis(session.used_ms.max(started_ms).saturating_add(ttl));
    let end = UNIX_EPOCH.checked_add(end).unwrap_or(SystemTime::UNIX_EPOCH);
    Ok(pb::Session {
        id: session.id.clone(),
        revision: session.newest.revision,
        created_at: calendar_text(session.created_ms),
        expires_at: humantime::format_rfc3339_millis(end).to_string(),
        label: session.label.clone(),
        ..state_facts(&session.facts, &session.poses)?
    })
}

/// The facts and poses of a state, from the commits that recorded them.
pub(in crate::session) fn state_facts(facts: &LoggedCommit, poses: &LoggedCommit) -> Result<pb::Session, StoreError> {
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
        LoggedCommit::Pose { poses, warnings, .. } => {
            session.warnings.extend(warnings.iter().cloned());
            handle_poses_message(&mut session.handles, poses);
        }
        LoggedCommit::Step { .. } => return Err(wrong()),
    }
    Ok(session)
}
