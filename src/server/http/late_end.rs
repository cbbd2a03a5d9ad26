//! Refusals over HTTP/2 that come before the body was read.
//!
//! A server that ends its answer while the client is still sending resets the stream (RFC 9113, 8.1), and some clients, curl 7 among
//! them, forget the answer at the reset. So the end of a refusal waits a moment, while what the client sends is read and
//! forgotten; most bodies end in it.

use axum::body::Body;
use bytes::Bytes;
use futures::StreamExt as _;
use futures::future::BoxFuture;
use http_body::{Body as HttpBody, Frame, SizeHint};
use std::pin::Pin;
use std::sync::{Arc, LazyLock};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::{Semaphore, oneshot};

/// How much of an unread body is read at most,
const MOST: usize = 1 << 20;
/// for how long,
const LONGEST: Duration = Duration::from_secs(1);
/// and how long it may pause: a client that has seen the answer sends nothing more.
const PAUSE: Duration = Duration::from_millis(250);
/// Answers of the whole program whose end waits at a time. What is refused beyond these ends at once.
static WAITING: LazyLock<Arc<Semaphore>> = LazyLock::new(|| Arc::new(Semaphore::new(256)));

/// The unread rest of a request's body.
pub(super) struct UnreadRest(oneshot::Receiver<Body>);

impl UnreadRest {
    /// Wraps the body of a request. The second value receives what is left when it is dropped.
    pub fn of(body: Body) -> (Body, Self) {
        let (leave, rest) = oneshot::channel();
        let body = super::body::leave_rest(body, move |rest| {
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
        let (body, rest) = UnreadRest::of(body);
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
            let (body, rest) = UnreadRest::of(body);
            drop(body);
            let told = rest.delay_end_within(Body::from("no"), longest, pause).collect().await;
            assert_eq!(told.expect("an answer").to_bytes(), "no");
        }
        let endless = futures::stream::repeat_with(|| Ok::<_, std::io::Error>(Bytes::from_static(&[0; 4096])));
        let (body, rest) = UnreadRest::of(Body::from_stream(endless));
        drop(body);
        let told = rest.delay_end_within(Body::from("no"), hour, hour).collect().await;
        assert_eq!(told.expect("an answer").to_bytes(), "no");
    }

    #[tokio::test]
    async fn a_body_that_was_read_delays_nothing() {
        let (body, rest) = UnreadRest::of(Body::from("all of it"));
        body.collect().await.expect("read");
        assert!(rest.delay_end(Body::empty()).is_end_stream());
    }
}
