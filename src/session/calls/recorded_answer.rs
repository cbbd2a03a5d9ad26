//! Answers of calls with an idempotency key from before the server was started again. What a call answered follows from its
//! commit, so the commit alone is kept.

use crate::session::answers::Tenant;
use crate::session::calls::command::{RecallPose, StoredAnswer};
use crate::session::calls::idempotency::answer_of_another_call;
use crate::session::calls::manager::Manager;
use crate::session::error::{Error, ErrorCode};
use crate::session::keeping::stored_list::state_facts;
use crate::session::store::{Commit, ReadSessions};
use crate::wire::pb;
use crate::wire::record::LoggedCommit;
use std::sync::Arc;

impl Manager {
    /// An answer that is kept, brought back from the store where only its commit is known.
    pub(in crate::session) async fn kept_answer(
        &self,
        tenant: &Tenant,
        answer: StoredAnswer,
    ) -> Result<StoredAnswer, Error> {
        let StoredAnswer::Recorded { session, sequence } = answer else {
            return Ok(answer);
        };
        let store = self.shared.store.as_ref().ok_or_else(answer_of_another_call)?;
        let gone = || {
            let text = "the call with this idempotency key was carried out, but what it changed is gone since";
            Error::new(ErrorCode::AlreadyExists, text)
        };
        let stored = store.commit(session.clone(), sequence).await?.ok_or_else(gone)?;
        match &stored.record {
            LoggedCommit::Edit { report, .. } => Ok(StoredAnswer::Edited(Box::new(pb::EditResult {
                revision: stored.revision,
                ..(**report).clone()
            }))),
            LoggedCommit::Pose { frame, .. } => {
                let frame = frame.clone().ok_or_else(answer_of_another_call)?;
                let open = self.find(tenant, &session).await?;
                let revision = stored.revision;
                let recalled = self.call(&open, None, RecallPose { revision, frame }).await?;
                recalled
                    .map(|pose| StoredAnswer::Solved(Box::new(pose)))
                    .ok_or_else(gone)
            }
            _ => {
                let open = self.find(tenant, &session).await?;
                let described = self.state_then(store, &stored, open.describe()).await?;
                Ok(StoredAnswer::Session(Box::new(described)))
            }
        }
    }

    /// A session as it was after a commit.
    async fn state_then(
        &self,
        store: &Arc<dyn ReadSessions>,
        stored: &Commit,
        now: pb::Session,
    ) -> Result<pb::Session, Error> {
        let missing = || Error::new(ErrorCode::DataLoss, "a commit that a later one names is missing");
        let mut parts = Vec::with_capacity(2);
        for sequence in [stored.facts_at, stored.poses_at] {
            let part = store.commit(now.id.clone(), sequence).await?.ok_or_else(missing)?;
            parts.push(part.record);
        }
        Ok(pb::Session {
            id: now.id,
            revision: stored.revision,
            created_at: now.created_at,
            expires_at: now.expires_at,
            label: now.label,
            ..state_facts(&parts[0], &parts[1])?
        })
    }
}
