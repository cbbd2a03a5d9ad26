//! Request bodies: JSON of a bounded size, and the rest of bodies that are not read.

use super::problem::Problem;

use crate::server::auth;
use crate::server::state::State;
use crate::session::{Error, ErrorCode};
use crate::wire;
use axum::body::{Body, BodyDataStream};
use axum::extract::Request;
use bytes::{Bytes, BytesMut};
use futures::StreamExt as _;
use http::{HeaderMap, StatusCode, header};
use http_body::{Body as HttpBody, Frame, SizeHint};
use prost::Message;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

/// The essence of the content type, in lower case and without parameters; empty when there is none.
pub(super) fn content_type(headers: &HeaderMap) -> String {
    let text = headers
        .get(header::CONTENT_TYPE)
        .and_then(|v| v.to_str().ok())
        .unwrap_or_default();
    text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// The announced length of the body.
pub(super) fn announced(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// The next bytes of a body; refuses one that stands still.
pub(super) async fn next(state: &State, stream: &mut BodyDataStream) -> Result<Option<Bytes>, Problem> {
    let next = tokio::select! {
        next = tokio::time::timeout(patience(state), stream.next()) => next,
        () = state.closing.cancelled() => return Err(Error::draining().into()),
    };
    match next {
        Ok(None) => Ok(None),
        Ok(Some(Ok(bytes))) => Ok(Some(bytes)),
        Ok(Some(Err(_))) => Err(Error::malformed("the body broke off").into()),
        Err(_) => Err(stalled(state)),
    }
}

/// How long a peer may take for a sign of life.
fn patience(state: &State) -> Duration {
    state.config.keepalive_interval + state.config.keepalive_timeout
}

fn stalled(state: &State) -> Problem {
    let text = format!(
        "the body did not come within {}",
        humantime::format_duration(patience(state))
    );
    Problem::new(StatusCode::REQUEST_TIMEOUT, "DEADLINE_EXCEEDED", text)
}

/// The JSON text of a request, at most `message_bytes` long. An absent body is empty.
pub(super) async fn text(state: &State, request: Request) -> Result<Bytes, Problem> {
    let kind = content_type(request.headers());
    let length = announced(request.headers());
    let empty = length == Some(0) || request.body().is_end_stream();
    if !empty && kind != "application/json" && !(kind.starts_with("application/") && kind.ends_with("+json")) {
        return Err(Problem::media_type(&kind, "application/json"));
    }
    let limit = state.message_bytes;
    let too_large = |seen: u64| {
        Problem::from(Error::new(
            ErrorCode::TooLarge,
            format!("the body has {seen} bytes or more, at most {limit} are allowed"),
        ))
    };
    if let Some(length) = length.filter(|&length| length > limit as u64) {
        return Err(too_large(length));
    }
    // Many bodies at a time are as heavy as an upload.
    let account = match auth::principal(request.extensions()) {
        Ok(principal) => Some(state.manager.account(&principal.tenant)?),
        Err(_) => None,
    };
    let mut held = state.uploads.hold(account.as_ref());
    let mut stream = request.into_body().into_data_stream();
    let read = async {
        let mut text = BytesMut::new();
        while let Some(bytes) = next(state, &mut stream).await? {
            if bytes.len() > limit - text.len() {
                return Err(too_large((text.len() + bytes.len()) as u64));
            }
            held.grow(bytes.len())?;
            text.extend_from_slice(&bytes);
        }
        Ok(text.freeze())
    };
    // A message is small: one that trickles in is no honest one.
    match tokio::time::timeout(patience(state), read).await {
        Ok(read) => read,
        Err(_) => Err(stalled(state)),
    }
}

/// A message from the JSON body of a request; an absent body is the message with all defaults.
pub(super) async fn message<M: Message + Default + prost::Name>(state: &State, request: Request) -> Result<M, Problem> {
    let text = text(state, request).await?;
    if text.is_empty() {
        Ok(M::default())
    } else {
        Ok(wire::json::from_json(&text)?)
    }
}

/// Refuses a session id in a body that differs from the path's.
pub(super) fn same_session(in_body: &str, in_path: &str) -> Result<(), Problem> {
    if in_body.is_empty() || in_body == in_path {
        return Ok(());
    }
    Err(Error::invalid(
        "sessionId",
        "differs from the session in the path; leave it out or repeat it",
    )
    .into())
}

/// How long, and at what most, an unwanted body is read on.
const LINGER: Duration = Duration::from_secs(5);

/// Makes an HTTP/1 body polite: when it is dropped before its end, the rest is read and forgotten for a while, so that a
/// client that is still sending gets to see the answer instead of a broken connection.
pub(super) fn linger(body: Body) -> Body {
    leave_rest(body, |rest| {
        let Ok(runtime) = tokio::runtime::Handle::try_current() else {
            return;
        };
        runtime.spawn(tokio::time::timeout(LINGER, async move {
            let mut stream = rest.into_data_stream();
            while let Some(Ok(_)) = stream.next().await {}
        }));
    })
}

/// A body that gives `take` what is left of it when it is dropped before its end.
pub(super) fn leave_rest(body: Body, take: impl FnOnce(Body) + Send + 'static) -> Body {
    if body.is_end_stream() {
        body
    } else {
        let (inner, take) = (Some(body), Some(Box::new(take) as TakeRest));
        Body::new(LeavingRest { inner, take })
    }
}

type TakeRest = Box<dyn FnOnce(Body) + Send>;

struct LeavingRest {
    inner: Option<Body>,
    take: Option<TakeRest>,
}

impl HttpBody for LeavingRest {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let Some(inner) = &mut self.inner else {
            return Poll::Ready(None);
        };
        let frame = Pin::new(inner).poll_frame(cx);
        if let Poll::Ready(None | Some(Err(_))) = frame {
            self.inner = None;
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.inner.as_ref().is_none_or(HttpBody::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        self.inner
            .as_ref()
            .map_or_else(|| SizeHint::with_exact(0), HttpBody::size_hint)
    }
}

impl Drop for LeavingRest {
    fn drop(&mut self) {
        let rest = self.inner.take().filter(|body| !body.is_end_stream());
        if let (Some(rest), Some(take)) = (rest, self.take.take()) {
            take(rest);
        }
    }
}
