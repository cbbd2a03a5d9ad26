//! The Deform stream over gRPC.
//!
//! Two sides that never wait for each other: a task feeds what the client sends into the session's input, so that newer
//! poses replace older ones even while the client does not read; the response body pulls frames out, one at a time, as
//! fast as HTTP/2 lets it. Dropping the body (the client left, or its deadline passed) drops both.

use super::status::{inbound_message, status};
use crate::server::state::State;
use crate::server::stream_ends::{RequestEnd, ResponseEnd, message_ends};
use crate::session::{Error, ErrorCode, Manager, Tenant};
use crate::wire::frames::OutgoingResponse;
use crate::wire::pb::{self, deform_response};
use futures::Stream;
use tokio::sync::oneshot;
use tokio_util::task::AbortOnDropHandle;
use tonic::{Status, Streaming};

/// The responses to `inbound`. The session is opened when its first message has come.
pub(super) fn responses(
    state: State,
    caller: (Manager, Tenant),
    inbound: Streaming<pb::DeformRequest>,
) -> impl Stream<Item = Result<OutgoingResponse, Status>> + Send {
    futures::stream::unfold(Phase::Waiting(Box::new((state, caller, inbound))), |phase| async move {
        let mut open = match phase {
            Phase::Waiting(parts) => {
                let (state, caller, inbound) = *parts;
                match Open::start(state, &caller, inbound).await {
                    Ok(open) => Box::new(open),
                    Err(status) => return Some((Err(status), Phase::Over)),
                }
            }
            Phase::Open(open) => open,
            Phase::Over => return None,
        };
        match open.next().await {
            Some(Ok(response)) => Some((Ok(response), Phase::Open(open))),
            Some(Err(status)) => Some((Err(status), Phase::Over)),
            None => None,
        }
    })
}

enum Phase {
    Waiting(Box<(State, (Manager, Tenant), Streaming<pb::DeformRequest>)>),
    Open(Box<Open>),
    Over,
}

struct Open {
    state: State,
    output: ResponseEnd,
    /// Feeds the input; ends with the stream.
    _pump: AbortOnDropHandle<()>,
    /// How the client's side ended: half-closed, or broken.
    ended: oneshot::Receiver<Result<(), Status>>,
    half_closed: bool,
    /// The failure with which the session ended the stream.
    failure: Option<Status>,
}

impl Open {
    async fn start(
        state: State,
        (manager, tenant): &(Manager, Tenant),
        mut inbound: Streaming<pb::DeformRequest>,
    ) -> Result<Self, Status> {
        let patience = state.config.header_timeout;
        let first = tokio::select! {
            first = tokio::time::timeout(patience, inbound_message(&mut inbound)) => first,
            () = state.draining.cancelled() => return Err(status(manager.leaving().await)),
        };
        let first = first.map_err(|_| {
            let text = format!(
                "no message came within {}; the first one names the session",
                humantime::format_duration(patience)
            );
            status(Error::new(ErrorCode::DeadlineExceeded, text))
        })??;
        let Some(mut first) = first else {
            return Err(status(Error::invalid(
                "sessionId",
                "is missing; the first message of a stream names the session",
            )));
        };
        let id = std::mem::take(&mut first.session_id);
        let stream = manager.stream(tenant, &id).await.map_err(status)?;
        let (input, output) = message_ends(stream, state.manager.config().stream_limits());
        if first.message.is_some() {
            input.push(&first).map_err(status)?;
        }
        let (tell, ended) = oneshot::channel();
        let pump = tokio::spawn(async move {
            let _ = tell.send(pump(inbound, &input, &id).await);
        });
        Ok(Self {
            state,
            output,
            _pump: AbortOnDropHandle::new(pump),
            ended,
            half_closed: false,
            failure: None,
        })
    }

    async fn next(&mut self) -> Option<Result<OutgoingResponse, Status>> {
        loop {
            tokio::select! {
                biased;
                ended = &mut self.ended, if !self.half_closed => match ended {
                    Ok(Err(broken)) => return Some(Err(broken)),
                    Ok(Ok(())) | Err(_) => self.half_closed = true,
                },
                response = self.output.next() => return match response {
                    Some(response) => {
                        self.failure = failure(&response).or(self.failure.take());
                        Some(Ok(response))
                    }
                    None => self.end(),
                },
                () = self.state.closing.cancelled() => return Some(Err(status(Error::draining()))),
            }
        }
    }

    /// How the stream ends: with a failure already sent, with the server's shutdown, or normally.
    fn end(&mut self) -> Option<Result<OutgoingResponse, Status>> {
        if let Some(failure) = self.failure.take() {
            return Some(Err(failure));
        }
        let leaving = self.state.draining.is_cancelled() && !self.half_closed;
        leaving.then(|| Err(status(Error::draining())))
    }
}

/// The status that ends the stream after `response`, when it says that the stream itself failed.
fn failure(response: &OutgoingResponse) -> Option<Status> {
    let OutgoingResponse::Words(words) = response else {
        return None;
    };
    match &words.message {
        Some(deform_response::Message::Error(error)) if error.seq == 0 => {
            let code = tonic::Code::from_i32(i32::try_from(error.code).unwrap_or(13));
            Some(Status::new(code, error.message.clone()))
        }
        _ => None,
    }
}

async fn pump(mut inbound: Streaming<pb::DeformRequest>, input: &RequestEnd, id: &str) -> Result<(), Status> {
    while let Some(request) = inbound_message(&mut inbound).await? {
        if !request.session_id.is_empty() && request.session_id != id {
            return Err(status(Error::invalid(
                "sessionId",
                "differs from the first message's; a stream belongs to one session",
            )));
        }
        if let Err(error) = input.push(&request) {
            // A stream that has ended says why on its other side.
            return if error.code == ErrorCode::Cancelled {
                Ok(())
            } else {
                Err(status(error))
            };
        }
    }
    input.finish();
    Ok(())
}
