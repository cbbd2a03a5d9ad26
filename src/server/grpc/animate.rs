//! The Animate stream over gRPC: options and the bytes of a clip come in, then acknowledgements; frames go out.
//!
//! The response body pulls frames, one part at a time, as fast as HTTP/2 lets it. Dropping it (the client left, or its deadline
//! passed) stops the animation.

use super::status::{inbound_message, status};
use crate::engine::ClipSource;
use crate::server::animation_frames::AnimationFrames;
use crate::server::state::State;
use crate::session::{AnimationControl, Error, ErrorCode, Manager, Tenant};
use crate::wire::pb::{self, animate_request::Message};
use crate::wire::{AnimateOrder, animate_order};
use bytes::Bytes;
use futures::Stream;
use tokio::sync::oneshot;
use tokio_util::task::AbortOnDropHandle;
use tonic::{Status, Streaming};

/// The frames that `inbound` asks for.
pub(super) fn animation_frames(
    state: State,
    caller: (Manager, Tenant),
    inbound: Streaming<pb::AnimateRequest>,
) -> impl Stream<Item = Result<pb::Frame, Status>> + Send {
    futures::stream::unfold(
        AnimationPhase::Waiting(Box::new((state, caller, inbound))),
        |phase| async move {
            let mut open = match phase {
                AnimationPhase::Waiting(parts) => {
                    let (state, caller, inbound) = *parts;
                    match OpenAnimation::start(state, &caller, inbound).await {
                        Ok(open) => Box::new(open),
                        Err(status) => return Some((Err(status), AnimationPhase::Over)),
                    }
                }
                AnimationPhase::Open(open) => open,
                AnimationPhase::Over => return None,
            };
            match open.next_frame().await? {
                Ok(frame) => Some((Ok(frame), AnimationPhase::Open(open))),
                Err(status) => Some((Err(status), AnimationPhase::Over)),
            }
        },
    )
}

enum AnimationPhase {
    Waiting(Box<(State, (Manager, Tenant), Streaming<pb::AnimateRequest>)>),
    Open(Box<OpenAnimation>),
    Over,
}

struct OpenAnimation {
    state: State,
    frames: AnimationFrames,
    /// Feeds acknowledgements in; ends with the stream.
    _pump: AbortOnDropHandle<()>,
    /// How the client's side ended: half-closed, or broken.
    ended: oneshot::Receiver<Result<(), Status>>,
    half_closed: bool,
}

impl OpenAnimation {
    async fn start(
        state: State,
        (manager, tenant): &(Manager, Tenant),
        mut inbound: Streaming<pb::AnimateRequest>,
    ) -> Result<Self, Status> {
        let first = next_message(&state, &mut inbound, state.config.header_timeout).await?;
        let Some(Message::Options(mut options)) = first else {
            let problem = "are missing; the first message of an animation says what to do, and names the session";
            return Err(status(Error::invalid("options", problem)));
        };
        let id = std::mem::take(&mut options.session_id);
        state.manager.get(tenant, &id).await.map_err(status)?;
        let config = state.manager.config();
        let order = animate_order(&options, config.window, config.clip_bytes).map_err(|e| status(e.into()))?;
        let order = with_announced_clip((&state, tenant), order, &mut inbound).await?;
        let (input, output) = manager.animate(tenant, &id, order).await.map_err(status)?;
        let (tell, ended) = oneshot::channel();
        let pump = tokio::spawn(async move {
            let _ = tell.send(pump_acknowledgements(inbound, &input).await);
        });
        Ok(Self {
            state,
            frames: AnimationFrames::of_output(output),
            _pump: AbortOnDropHandle::new(pump),
            ended,
            half_closed: false,
        })
    }

    async fn next_frame(&mut self) -> Option<Result<pb::Frame, Status>> {
        loop {
            tokio::select! {
                biased;
                ended = &mut self.ended, if !self.half_closed => match ended {
                    Ok(Err(broken)) => return Some(Err(broken)),
                    Ok(Ok(())) | Err(_) => self.half_closed = true,
                },
                frame = self.frames.next_message() => return frame.map(|frame| frame.map_err(status)),
                () = self.state.closing.cancelled() => return Some(Err(status(Error::draining()))),
            }
        }
    }
}

/// The next message that asks for something; `None` when the client has half-closed.
async fn next_message(
    state: &State,
    inbound: &mut Streaming<pb::AnimateRequest>,
    patience: std::time::Duration,
) -> Result<Option<Message>, Status> {
    let next = tokio::select! {
        next = tokio::time::timeout(patience, inbound_message(inbound)) => next,
        () = state.draining.cancelled() => return Err(status(Error::draining())),
    };
    let next = next.map_err(|_| {
        let text = format!("no message came within {}", humantime::format_duration(patience));
        status(Error::new(ErrorCode::DeadlineExceeded, text))
    })??;
    Ok(next.and_then(|request| request.message))
}

/// Receives the clip whose size the options have announced.
async fn with_announced_clip(
    (state, tenant): (&State, &Tenant),
    mut order: AnimateOrder,
    inbound: &mut Streaming<pb::AnimateRequest>,
) -> Result<AnimateOrder, Status> {
    let Some(size) = order.bvh_size.take() else {
        return Ok(order);
    };
    let refuse = |problem: String| status(Error::invalid("chunk", problem));
    let patience = state.config.keepalive_interval + state.config.keepalive_timeout;
    let mut held = state.hold_upload(tenant, Some(size)).map_err(status)?;
    let mut clip = Vec::new();
    while (clip.len() as u64) < size {
        let Some(Message::Chunk(chunk)) = next_message(state, inbound, patience).await? else {
            let seen = clip.len();
            return Err(refuse(format!(
                "is missing; {seen} of the {size} bytes of bvhSize have come"
            )));
        };
        held.grow(chunk.len()).map_err(status)?;
        clip.extend_from_slice(&chunk);
    }
    if clip.len() as u64 > size {
        let seen = clip.len();
        return Err(refuse(format!("{seen} bytes have come, bvhSize says {size}")));
    }
    if let ClipSource::Bvh { bytes, .. } = &mut order.request.clip {
        *bytes = Bytes::from(clip);
    }
    Ok(order)
}

async fn pump_acknowledgements(
    mut inbound: Streaming<pb::AnimateRequest>,
    input: &AnimationControl,
) -> Result<(), Status> {
    while let Some(request) = inbound_message(&mut inbound).await? {
        match request.message {
            Some(Message::Ack(ack)) => input.acknowledge(ack.seq),
            Some(Message::Cancel(_)) => input.cancel_animation(),
            None => {}
            Some(Message::Options(_) | Message::Chunk(_)) => {
                let problem = "comes when the animation has begun; allowed are ack and cancel";
                return Err(status(Error::invalid("message", problem)));
            }
        }
    }
    input.finish_input();
    Ok(())
}
