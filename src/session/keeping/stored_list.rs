//! Listed sessions, from the store alone: no session is opened.

use crate::engine::{DeformerFacts, HandlePoses};
use crate::session::answers::SessionFacts;
use crate::session::store::{ListedSession, StoreError, calendar_text};
use crate::wire::record::LoggedCommit;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// A session that is not in memory, as its owner sees it on a server that began at `started_ms`.
pub(in crate::session) fn listed_facts(session: &ListedSession, started_ms: u64) -> Result<SessionFacts, StoreError> {
    let (deformer, poses) = state_facts(&session.facts, &session.poses)?;
    let ttl = u64::try_from(session.ttl.as_millis()).unwrap_or(u64::MAX);
    let end = Duration::from_millis(session.used_ms.max(started_ms).saturating_add(ttl));
    let end = UNIX_EPOCH.checked_add(end).unwrap_or(SystemTime::UNIX_EPOCH);
    Ok(SessionFacts {
        id: session.id.clone(),
        revision: session.newest.revision,
        deformer: Arc::new(deformer),
        poses,
        build_ms: BTreeMap::new(),
        created_at: calendar_text(session.created_ms),
        expires_at: humantime::format_rfc3339_millis(end).to_string(),
        label: session.label.clone(),
    })
}

/// The facts and poses of a state, from the commits that recorded them.
pub(in crate::session) fn state_facts(
    facts: &LoggedCommit,
    poses: &LoggedCommit,
) -> Result<(DeformerFacts, HandlePoses), StoreError> {
    let wrong = || StoreError::Damaged("a commit names one of another kind".into());
    let mut told = match facts {
        LoggedCommit::Create { facts } | LoggedCommit::Handles { facts, .. } => facts.clone(),
        LoggedCommit::Edit { facts, .. } => (**facts).clone(),
        _ => return Err(wrong()),
    };
    let poses = match poses {
        LoggedCommit::Create { .. } => HandlePoses::default(),
        LoggedCommit::Handles { poses, .. } | LoggedCommit::Edit { poses, .. } => poses.clone(),
        LoggedCommit::Pose { poses, warnings, .. } => {
            told.warnings.extend(warnings.iter().cloned());
            poses.clone()
        }
        LoggedCommit::Step { .. } => return Err(wrong()),
    };
    Ok((told, poses))
}
