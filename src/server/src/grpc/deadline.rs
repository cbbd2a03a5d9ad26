//! Deadlines of callers (`grpc-timeout`), kept for the whole answer and not only until it begins, and the count of calls.
//!
//! Dropping the handler or the body at the deadline is what stops the work: every call of pliant-session gives up
//! when its future is dropped.

use super::codec::status;
use crate::request_filter::Rejected;
use crate::telemetry::{self, Recorder, Telemetry};
use axum::body::Body;
use bytes::Bytes;
use futures::FutureExt as _;
use futures::future::{Either, ready};
use http::{HeaderMap, HeaderValue, Request, Response};
use http_body::{Body as HttpBody, Frame, SizeHint};
use pliant_session::{Error, ErrorCode};
use std::collections::BTreeSet;
use std::convert::Infallible;
use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::{Instant, Sleep};
use tonic::service::Routes;
use tracing::Instrument as _;

/// The routes, each call measured and ended at its deadline.
#[derive(Clone)]
pub(super) struct Timed {
    routes: Routes,
    telemetry: Telemetry,
    known: Arc<BTreeSet<String>>,
}

impl Timed {
    /// `known` are the methods that calls are counted under, as `package.Service/Method`.
    pub fn new(routes: Routes, telemetry: Telemetry, known: BTreeSet<String>) -> Self {
        Self {
            routes,
            telemetry,
            known: Arc::new(known),
        }
    }
}

impl tower::Service<Request<tonic::body::Body>> for Timed {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, mut request: Request<tonic::body::Body>) -> Self::Future {
        let method = request.uri().path().trim_start_matches('/');
        let route = match self.known.get(method) {
            Some(known) => known.as_str(),
            None if method.starts_with("grpc.") => method.split('/').next().unwrap_or_default(),
            None => "unknown",
        };
        // The services below refuse unknown names of `grpc.` as well; only the ones that exist get a label.
        let route = if method.starts_with("grpc.") && !COMMON.contains(&route) {
            "unknown"
        } else {
            route
        };
        let request_id = request
            .headers()
            .get("x-request-id")
            .and_then(|v| v.to_str().ok())
            .map_or_else(telemetry::request_id, Arc::from);
        let echoed = HeaderValue::from_str(&request_id);
        let mut recorder = Recorder::start(&self.telemetry, "grpc", route, request_id, &request);
        let deadline = timeout(request.headers()).map(|timeout| Instant::now() + timeout);
        let rejected: Option<Rejected> = request.extensions_mut().remove();
        let routed = match rejected {
            Some(Rejected(error)) => Either::Left(ready(Ok(status(error).into_http()))),
            None => Either::Right(tower::Service::call(&mut self.routes, request)),
        };
        Box::pin(async move {
            let answer = AssertUnwindSafe(routed).catch_unwind().instrument(recorder.span());
            let answered = match deadline {
                None => Ok(answer.await),
                Some(at) => tokio::time::timeout_at(at, answer).await,
            };
            let mut response = match answered {
                Ok(Ok(Ok(response))) => response,
                Ok(Ok(Err(never))) => match never {},
                Ok(Err(_panic)) => {
                    tracing::error!("internal: a gRPC call panicked");
                    broken().into_http()
                }
                Err(_elapsed) => late().into_http(),
            };
            correct_frame_status(response.headers_mut());
            if let Ok(id) = echoed {
                response.headers_mut().insert("x-request-id", id);
            }
            if let Some(code) = telemetry::grpc_code(response.headers()) {
                recorder.set_code(code);
            }
            Ok(response.map(|body| {
                let body = match deadline {
                    None => Body::new(body),
                    Some(at) => Body::new(DeadlineBody {
                        inner: Some(body),
                        sleep: Box::pin(tokio::time::sleep_until(at)),
                    }),
                };
                recorder.observe(body)
            }))
        })
    }
}

const COMMON: [&str; 3] = [
    "grpc.health.v1.Health",
    "grpc.reflection.v1.ServerReflection",
    "grpc.reflection.v1alpha.ServerReflection",
];

/// Reports bytes that are no frames of gRPC as a fault of the caller, and a message that is too large as the exhaustion of a
/// limit: the library calls them INTERNAL and OUT_OF_RANGE.
fn correct_frame_status(headers: &mut HeaderMap) {
    const FAULTS: [&str; 3] = [
        "Missing%20request%20message",
        "Unexpected%20EOF%20decoding%20stream",
        "protocol%20error:%20received%20message",
    ];
    const TOO_LARGE: &str = "Error,%20decoded%20message%20length%20too%20large";
    let is_out_of_range = headers.get("grpc-status").is_some_and(|status| status == "11");
    let is_internal = headers.get("grpc-status").is_some_and(|status| status == "13");
    let message = headers.get("grpc-message").and_then(|message| message.to_str().ok());
    if is_internal && message.is_some_and(|message| FAULTS.iter().any(|fault| message.starts_with(fault))) {
        headers.insert("grpc-status", HeaderValue::from_static("3"));
    } else if is_out_of_range && message.is_some_and(|message| message.starts_with(TOO_LARGE)) {
        headers.insert("grpc-status", HeaderValue::from_static("8"));
    }
}

fn late() -> tonic::Status {
    status(Error::new(
        ErrorCode::DeadlineExceeded,
        "the caller's deadline has passed",
    ))
}

fn broken() -> tonic::Status {
    status(Error::new(
        ErrorCode::Internal,
        "a defect of the server; its log says more",
    ))
}

/// Reads `grpc-timeout`: up to 8 digits and a unit; ignores anything else.
fn timeout(headers: &HeaderMap) -> Option<Duration> {
    let text = headers.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    if digits.is_empty() || digits.len() > 8 || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let count: u64 = digits.parse().ok()?;
    let timeout = match unit {
        "H" => Duration::from_secs(count * 3600),
        "M" => Duration::from_secs(count * 60),
        "S" => Duration::from_secs(count),
        "m" => Duration::from_millis(count),
        "u" => Duration::from_micros(count),
        "n" => Duration::from_nanos(count),
        _ => return None,
    };
    // A deadline beyond a month is treated as none.
    (timeout < Duration::from_secs(30 * 24 * 3600)).then_some(timeout)
}

/// A body that ends with DEADLINE_EXCEEDED when its time is over. By hand, because the timeouts of tower-http end a body with an error and not
/// with the trailers of gRPC.
struct DeadlineBody {
    inner: Option<tonic::body::Body>,
    sleep: Pin<Box<Sleep>>,
}

impl HttpBody for DeadlineBody {
    type Data = Bytes;
    type Error = tonic::Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, tonic::Status>>> {
        // The clock comes first: a body that always has something ready must end in time as well.
        let over = self.sleep.as_mut().poll(cx).is_ready();
        let Some(inner) = &mut self.inner else {
            return Poll::Ready(None);
        };
        if !over {
            return Pin::new(inner).poll_frame(cx);
        }
        self.inner = None;
        let mut trailers = HeaderMap::new();
        // A status made here has no metadata that could be refused as a header.
        let _ = late().add_header(&mut trailers);
        Poll::Ready(Some(Ok(Frame::trailers(trailers))))
    }

    fn is_end_stream(&self) -> bool {
        self.inner.as_ref().is_none_or(HttpBody::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timeouts_are_read_as_the_protocol_says() {
        let read = |text: &str| {
            timeout(&HeaderMap::from_iter([(
                "grpc-timeout".parse().unwrap(),
                text.parse().unwrap(),
            )]))
        };
        assert_eq!(read("250m"), Some(Duration::from_millis(250)));
        assert_eq!(read("2S"), Some(Duration::from_secs(2)));
        assert_eq!(read("1H"), Some(Duration::from_secs(3600)));
        for text in ["", "m", "12", "-1S", "123456789n", "1x", "99999999H", "1 S"] {
            assert_eq!(read(text), None, "{text}");
        }
    }
}
