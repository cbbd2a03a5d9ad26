//! The streams over gRPC: Deform, Animate, and the upload of CreateSession.
//!
//! In Deform and Animate two sides never wait for each other: a task gives what the client sends to the session, so that newer
//! poses replace older ones even while the client does not read; the response body pulls frames out, one part at a time, as
//! fast as HTTP/2 lets it. Dropping the body (the client left, or its deadline passed) drops both.

use super::codec::Call;
use super::codec::inbound_message;
use super::codec::status;
use crate::state::ServerState;
use crate::stream_messages::{AnimationFrames, RequestSender, ResponseReceiver, open_stream};
use crate::uploads::{HeldUpload, UploadPace};
use bytes::Bytes;
use futures::future::pending;
use futures::stream::{once, unfold};
use futures::{Stream, TryFutureExt as _, TryStreamExt as _};
use pliant_asset::FileSet;
use pliant_core::engine::ClipSource;
use pliant_session::{AnimationControl, Error, ErrorCode, Tenant};
use pliant_wire::frames::OutgoingResponse;
use pliant_wire::pb::create_session_request::Message as Part;
use pliant_wire::pb::{self, animate_request, deform_response};
use pliant_wire::{AnimateOrder, animate_order};
use prost::Message as _;
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::task::AbortOnDropHandle;
use tonic::{Status, Streaming};

/// What the client sends after a stream has begun, taken in by a task of its own.
struct ClientInput {
    task: AbortOnDropHandle<Result<(), Status>>,
    is_half_closed: bool,
}

impl ClientInput {
    fn take(input: impl Future<Output = Result<(), Status>> + Send + 'static) -> Self {
        Self {
            task: AbortOnDropHandle::new(tokio::spawn(input)),
            is_half_closed: false,
        }
    }

    /// Resolves when the client's side breaks; never, once it has half-closed.
    async fn broken(&mut self) -> Status {
        if !self.is_half_closed {
            if let Ok(Err(broken)) = (&mut self.task).await {
                return broken;
            }
            self.is_half_closed = true;
        }
        pending().await
    }

    /// The next `item`, unless the client's side breaks or the server closes before it.
    async fn or<T>(
        &mut self,
        state: &ServerState,
        item: impl Future<Output = Option<Result<T, Error>>>,
    ) -> Option<Result<T, Status>> {
        tokio::select! {
            biased;
            broken = self.broken() => Some(Err(broken)),
            item = item => item.map(|item| item.map_err(status)),
            () = state.closing.cancelled() => Some(Err(status(Error::draining()))),
        }
    }
}

/// The responses of a Deform stream. The session is opened when the first message has come.
pub(super) fn responses(
    state: ServerState,
    call: Call<Streaming<pb::DeformRequest>>,
) -> impl Stream<Item = Result<OutgoingResponse, Status>> + Send {
    let responses = OpenStream::start(state, call).map_ok(|open| {
        unfold(Some(Box::new(open)), |open| async {
            let mut open = open?;
            let next = open.next().await?;
            let rest = next.is_ok().then_some(open);
            Some((next, rest))
        })
    });
    once(responses).try_flatten()
}

struct OpenStream {
    state: ServerState,
    output: ResponseReceiver,
    input: ClientInput,
    /// Kept, because dropping it ends the stream as the client's end does: what broke the client's side comes first.
    _sender: Arc<RequestSender>,
    /// The failure with which the session ended the stream.
    failure: Option<Status>,
}

impl OpenStream {
    async fn start(state: ServerState, call: Call<Streaming<pb::DeformRequest>>) -> Result<Self, Status> {
        let mut inbound = call.message;
        let patience = state.config.header_timeout;
        let first = tokio::select! {
            first = tokio::time::timeout(patience, inbound_message(&mut inbound)) => first,
            () = state.draining.cancelled() => return Err(status(call.manager.leaving().await)),
        };
        let first = first
            .map_err(|_| {
                let text = format!(
                    "no message came within {}; the first one names the session",
                    humantime::format_duration(patience)
                );
                Error::new(ErrorCode::DeadlineExceeded, text)
            })
            .map_err(status)??;
        let Some(mut first) = first else {
            let problem = "is missing; the first message of a stream names the session";
            return Err(status(Error::invalid("sessionId", problem)));
        };
        let id = std::mem::take(&mut first.session_id);
        let (input, output) = open_stream(&call.manager, &call.tenant, &id).await.map_err(status)?;
        if first.message.is_some() {
            input.push(&first).map_err(status)?;
        }
        let sender = Arc::new(input);
        Ok(Self {
            state,
            output,
            input: ClientInput::take(take_poses(inbound, Arc::clone(&sender), id)),
            _sender: sender,
            failure: None,
        })
    }

    async fn next(&mut self) -> Option<Result<OutgoingResponse, Status>> {
        let response = async { self.output.next().await.map(Ok) };
        let response = self.input.or(&self.state, response).await;
        match &response {
            Some(Ok(response)) => self.failure = failure(response).or(self.failure.take()),
            Some(Err(_)) => {}
            None => return self.end().map(Err),
        }
        response
    }

    /// How the stream ends: with a failure already sent, with the server's shutdown, or normally.
    fn end(&mut self) -> Option<Status> {
        let is_leaving = self.state.draining.is_cancelled() && !self.input.is_half_closed;
        let leaving = || is_leaving.then(|| status(Error::draining()));
        self.failure.take().or_else(leaving)
    }
}

/// The status that ends the stream after `response`, when it says that the stream itself failed.
fn failure(response: &OutgoingResponse) -> Option<Status> {
    match response.message() {
        Some(deform_response::Message::Error(error)) if error.seq == 0 => {
            let code = tonic::Code::from_i32(i32::try_from(error.code).unwrap_or(13));
            Some(Status::new(code, error.message.clone()))
        }
        _ => None,
    }
}

async fn take_poses(
    mut inbound: Streaming<pb::DeformRequest>,
    input: Arc<RequestSender>,
    id: String,
) -> Result<(), Status> {
    while let Some(request) = inbound_message(&mut inbound).await? {
        if !request.session_id.is_empty() && request.session_id != id {
            let problem = "differs from the first message's; a stream belongs to one session";
            return Err(status(Error::invalid("sessionId", problem)));
        }
        match input.push(&request) {
            Ok(()) => {}
            // A stream that has ended reports the reason on its other side.
            Err(error) if error.code == ErrorCode::Cancelled => return Ok(()),
            Err(error) => return Err(status(error)),
        }
    }
    input.finish();
    Ok(())
}

/// The frames of an animation. Options and the bytes of a clip come in first, then acknowledgements.
pub(super) fn animation_frames(
    state: ServerState,
    call: Call<Streaming<pb::AnimateRequest>>,
) -> impl Stream<Item = Result<pb::Frame, Status>> + Send {
    let frames = OpenAnimation::start(state, call).map_ok(|open| {
        unfold(Some(Box::new(open)), |open| async {
            let mut open = open?;
            let OpenAnimation { state, frames, input } = &mut *open;
            let next = input.or(state, frames.next_message()).await?;
            let rest = next.is_ok().then_some(open);
            Some((next, rest))
        })
    });
    once(frames).try_flatten()
}

struct OpenAnimation {
    state: ServerState,
    frames: AnimationFrames,
    input: ClientInput,
}

impl OpenAnimation {
    async fn start(state: ServerState, call: Call<Streaming<pb::AnimateRequest>>) -> Result<Self, Status> {
        let (tenant, mut inbound) = (call.tenant, call.message);
        let first = next_message(&state, &mut inbound, state.config.header_timeout).await?;
        let Some(animate_request::Message::Options(mut options)) = first else {
            let problem = "are missing; the first message of an animation says what to do, and names the session";
            return Err(status(Error::invalid("options", problem)));
        };
        let id = std::mem::take(&mut options.session_id);
        state.manager.get(&tenant, &id).await.map_err(status)?;
        let config = state.manager.config();
        let order = animate_order(&options, config.window, config.clip_bytes).map_err(status)?;
        let order = with_announced_clip(&state, &tenant, order, &mut inbound).await?;
        let (input, output) = call.manager.animate(&tenant, &id, order).await.map_err(status)?;
        Ok(Self {
            state,
            frames: AnimationFrames::of_output(output),
            input: ClientInput::take(take_acknowledgements(inbound, input)),
        })
    }
}

/// The next message that asks for something; `None` when the client has half-closed.
async fn next_message(
    state: &ServerState,
    inbound: &mut Streaming<pb::AnimateRequest>,
    patience: Duration,
) -> Result<Option<animate_request::Message>, Status> {
    let next = tokio::select! {
        next = tokio::time::timeout(patience, inbound_message(inbound)) => next,
        () = state.draining.cancelled() => return Err(status(Error::draining())),
    };
    let next = next
        .map_err(|_| {
            let text = format!("no message came within {}", humantime::format_duration(patience));
            Error::new(ErrorCode::DeadlineExceeded, text)
        })
        .map_err(status)??;
    Ok(next.and_then(|request| request.message))
}

/// Receives the clip whose size the options have announced.
async fn with_announced_clip(
    state: &ServerState,
    tenant: &Tenant,
    mut order: AnimateOrder,
    inbound: &mut Streaming<pb::AnimateRequest>,
) -> Result<AnimateOrder, Status> {
    let Some(size) = order.bvh_size.take() else {
        return Ok(order);
    };
    let patience = state.config.keepalive_interval + state.config.keepalive_timeout;
    let mut held = state.hold_upload(tenant, Some(size)).map_err(status)?;
    let mut clip = Vec::new();
    while (clip.len() as u64) < size {
        let Some(animate_request::Message::Chunk(chunk)) = next_message(state, inbound, patience).await? else {
            let problem = format!("is missing; {} of the {size} bytes of bvhSize have come", clip.len());
            return Err(status(Error::invalid("chunk", problem)));
        };
        held.grow(chunk.len()).map_err(status)?;
        clip.extend_from_slice(&chunk);
    }
    if clip.len() as u64 > size {
        let problem = format!("{} bytes have come, bvhSize says {size}", clip.len());
        return Err(status(Error::invalid("chunk", problem)));
    }
    if let ClipSource::Bvh { bytes, .. } = &mut order.request.clip {
        *bytes = Bytes::from(clip);
    }
    Ok(order)
}

async fn take_acknowledgements(
    mut inbound: Streaming<pb::AnimateRequest>,
    input: AnimationControl,
) -> Result<(), Status> {
    while let Some(request) = inbound_message(&mut inbound).await? {
        match request.message {
            Some(animate_request::Message::Ack(ack)) => input.acknowledge(ack.seq),
            Some(animate_request::Message::Cancel(_)) => input.cancel_animation(),
            None => {}
            Some(animate_request::Message::Options(_) | animate_request::Message::Chunk(_)) => {
                let problem = "comes when the animation has begun; allowed are ack and cancel";
                return Err(status(Error::invalid("message", problem)));
            }
        }
    }
    input.finish_input();
    Ok(())
}

/// Companion files of one model.
const MAX_COMPANIONS: usize = 1000;

/// A received upload. The bytes count as under way until it is dropped.
pub(super) struct Upload {
    pub files: FileSet,
    pub options: pb::CreateOptions,
    pub held: HeldUpload,
}

/// Receives a CreateSession stream to its end: options, then the model's bytes, then companions. Rejects it as soon as it breaks a
/// rule or a limit.
///
/// # Cancel safety
/// Dropping it gives back what was received.
pub(super) async fn receive_upload(
    state: &ServerState,
    tenant: &Tenant,
    mut inbound: Streaming<pb::CreateSessionRequest>,
) -> Result<Upload, Status> {
    let mut parts = UploadParts {
        held: state.hold_upload(tenant, None).map_err(status)?,
        main: Vec::new(),
        options: None,
        companions: BTreeMap::new(),
        current: None,
        messages: 0,
    };
    let mut pace = UploadPace::new(&state.config);
    loop {
        let message = tokio::select! {
            message = tokio::time::timeout_at(pace.due(), inbound_message(&mut inbound)) => message,
            () = state.draining.cancelled() => return Err(status(Error::draining())),
        };
        match message {
            Ok(Ok(Some(request))) => {
                pace.take(request.encoded_len());
                parts.take(request).map_err(status)?;
            }
            Ok(Ok(None)) => return Ok(parts.finish()),
            Ok(Err(broken)) => return Err(broken),
            Err(_) => return Err(status(pace.late())),
        }
    }
}

struct UploadParts {
    held: HeldUpload,
    main: Vec<u8>,
    options: Option<pb::CreateOptions>,
    companions: BTreeMap<String, Vec<u8>>,
    current: Option<String>,
    messages: u64,
}

impl UploadParts {
    fn take(&mut self, request: pb::CreateSessionRequest) -> Result<(), Error> {
        let first = self.messages == 0;
        self.messages += 1;
        match request.message {
            Some(Part::Options(options)) if first => {
                self.options = Some(options);
                Ok(())
            }
            Some(Part::Options(_)) => Err(Error::invalid("options", "come as the first message only, and once")),
            Some(Part::Chunk(chunk)) => {
                self.held.grow(chunk.len())?;
                let file = match &self.current {
                    Some(uri) => self.companions.entry(uri.clone()).or_default(),
                    None => &mut self.main,
                };
                file.extend_from_slice(&chunk);
                Ok(())
            }
            Some(Part::Companion(companion)) => {
                if companion.uri.is_empty() {
                    return Err(Error::invalid(
                        "companion.uri",
                        "is empty; give the URI by which the model names the file",
                    ));
                }
                if self.companions.len() >= MAX_COMPANIONS {
                    return Err(Error::invalid(
                        "companion",
                        format!("more than {MAX_COMPANIONS} companion files"),
                    ));
                }
                self.held.grow(companion.uri.len())?;
                if self.companions.insert(companion.uri.clone(), Vec::new()).is_some() {
                    let shown: String = companion.uri.chars().take(100).collect();
                    return Err(Error::invalid(
                        "companion.uri",
                        format!("\"{shown}\" came before; every file comes once"),
                    ));
                }
                self.current = Some(companion.uri);
                Ok(())
            }
            None => Err(Error::invalid(
                "message",
                "is empty; allowed are options, chunk and companion",
            )),
        }
    }

    fn finish(self) -> Upload {
        let companions = self
            .companions
            .into_iter()
            .map(|(uri, bytes)| (uri, Bytes::from(bytes)))
            .collect();
        let files = FileSet {
            name: "upload".into(),
            main: Bytes::from(self.main),
            companions,
        };
        Upload {
            files,
            options: self.options.unwrap_or_default(),
            held: self.held,
        }
    }
}
