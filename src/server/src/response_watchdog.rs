//! Answers under way: counted while they wait to be read, sent in pieces, and dropped when the client does not read.
//!
//! By hand, because no layer bounds the time that a client takes to read: a protocol library takes a body as fast as its peer
//! reads, but a body that exists whole costs its whole size until then, and nothing in the library ends a peer that stops reading.
//! So every answer passes through here. Its rest counts in the ledger, and the library gets copies of small pieces. When the
//! library takes no further piece within the deadline, the rest is dropped.

use axum::body::Body;
use bytes::{Buf as _, Bytes};
use http::Response;
use http_body::{Body as HttpBody, Frame, SizeHint};
use pliant_session::{Error, MemoryLedger, MemoryReservation, MemoryUse, TenantAccount};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;
use tokio_util::task::task_tracker::TaskTrackerToken;

/// Bytes of a piece.
const PIECE: usize = 64 << 10;

/// Answers up to this size are neither counted nor watched: libraries hold more for every call.
const SMALL: u64 = 16 << 10;

/// A body that is counted while it waits, and dropped when it is not read.
pub(super) struct WatchedBody {
    reading: Reading,
    /// Keeps the connection busy until the body has been sent.
    _under_way: Option<TaskTrackerToken>,
}

enum Reading {
    /// Too small to be counted.
    Small(Body),
    Watched {
        answer: Arc<Mutex<WaitingAnswer>>,
        size: SizeHint,
        _watchdog: AbortOnDropHandle<()>,
    },
}

/// What is left of an answer.
struct WaitingAnswer {
    /// Gone when it has ended or was given up.
    body: Option<Body>,
    /// What is left of its last frame.
    rest: Bytes,
    /// Since when the library has had a piece and not come for the next.
    handed: Option<Instant>,
    held: Option<MemoryReservation>,
    has_known_size: bool,
    is_given_up: bool,
}

/// What answers are watched with.
pub(super) struct ResponseWatchdog<'a> {
    /// The memory of the server.
    pub ledger: &'a Arc<MemoryLedger>,
    /// The account of the tenant whose memory an answer counts for.
    pub account: Option<&'a Arc<TenantAccount>>,
    /// How long an answer may wait for its reader to take some more of it.
    pub deadline: Duration,
    /// Cancelled when an answer is given up.
    pub stalled: CancellationToken,
}

impl ResponseWatchdog<'_> {
    /// Watches an answer until it has been sent, and holds `under_way` as long.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` when there is no memory to hold it until it is read.
    pub fn watch(
        &self,
        response: Response<Body>,
        under_way: Option<TaskTrackerToken>,
    ) -> Result<Response<WatchedBody>, Error> {
        let (parts, body) = response.into_parts();
        let reading = self.watch_body(body)?;
        let body = WatchedBody {
            reading,
            _under_way: under_way,
        };
        Ok(Response::from_parts(parts, body))
    }

    fn watch_body(&self, body: Body) -> Result<Reading, Error> {
        let size = body.size_hint();
        if size.exact().is_some_and(|bytes| bytes <= SMALL) {
            return Ok(Reading::Small(body));
        }
        let known = size.exact().unwrap_or(0);
        let held = self.ledger.reserve(MemoryUse::Answers, self.account, known, known);
        let held = held.map_err(|shortage| {
            let text = format!("the answer has {known} bytes, and {shortage}; read other answers, or try again later");
            Error::exhausted(text, 2)
        })?;
        let answer = Arc::new(Mutex::new(WaitingAnswer {
            body: Some(body),
            rest: Bytes::new(),
            handed: Some(Instant::now()),
            held: Some(held),
            has_known_size: size.exact().is_some(),
            is_given_up: false,
        }));
        let watchdog = tokio::spawn(give_up_late(Arc::clone(&answer), self.deadline, self.stalled.clone()));
        Ok(Reading::Watched {
            answer,
            size,
            _watchdog: AbortOnDropHandle::new(watchdog),
        })
    }
}

/// Gives an answer up once its reader has let the deadline pass without taking a piece.
async fn give_up_late(answer: Arc<Mutex<WaitingAnswer>>, deadline: Duration, stalled: CancellationToken) {
    loop {
        let since = lock(&answer).handed;
        let until = since.unwrap_or_else(Instant::now) + deadline;
        tokio::time::sleep_until(until).await;
        let mut waiting = lock(&answer);
        if waiting.body.is_none() && waiting.rest.is_empty() {
            return;
        }
        if since.is_some() && waiting.handed == since {
            let dropped = (
                waiting.body.take(),
                std::mem::take(&mut waiting.rest),
                waiting.held.take(),
            );
            waiting.is_given_up = true;
            drop(waiting);
            drop(dropped);
            tracing::info!(
                deadline_ms = deadline.as_millis() as u64,
                "an answer was aborted: the client did not read it"
            );
            stalled.cancel();
            return;
        }
    }
}

fn lock(answer: &Mutex<WaitingAnswer>) -> MutexGuard<'_, WaitingAnswer> {
    answer.lock().unwrap_or_else(PoisonError::into_inner)
}

impl WaitingAnswer {
    /// The next piece of the frame that has begun.
    fn next_piece(&mut self) -> Frame<Bytes> {
        let piece = if self.rest.len() <= PIECE {
            std::mem::take(&mut self.rest)
        } else {
            // A slice would keep the whole of it alive in the library's buffers.
            let piece = Bytes::copy_from_slice(&self.rest[..PIECE]);
            self.rest.advance(PIECE);
            piece
        };
        self.handed = Some(Instant::now());
        // A whole body is held until its end, of a stream only what is left of its last frame.
        if let Some(held) = self.held.as_ref().filter(|_| !self.has_known_size) {
            let _ = held.resize(self.rest.len() as u64);
        }
        Frame::data(piece)
    }

    fn poll_piece(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.is_given_up {
            let late = std::io::Error::new(std::io::ErrorKind::TimedOut, "the client did not read the answer");
            return Poll::Ready(Some(Err(axum::Error::new(late))));
        }
        // It is here again, so it reads; from now on it is the answer that makes it wait.
        self.handed = None;
        if !self.rest.is_empty() {
            return Poll::Ready(Some(Ok(self.next_piece())));
        }
        let Some(body) = &mut self.body else {
            return Poll::Ready(None);
        };
        match Pin::new(body).poll_frame(cx) {
            Poll::Pending => Poll::Pending,
            Poll::Ready(None) => {
                (self.body, self.held) = (None, None);
                Poll::Ready(None)
            }
            Poll::Ready(Some(Err(error))) => Poll::Ready(Some(Err(error))),
            Poll::Ready(Some(Ok(frame))) => match frame.into_data() {
                Ok(data) => {
                    self.rest = data;
                    Poll::Ready(Some(Ok(self.next_piece())))
                }
                Err(trailers) => Poll::Ready(Some(Ok(trailers))),
            },
        }
    }
}

impl HttpBody for WatchedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        match &mut self.reading {
            Reading::Small(body) => Pin::new(body).poll_frame(cx),
            Reading::Watched { answer, .. } => lock(answer).poll_piece(cx),
        }
    }

    fn is_end_stream(&self) -> bool {
        match &self.reading {
            Reading::Small(body) => body.is_end_stream(),
            Reading::Watched { answer, .. } => {
                let waiting = lock(answer);
                let has_ended = waiting.body.as_ref().is_none_or(HttpBody::is_end_stream);
                !waiting.is_given_up && waiting.rest.is_empty() && has_ended
            }
        }
    }

    fn size_hint(&self) -> SizeHint {
        match &self.reading {
            Reading::Small(body) => body.size_hint(),
            Reading::Watched { size, .. } => *size,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::StreamExt as _;
    use http_body_util::BodyExt as _;
    use pliant_session::{Manager, SessionConfig};

    fn ledger(bytes: u64) -> Arc<MemoryLedger> {
        let config = SessionConfig {
            memory_bytes: bytes,
            ..SessionConfig::default()
        };
        Arc::clone(Manager::new(config).expect("a manager").ledger())
    }

    fn watch(body: Body, ledger: &Arc<MemoryLedger>) -> Result<WatchedBody, Error> {
        let watchdog = ResponseWatchdog {
            ledger,
            account: None,
            deadline: Duration::from_millis(50),
            stalled: CancellationToken::new(),
        };
        watchdog.watch(Response::new(body), None).map(Response::into_body)
    }

    #[tokio::test]
    async fn what_is_read_comes_whole_in_pieces_and_is_counted_until_then() {
        let ledger = ledger(4 << 20);
        let bytes: Vec<u8> = (0..1_000_000u32).map(|i| (i % 251) as u8).collect();
        let mut answer = watch(Body::from(bytes.clone()), &ledger).expect("room for it");
        assert_eq!(ledger.used(), 1_000_000);
        let mut read = Vec::new();
        while let Some(frame) = answer.frame().await {
            let piece = frame.expect("a piece").into_data().expect("data");
            assert!(piece.len() <= PIECE);
            read.extend_from_slice(&piece);
        }
        assert!(read == bytes);
        assert_eq!(ledger.used(), 0);
    }

    #[tokio::test]
    async fn what_no_one_reads_is_dropped_though_no_one_asks_again() {
        let ledger = ledger(4 << 20);
        let mut answer = watch(Body::from(vec![7u8; 3 << 20]), &ledger).expect("room for it");
        let refused = watch(Body::from(vec![7u8; 3 << 20]), &ledger)
            .err()
            .expect("no room for two");
        assert_eq!((refused.http_status(), refused.retry_after_s), (429, Some(2)));
        answer.frame().await.expect("a first piece").expect("a piece");
        tokio::time::sleep(Duration::from_millis(200)).await;
        assert_eq!(ledger.used(), 0);
        let late = answer.frame().await.expect("an end").expect_err("given up");
        assert!(
            late.to_string().contains("the client did not read the answer"),
            "{late}"
        );
    }

    #[tokio::test]
    async fn an_answer_that_has_nothing_to_say_yet_waits_as_long_as_it_likes() {
        let ledger = ledger(4 << 20);
        let slow = futures::stream::once(async {
            tokio::time::sleep(Duration::from_millis(300)).await;
            Ok::<_, std::convert::Infallible>(Bytes::from_static(b"late"))
        });
        let body = Body::from_stream(slow.chain(futures::stream::pending().take_until(std::future::ready(()))));
        let answer = watch(body, &ledger).expect("room for it");
        assert_eq!(answer.collect().await.expect("all of it").to_bytes(), "late");
    }
}
