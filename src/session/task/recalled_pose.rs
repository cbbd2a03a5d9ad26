//! Commits that were made before: the frame of one is made again from its shape, and a commit of a stream that comes a second
//! time is answered with it.

use crate::engine::{self, TopologyState};
use crate::session::answers::CommittedPose;
use crate::session::calls::command::{StoredAnswer, WorkOrder};
use crate::session::calls::idempotency::{ClaimOutcome, RequestFingerprint, answer_of_another_call};
use crate::session::calls::shared_keys::claim_everywhere;
use crate::session::error::{Error, ErrorCode};
use crate::session::task::session_task::SessionTask;
use crate::wire::PoseKey;
use crate::wire::frames::Frame;
use crate::wire::record::{AnsweredFrame, LoggedCommit};
use std::sync::Arc;

impl SessionTask {
    /// Claims the key of a commit on a stream, or gives the answer that is kept for it. Commits of one session take turns, so the
    /// one before has either been recorded or left its key free.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` for a key that was used with other handles.
    pub async fn claim_stream_commit(&mut self, key: &PoseKey) -> Result<ClaimOutcome<StoredAnswer>, Error> {
        let parts = [self.session.id.as_bytes(), key.request.as_slice()];
        let fingerprint = RequestFingerprint::of("stream_commit", &parts);
        claim_everywhere(&self.shared, &self.session.tenant, &key.key, fingerprint).await
    }

    /// The frame that a commit was answered with, as the answer to the pose of number `seq`.
    ///
    /// # Errors
    /// `ALREADY_EXISTS` when it was recorded and cannot be gone to any more; errors of the store.
    pub async fn recall_answer(
        &mut self,
        answer: StoredAnswer,
        seq: u64,
        order: impl Fn() -> WorkOrder,
    ) -> Result<Frame, Error> {
        let committed = match answer {
            StoredAnswer::Solved(committed) => *committed,
            StoredAnswer::Recorded { session, sequence } => {
                let gone = || {
                    let text = "the commit with this idempotency key was recorded, but can no longer be gone to";
                    Error::new(ErrorCode::AlreadyExists, text)
                };
                let kept = self.kept.as_ref().ok_or_else(answer_of_another_call)?;
                let store = Arc::clone(&kept.store);
                let stored = store.commit(session, sequence).await?.ok_or_else(gone)?;
                let LoggedCommit::Pose { frame: Some(frame), .. } = stored.record else {
                    return Err(answer_of_another_call());
                };
                let recalled = self.recall(stored.revision, *frame, order).await?;
                recalled.ok_or_else(gone)?
            }
            _ => return Err(answer_of_another_call()),
        };
        let mut frame = committed.frame;
        frame.header.seq = seq;
        frame.diagonal = self.history.current().diagonal;
        Ok(frame)
    }

    /// The frame of a pose that was committed with this revision.
    pub async fn recall(
        &mut self,
        revision: u64,
        frame: AnsweredFrame,
        order: impl Fn() -> WorkOrder,
    ) -> Result<Option<CommittedPose>, Error> {
        let Some(index) = self.history.index_of(revision) else {
            return Ok(None);
        };
        let Some(shape) = self.shape_of_commit(index, order()).await? else {
            return Ok(None);
        };
        let Some(state) = self.history.state(index) else {
            return Ok(None);
        };
        let (digest, diagonal, topology) = (state.digest.clone(), state.diagonal, state.topology.clone());
        let AnsweredFrame { mut header, output } = frame;
        header.revision = revision;
        let id = topology.as_ref().map(TopologyState::id);
        let part_bytes = self.shared.config.part_bytes;
        let (made, watch) = self
            .compute(order(), move |deformer, work| {
                deformer.go_to_topology(topology.as_ref(), &work.exec())?;
                let is_shaded = output.normals || output.tangents;
                let shading = is_shaded.then(|| Arc::new(deformer.shader().shade(&shape.positions)));
                let frame = Frame {
                    header,
                    topology: id,
                    diagonal,
                    positions: shape.positions,
                    shading,
                    output,
                    part_bytes,
                    ..Frame::default()
                };
                Ok::<_, engine::Error>(frame.for_new_reader())
            })
            .await?;
        let frame = made.map_err(|e| self.failure(e, &watch))?;
        Ok(Some(CommittedPose {
            frame,
            revision,
            digest,
        }))
    }
}
