//! Connections: accepting, bounding, and ending them.
//!
//! The life of a server, in order: accept until asked to stop; then refuse new work but keep accepting, so that health
//! checks see it; when no work is left, close connections politely; at the deadline, drop what is still there. The
//! protocol libraries may not end in time: a connection that never sends a byte, or a stream without a reader, would
//! hold them permanently.

use super::config::ServerConfig;
use super::connection_facts::ConnectionFacts;
use super::connection_slot::ConnectionSlot;
use super::dispatch::Dispatch;
use super::error::Error;
use super::lingering::{Linger, LingeringSocket};
use super::peers::Peers;
use super::state::State;
use super::tls::TlsDoor;
use super::unread::UnreadAnswer;
use crate::session::Tenant;
use axum::body::Body;
use bytes::Bytes;
use http::{HeaderValue, Request, Response, Version, header};
use http_body::{Body as HttpBody, Frame, SizeHint};
use hyper::body::Incoming;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use std::future::Future;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// How long an idle connection may take to notice that it is being closed.
const IDLE_CLOSE: Duration = Duration::from_millis(300);

/// Connections beyond the limit that are rejected at a time.
const REFUSALS: usize = 64;

/// How long such a rejection may take.
const REFUSAL: Duration = Duration::from_secs(1);

/// How long its health request may take, which is answered even then.
const HEALTH_QUESTION: Duration = Duration::from_millis(200);

/// Serves connections of `listener` until `shutdown` and the drain after it.
pub(super) async fn serve(
    listener: TcpListener,
    state: State,
    dispatch: Dispatch,
    shutdown: impl Future<Output = ()>,
) -> Result<(), Error> {
    let connections = TaskTracker::new();
    let polite = CancellationToken::new();
    let doors = Doors {
        builder: Arc::new(builder(&state.config)),
        slots: Arc::new(Semaphore::new(state.config.connections as usize)),
        refusals: Arc::new(Semaphore::new(REFUSALS)),
        peers: Peers::default(),
        connections: connections.clone(),
        polite: polite.clone(),
        state: state.clone(),
        dispatch: dispatch.clone(),
    };
    tokio::pin!(shutdown);
    tokio::select! {
        () = doors.accept(&listener) => {}
        () = &mut shutdown => {}
    }

    let asked = Instant::now();
    let deadline = asked + state.config.drain_deadline;
    // Streams that are cut still get to say so before their connection goes.
    let cut = deadline - (state.config.drain_deadline / 4).min(Duration::from_millis(500));
    tracing::info!(
        drain.deadline_ms = state.config.drain_deadline.as_millis() as u64,
        "asked to stop: taking no new work, letting what runs finish"
    );
    state.draining.cancel();
    state.manager.start_drain();
    dispatch.stop_serving().await;
    let finished = tokio::select! {
        () = doors.accept(&listener) => false,
        () = state.manager.drained() => true,
        () = tokio::time::sleep_until(cut) => false,
    };
    drop(listener);

    polite.cancel();
    connections.close();
    state.sockets.close();
    if !finished {
        tracing::warn!("work is still open at the deadline and is given up");
        state.manager.abort();
        state.closing.cancel();
    }
    let gone = async {
        connections.wait().await;
        // Sockets outlive their connections; with no work left they have nothing more to say.
        state.sockets.wait().await;
    };
    let closed = tokio::time::timeout_at(cut, gone).await.is_ok();
    if !closed {
        state.manager.abort();
        state.closing.cancel();
        let last = async {
            connections.wait().await;
            state.sockets.wait().await;
        };
        let _ = tokio::time::timeout_at(deadline, last).await;
    }
    doors.dispatch.drop_connections();
    tracing::info!(duration_ms = asked.elapsed().as_millis() as u64, "stopped");
    Ok(())
}

fn builder(config: &ServerConfig) -> auto::Builder<TokioExecutor> {
    const MIB: u32 = 1 << 20;
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(config.header_timeout)
        .max_headers(100)
        .max_buf_size(128 << 10);
    builder
        .http2()
        .timer(TokioTimer::new())
        .initial_stream_window_size(MIB)
        .initial_connection_window_size(4 * MIB)
        .max_frame_size(MIB)
        .max_concurrent_streams(config.requests_per_connection)
        .max_header_list_size(64 << 10)
        .max_send_buf_size(1 << 20)
        // Clients that cancel many calls are not attackers yet.
        .max_pending_accept_reset_streams(256)
        .max_local_error_reset_streams(1024)
        .keep_alive_interval(config.keepalive_interval)
        .keep_alive_timeout(config.keepalive_timeout)
        .enable_connect_protocol();
    builder
}

struct Doors {
    builder: Arc<auto::Builder<TokioExecutor>>,
    slots: Arc<Semaphore>,
    refusals: Arc<Semaphore>,
    peers: Peers,
    connections: TaskTracker,
    polite: CancellationToken,
    state: State,
    dispatch: Dispatch,
}

impl Doors {
    /// Accepts connections in a loop.
    async fn accept(&self, listener: &TcpListener) {
        loop {
            match listener.accept().await {
                Ok((socket, peer)) => self.admit(socket, peer.ip()),
                Err(error) => {
                    // Out of descriptors, or a peer that left at once: neither is a reason to stop.
                    tracing::warn!(error = %error, "a connection could not be accepted");
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
            }
        }
    }

    fn admit(&self, socket: TcpStream, peer: IpAddr) {
        // Frames are written whole; waiting for more only delays them.
        let _ = socket.set_nodelay(true);
        let room = Arc::clone(&self.slots).try_acquire_owned().ok();
        let place = room.and_then(|permit| {
            let peer = self.peers.admit(peer, self.state.config.connections_per_peer)?;
            Some(ConnectionSlot::new(permit, peer))
        });
        let Some(slot) = place else {
            self.state.telemetry.connections_refused.inc();
            if let Ok(permit) = Arc::clone(&self.refusals).try_acquire_owned() {
                let (dispatch, tls) = (self.dispatch.clone(), self.state.tls.clone());
                tokio::spawn(async move {
                    let _ = match tls {
                        None => tokio::time::timeout(REFUSAL, turn_away(socket, dispatch)).await,
                        Some(door) => tokio::time::timeout(REFUSAL, turn_away_encrypted(socket, door, dispatch)).await,
                    };
                    drop(permit);
                });
            }
            return;
        };
        let (state, dispatch) = (self.state.clone(), self.dispatch.clone());
        let (builder, polite) = (Arc::clone(&self.builder), self.polite.clone());
        let dropped = self.dispatch.dropped();
        self.connections.spawn(async move {
            state.telemetry.connections.inc();
            let seat = Seat {
                builder: &builder,
                state: &state,
                dispatch,
                slot,
                polite: &polite,
            };
            tokio::select! {
                () = seat.welcome(socket) => {}
                () = dropped.cancelled() => {}
            }
            state.telemetry.connections.dec();
        });
    }
}

/// What a connection is doing.
#[derive(Default)]
struct Activity {
    /// Whether as much has come as a preface has.
    spoke: AtomicBool,
    /// Answers under way.
    busy: AtomicUsize,
}

/// What a connection is served with.
struct Seat<'a> {
    builder: &'a auto::Builder<TokioExecutor>,
    state: &'a State,
    dispatch: Dispatch,
    slot: ConnectionSlot,
    polite: &'a CancellationToken,
}

impl Seat<'_> {
    /// Serves a connection that was just accepted; one that is to be encrypted has as long for its handshake as another for the
    /// head of a request.
    async fn welcome(self, socket: TcpStream) {
        let Some(door) = &self.state.tls else {
            return connection(self, socket, ConnectionFacts::new(None)).await;
        };
        let shaken = tokio::select! {
            shaken = tokio::time::timeout(self.state.config.header_timeout, door.shake_hands(socket)) => shaken,
            () = self.polite.cancelled() => return,
        };
        match shaken {
            Ok(Ok((stream, tenant))) => connection(self, stream, ConnectionFacts::new(tenant)).await,
            Ok(Err(error)) => tracing::debug!("a TLS handshake failed: {error}"),
            Err(_) => tracing::debug!("a TLS handshake took too long"),
        }
    }
}

async fn connection<S>(seat: Seat<'_>, socket: S, facts: ConnectionFacts)
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let Seat {
        builder,
        state,
        dispatch,
        slot,
        polite,
    } = seat;
    let activity = Arc::new(Activity::default());
    let linger = Linger::default();
    let socket = Watched {
        socket: LingeringSocket::new(socket, linger.clone()),
        activity: Arc::clone(&activity),
        heard: 0,
    };
    let heard = Arc::clone(&activity);
    let unread = CancellationToken::new();
    let (manager, stalled) = (state.manager.clone(), unread.clone());
    let deadline = state.config.unread_deadline;
    let service = hyper::service::service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(slot.clone());
        request.extensions_mut().insert(facts.clone());
        request.extensions_mut().insert(linger.clone());
        let busy = Busy::new(&heard, !is_watch(&request));
        let (dispatch, manager) = (dispatch.clone(), manager.clone());
        // On HTTP/1 nothing else can follow an answer that is not read; of HTTP/2 it is one of many.
        let stalled = match request.version() {
            Version::HTTP_2 => CancellationToken::new(),
            _ => stalled.clone(),
        };
        async move {
            let is_grpc = Dispatch::is_grpc(&request);
            let response: Response<Body> = dispatch.call(request.map(Body::new)).await;
            let asked_by = response.extensions().get::<Tenant>();
            let account = asked_by.and_then(|tenant| manager.account(tenant).ok());
            let memory = (manager.ledger(), account.as_ref());
            let watched = UnreadAnswer::watch(response, memory, deadline, stalled.clone());
            let watched = watched.or_else(|error| {
                let refusal = Dispatch::refusal(error, is_grpc);
                UnreadAnswer::watch(refusal, memory, deadline, stalled)
            });
            watched.map(|response| response.map(|inner| Answer { inner, _busy: busy }))
        }
    });
    let serving = builder.serve_connection_with_upgrades(TokioIo::new(socket), service);
    tokio::pin!(serving);

    // A connection that does not begin with a request or a preface in time is no client.
    let silent = async {
        tokio::time::sleep(state.config.header_timeout).await;
        if activity.spoke.load(Ordering::Relaxed) || activity.busy.load(Ordering::Relaxed) > 0 {
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        ended = serving.as_mut() => {
            if let Err(error) = ended {
                tracing::debug!("a connection broke: {error}");
            }
            return;
        }
        () = silent => return,
        () = unread.cancelled() => return,
        () = polite.cancelled() => {}
    }
    if !activity.spoke.load(Ordering::Relaxed) && activity.busy.load(Ordering::Relaxed) == 0 {
        return;
    }
    serving.as_mut().graceful_shutdown();
    loop {
        let idle = activity.busy.load(Ordering::Relaxed) == 0;
        match tokio::time::timeout(IDLE_CLOSE, serving.as_mut()).await {
            Ok(_) => return,
            // It was idle all the while and the peer does not close: enough.
            Err(_) if idle && activity.busy.load(Ordering::Relaxed) == 0 => return,
            Err(_) => {}
        }
    }
}

/// Calls that last as long as the server itself and must not hold its end up.
fn is_watch(request: &Request<Incoming>) -> bool {
    let path = request.uri().path();
    path.starts_with("/grpc.health.") || path.starts_with("/grpc.reflection.")
}

/// Answers 503 to a connection beyond the limit. A health request is answered, so that many idle clients do not look
/// like a failing server.
async fn turn_away(mut socket: TcpStream, dispatch: Dispatch) {
    let mut head = [0u8; 16];
    let asked = tokio::time::timeout(HEALTH_QUESTION, socket.peek(&mut head)).await;
    let head = &head[..asked.map_or(0, |n| n.unwrap_or(0))];
    if head.starts_with(b"GET /healthz ") || head.starts_with(b"GET /readyz ") {
        answer_health(socket, dispatch).await;
        return;
    }
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: {}\r\nretry-after: 1\r\nconnection: close\r\ncontent-length: {}\r\n\r\n{FULL}",
        super::http::problem::PROBLEM_JSON,
        FULL.len()
    );
    let _ = socket.write_all(answer.as_bytes()).await;
    let _ = socket.shutdown().await;
    // What the client sends is read, or the answer would be lost with the reset that unread bytes cause.
    let mut sink = [0u8; 1024];
    while matches!(socket.read(&mut sink).await, Ok(n) if n > 0) {}
}

/// The same, where nothing can be read before the handshake.
async fn turn_away_encrypted(socket: TcpStream, door: TlsDoor, dispatch: Dispatch) {
    if let Ok((stream, _)) = door.shake_hands(socket).await {
        answer_health(stream, dispatch).await;
    }
}

/// The answer beyond the limit.
const FULL: &str = r#"{"type":"urn:pliant:problem:unavailable","title":"unavailable","status":503,"detail":"too many connections are open","code":"UNAVAILABLE"}"#;

/// Answers one request, if it asks for the server's health.
async fn answer_health<S: AsyncRead + AsyncWrite + Send + Unpin + 'static>(socket: S, dispatch: Dispatch) {
    let service = hyper::service::service_fn(move |request: Request<Incoming>| {
        let dispatch = dispatch.clone();
        async move {
            if matches!(request.uri().path(), "/healthz" | "/readyz") {
                return Ok::<_, std::convert::Infallible>(dispatch.call(request.map(Body::new)).await);
            }
            let mut full = Response::new(Body::from(FULL));
            *full.status_mut() = http::StatusCode::SERVICE_UNAVAILABLE;
            let headers = full.headers_mut();
            let kind = HeaderValue::from_static(super::http::problem::PROBLEM_JSON);
            headers.insert(header::CONTENT_TYPE, kind);
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            Ok(full)
        }
    });
    let mut one = hyper::server::conn::http1::Builder::new();
    let _ = one
        .keep_alive(false)
        .serve_connection(TokioIo::new(socket), service)
        .await;
}

/// One answer under way.
struct Busy(Option<Arc<Activity>>);

impl Busy {
    fn new(activity: &Arc<Activity>, counts: bool) -> Self {
        if counts {
            activity.busy.fetch_add(1, Ordering::Relaxed);
        }
        Self(counts.then(|| Arc::clone(activity)))
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        if let Some(activity) = &self.0 {
            activity.busy.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// A response body that keeps its connection busy until it has been sent.
struct Answer {
    inner: UnreadAnswer,
    _busy: Busy,
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.inner).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

/// A socket that notes when its peer has sent the beginning of a request.
struct Watched<S> {
    socket: S,
    activity: Arc<Activity>,
    heard: usize,
}

/// Bytes of HTTP/2's preface. Until so many have come, nothing but the clock above watches the connection; afterwards the
/// protocol libraries do.
const PREFACE: usize = 24;

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.socket).poll_read(cx, buffer);
        if self.heard < PREFACE {
            self.heard += buffer.filled().len() - before;
            if self.heard >= PREFACE {
                self.activity.spoke.store(true, Ordering::Relaxed);
            }
        }
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write_vectored(cx, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }
}
