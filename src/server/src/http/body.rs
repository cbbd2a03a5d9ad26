//! Request bodies: JSON of a bounded size, and the rest of bodies that are not read.
//!
//! A server that ends its answer over HTTP/2 while the client is still sending resets the stream (RFC 9113, 8.1), and some
//! clients, curl 7 among them, drop the answer at the reset. So the end of a rejection waits a moment, while the server reads and
//! drops what the client sends; most bodies end in it.

use super::problem::Problem;
use crate::auth;
use crate::state::ServerState;
use axum::body::{Body, BodyDataStream};
use axum::extract::Request;
use bytes::{Bytes, BytesMut};
use futures::StreamExt as _;
use futures::future::BoxFuture;
use http::{HeaderMap, StatusCode, header};
use http_body::{Body as HttpBody, Frame, SizeHint};
use pliant_session::{Error, ErrorCode};
use prost::Message;
use std::pin::Pin;
use std::sync::{Arc, LazyLock};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::{Semaphore, oneshot};

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
pub(super) async fn next(state: &ServerState, stream: &mut BodyDataStream) -> Result<Option<Bytes>, Problem> {
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

/// How long a peer may be silent.
fn patience(state: &ServerState) -> Duration {
    state.config.keepalive_interval + state.config.keepalive_timeout
}

fn stalled(state: &ServerState) -> Problem {
    let text = format!(
        "the body did not come within {}",
        humantime::format_duration(patience(state))
    );
    Problem::new(StatusCode::REQUEST_TIMEOUT, "DEADLINE_EXCEEDED", text)
}

/// The JSON text of a request, at most `message_bytes` long. An absent body is empty.
pub(super) async fn text(state: &ServerState, request: Request) -> Result<Bytes, Problem> {
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
    // Many bodies at a time use as much memory as an upload.
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
    // A message is small, so it must come at once.
    match tokio::time::timeout(patience(state), read).await {
        Ok(read) => read,
        Err(_) => Err(stalled(state)),
    }
}

/// A message from the JSON body of a request; an absent body is the message with all defaults.
pub(super) async fn message<M: Message + Default + prost::Name>(
    state: &ServerState,
    request: Request,
) -> Result<M, Problem> {
    let text = text(state, request).await?;
    if text.is_empty() {
        Ok(M::default())
    } else {
        Ok(pliant_wire::json::from_json(&text)?)
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

/// How long the rest of an unread HTTP/1 body is read.
const LINGER: Duration = Duration::from_secs(5);

/// When the HTTP/1 body is dropped before its end, the server reads and drops the rest for a while, so that a
/// client that is still sending receives the answer instead of a broken connection.
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

/// How much of an unread body is read at most,
const MOST: usize = 1 << 20;
/// for how long,
const LONGEST: Duration = Duration::from_secs(1);
/// and how long it may pause: a client that has seen the answer sends nothing more.
const PAUSE: Duration = Duration::from_millis(250);
/// Answers of the whole program whose end waits at a time. What is refused beyond these ends at once.
static WAITING: LazyLock<Arc<Semaphore>> = LazyLock::new(|| Arc::new(Semaphore::new(256)));

/// The unread rest of a request's body.
pub(super) struct UnreadBody(oneshot::Receiver<Body>);

impl UnreadBody {
    /// Wraps the body of a request. The second value receives what is left when it is dropped.
    pub fn of(body: Body) -> (Body, Self) {
        let (leave, rest) = oneshot::channel();
        let body = leave_rest(body, move |rest| {
            let _ = leave.send(rest);
        });
        (body, Self(rest))
    }

    /// Has the end of `answer` wait until the client has sent a little of what is left, if anything is.
    pub fn delay_end(self, answer: Body) -> Body {
        self.delay_end_within(answer, LONGEST, PAUSE)
    }

    fn delay_end_within(mut self, answer: Body, longest: Duration, pause: Duration) -> Body {
        let Ok(rest) = self.0.try_recv() else { return answer };
        let Ok(permit) = Arc::clone(&WAITING).try_acquire_owned() else {
            return answer;
        };
        let reading = tokio::time::timeout(longest, async move {
            read_a_little(rest, pause).await;
            drop(permit);
        });
        Body::new(LateEnd {
            answer,
            reading: Some(Box::pin(async move {
                let _ = reading.await;
            })),
        })
    }
}

async fn read_a_little(rest: Body, pause: Duration) {
    let mut rest = rest.into_data_stream();
    let mut read = 0;
    while let Ok(Some(Ok(bytes))) = tokio::time::timeout(pause, rest.next()).await {
        read += bytes.len();
        if read >= MOST {
            // What is not read stops the client, which has the answer before it and takes it now.
            tokio::time::sleep(pause).await;
            break;
        }
    }
}

/// An answer whose end waits.
struct LateEnd {
    answer: Body,
    reading: Option<BoxFuture<'static, ()>>,
}

impl HttpBody for LateEnd {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        match Pin::new(&mut self.answer).poll_frame(cx) {
            Poll::Ready(None) => {}
            answer => return answer,
        }
        if let Some(reading) = &mut self.reading {
            std::task::ready!(reading.as_mut().poll(cx));
            self.reading = None;
        }
        Poll::Ready(None)
    }

    fn is_end_stream(&self) -> bool {
        self.reading.is_none() && self.answer.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.answer.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt as _;
    use http_body_util::BodyExt as _;
    use tokio::sync::mpsc;

    /// A body that comes as it is sent.
    fn sent() -> (mpsc::UnboundedSender<Bytes>, Body) {
        let (send, pieces) = mpsc::unbounded_channel();
        let pieces = futures::stream::unfold(pieces, |mut pieces| async move {
            let piece = pieces.recv().await?;
            Some((Ok::<_, std::io::Error>(piece), pieces))
        });
        (send, Body::from_stream(pieces))
    }

    #[tokio::test]
    async fn the_end_of_a_refusal_waits_for_that_of_the_body() {
        let (send, body) = sent();
        let (body, rest) = UnreadBody::of(body);
        drop(body);
        let hour = Duration::from_secs(3600);
        let mut answer = rest.delay_end_within(Body::from("no"), hour, hour);
        assert_eq!(answer.size_hint().exact(), Some(2));
        let said = answer.frame().await.expect("a frame").expect("data");
        assert_eq!(said.into_data().expect("data"), "no");
        for _ in 0..3 {
            assert!(!answer.is_end_stream());
            assert!(answer.frame().now_or_never().is_none(), "the client is still sending");
            send.send(Bytes::from_static(&[0; 1000])).expect("read on");
        }
        drop(send);
        assert!(answer.frame().await.is_none());
        assert!(answer.is_end_stream());
    }

    #[tokio::test]
    async fn a_refusal_ends_when_its_time_is_over_and_after_a_mebibyte() {
        let (moment, hour) = (Duration::from_millis(20), Duration::from_secs(3600));
        for (longest, pause) in [(moment, hour), (hour, moment)] {
            let (_silent, body) = sent();
            let (body, rest) = UnreadBody::of(body);
            drop(body);
            let answer = rest.delay_end_within(Body::from("no"), longest, pause).collect().await;
            assert_eq!(answer.expect("an answer").to_bytes(), "no");
        }
        let endless = futures::stream::repeat_with(|| Ok::<_, std::io::Error>(Bytes::from_static(&[0; 4096])));
        let (body, rest) = UnreadBody::of(Body::from_stream(endless));
        drop(body);
        let answer = rest.delay_end_within(Body::from("no"), hour, moment).collect().await;
        assert_eq!(answer.expect("an answer").to_bytes(), "no");
    }

    #[tokio::test]
    async fn a_body_that_was_read_delays_nothing() {
        let (body, rest) = UnreadBody::of(Body::from("all of it"));
        body.collect().await.expect("read");
        assert!(rest.delay_end(Body::empty()).is_end_stream());
    }
}
