//! The Deform stream over a WebSocket: one binary message is one DeformRequest or DeformResponse.
//!
//! Close codes: 1000 all said, 1001 the server is going away, 1003 a text message, 1007 bytes that are no DeformRequest,
//! 1009 a message above the limit, 1011 a defect, 4000 + the gRPC status for a failure of the stream.
//!
//! A response is pulled from the session only when the one before has been written to the connection, so a reader that
//! stops costs one frame of memory. Requests are read all the while, so newer poses replace older ones.

use super::connection::{ConnectionSlot, SocketFlags};
use super::http::Caller;
use super::http::problem::Problem;
use super::state::ServerState;
use super::stream_messages::{RequestSender, ResponseReceiver, failure_message, open_stream};
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts as _, Path, Request, State};
use futures::stream::{SplitSink, SplitStream};
use futures::{SinkExt as _, StreamExt as _};
use http::{StatusCode, header};
use pliant_session::{Error, ErrorCode};
use pliant_wire::pb;
use pliant_wire::pb::deform_response::Message as Response;
use prost::Message as _;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::Instant;

/// The sub-protocol that a client may name.
const PROTOCOL: &str = "pliant.v1";

/// What a written message may wait behind: one part of a frame and its framing.
const WRITE_BUFFER: usize = 128 << 10;
const MAX_WRITE_BUFFER: usize = 4 << 20;

/// How long the closing handshake may take.
const CLOSING_TIME: Duration = Duration::from_secs(1);

/// Opens the session's stream and upgrades. A refusal is an ordinary HTTP answer.
pub(super) async fn upgrade(
    State(state): State<ServerState>,
    caller: Caller,
    request: Request,
) -> Result<axum::response::Response, Problem> {
    let (mut parts, _) = request.into_parts();
    let Ok(Path(id)) = Path::<String>::from_request_parts(&mut parts, &state).await else {
        return Err(Error::no_session("").into());
    };
    state.manager.get(&caller.tenant, &id).await?;
    let upgrade = WebSocketUpgrade::from_request_parts(&mut parts, &state)
        .await
        .map_err(no_upgrade)?;
    let (input, output) = open_stream(&caller.manager(&state), &caller.tenant, &id).await?;
    let largest = state.message_bytes;
    // The WebSocket holds the connection's slot until it ends.
    let slot: Option<ConnectionSlot> = parts.extensions.get().cloned();
    let flags: SocketFlags = parts.extensions.get().cloned().unwrap_or_default();
    let token = state.sockets.token();
    Ok(upgrade
        .protocols([PROTOCOL])
        .write_buffer_size(WRITE_BUFFER)
        .max_write_buffer_size(MAX_WRITE_BUFFER)
        .max_message_size(largest)
        .max_frame_size(largest)
        .on_upgrade(move |socket| async move {
            state.telemetry.sockets.inc();
            serve(&state, &id, socket, &flags, input, output).await;
            state.telemetry.sockets.dec();
            drop((slot, token));
        }))
}

fn no_upgrade(rejection: WebSocketUpgradeRejection) -> Problem {
    let detail = format!("this path is a WebSocket: {rejection}");
    Problem::new(StatusCode::UPGRADE_REQUIRED, "INVALID_ARGUMENT", detail)
        .with_header(header::UPGRADE, "websocket".into())
        .with_header(header::CONNECTION, "Upgrade".into())
}

/// How a socket ends.
struct SocketEnd {
    code: u16,
    reason: String,
    /// Sent to the client as an Error message before the close frame.
    error: Option<Error>,
}

impl SocketEnd {
    fn new(code: u16, reason: &str) -> Self {
        let (reason, error) = (reason.to_owned(), None);
        Self { code, reason, error }
    }

    fn going_away() -> Self {
        Self::new(1001, "the server is shutting down")
    }

    fn failed(error: Error) -> Self {
        let code = match error.code {
            ErrorCode::Internal => 1011,
            _ => 4000 + u16::try_from(error.grpc_code()).unwrap_or(0),
        };
        let (reason, error) = (error.message.clone(), Some(error));
        Self { code, reason, error }
    }
}

/// Serves a socket until one of its ends, or the server, closes it.
async fn serve(
    state: &ServerState,
    id: &str,
    socket: WebSocket,
    flags: &SocketFlags,
    input: RequestSender,
    mut output: ResponseReceiver,
) {
    let (mut sink, source) = socket.split();
    let seen = Arc::new(Notify::new());
    let ending = {
        let read = read(&input, source, id, &seen);
        let write = write(state, &mut sink, &mut output);
        tokio::pin!(read, write);
        tokio::select! {
            ending = &mut read => {
                // The client may still be sending, above all the rest of a message that is too large.
                if ending.is_some() {
                    flags.linger();
                }
                ending
            }
            ending = &mut write => ending,
            () = wait_for_silence(state, &seen) => Some(SocketEnd::new(1001, "no answer to a keep-alive ping")),
            () = state.closing.cancelled() => Some(SocketEnd::going_away()),
        }
    };
    // The solve under way stops here, not when the handshake below is done.
    drop((input, output));
    if let Some(ending) = ending {
        let _ = tokio::time::timeout(CLOSING_TIME, close(sink, ending)).await;
    }
}

/// Reads requests until the client closes (`None`) or breaks a rule.
async fn read(input: &RequestSender, mut source: SplitStream<WebSocket>, id: &str, seen: &Notify) -> Option<SocketEnd> {
    loop {
        let message = match source.next().await {
            None => return None,
            Some(Err(error)) => return broken(&error),
            Some(Ok(message)) => message,
        };
        seen.notify_one();
        let bytes = match message {
            Message::Binary(bytes) => bytes,
            Message::Text(_) => {
                return Some(SocketEnd::new(
                    1003,
                    "text message; a request is a binary DeformRequest",
                ));
            }
            Message::Ping(_) | Message::Pong(_) => continue,
            Message::Close(_) => return None,
        };
        let request = match pb::DeformRequest::decode(bytes) {
            Ok(request) => request,
            Err(error) => {
                let error = Error::malformed(format!("the message is not a DeformRequest: {error}"));
                return Some(SocketEnd {
                    code: 1007,
                    ..SocketEnd::failed(error)
                });
            }
        };
        if !request.session_id.is_empty() && request.session_id != id {
            return Some(SocketEnd::failed(Error::invalid(
                "sessionId",
                "differs from the session in the path",
            )));
        }
        if let Err(error) = input.push(&request) {
            if error.code == ErrorCode::Cancelled {
                // The stream has ended; its other side says why.
                std::future::pending::<()>().await;
            }
            return Some(SocketEnd::failed(error));
        }
    }
}

/// A message above the limit and a violation of the protocol have a close code (RFC 6455, 7.4.1); other errors mean
/// that the client is gone.
fn broken(error: &axum::Error) -> Option<SocketEnd> {
    let text = error.to_string();
    let rule = text.strip_prefix("WebSocket protocol error: ");
    match rule {
        _ if text.contains("Space limit exceeded") => {
            Some(SocketEnd::new(1009, "the message is larger than Limits.messageBytes"))
        }
        _ if text.starts_with("UTF-8 encoding error") => Some(SocketEnd::new(1007, "a text that is not UTF-8")),
        Some(rule) if !rule.contains("without closing handshake") => Some(SocketEnd::new(1002, rule)),
        _ => None,
    }
}

/// Writes responses as the connection takes them.
async fn write(
    state: &ServerState,
    sink: &mut SplitSink<WebSocket, Message>,
    output: &mut ResponseReceiver,
) -> Option<SocketEnd> {
    let mut pings = tokio::time::interval_at(
        Instant::now() + state.config.keepalive_interval,
        state.config.keepalive_interval,
    );
    pings.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut failure = None;
    loop {
        let response = tokio::select! {
            response = output.next() => response,
            _ = pings.tick() => {
                if sink.send(Message::Ping(bytes::Bytes::new())).await.is_err() {
                    return None;
                }
                continue;
            }
        };
        let Some(response) = response else {
            return Some(match failure {
                Some(ending) => ending,
                None if state.draining.is_cancelled() => SocketEnd::going_away(),
                None => SocketEnd::new(1000, ""),
            });
        };
        if let Some(Response::Error(error)) = response.message()
            && error.seq == 0
        {
            let code = if error.code == 13 {
                1011
            } else {
                4000 + u16::try_from(error.code).unwrap_or(0).min(99)
            };
            failure = Some(SocketEnd::new(code, &error.message));
        }
        if sink
            .send(Message::Binary(response.encode_to_vec().into()))
            .await
            .is_err()
        {
            return None;
        }
    }
}

/// Ends when the client has sent nothing, not even the answer to a ping, for too long.
async fn wait_for_silence(state: &ServerState, seen: &Notify) {
    let patience = state.config.keepalive_interval + state.config.keepalive_timeout;
    while tokio::time::timeout(patience, seen.notified()).await.is_ok() {}
}

/// Sends the reason, and closes.
async fn close(mut sink: SplitSink<WebSocket, Message>, ending: SocketEnd) {
    if let Some(error) = &ending.error {
        let response = pb::DeformResponse {
            message: Some(Response::Error(failure_message(error, 0))),
        };
        let _ = sink.send(Message::Binary(response.encode_to_vec().into())).await;
    }
    // A close frame holds at most 123 bytes of text.
    let mut reason = String::new();
    for c in ending.reason.chars() {
        if reason.len() + c.len_utf8() > 123 {
            break;
        }
        reason.push(c);
    }
    let _ = sink
        .send(Message::Close(Some(CloseFrame {
            code: ending.code,
            reason: reason.into(),
        })))
        .await;
    let _ = sink.close().await;
}
