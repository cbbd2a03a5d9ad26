//! Connections: accepting, bounding, and ending them.
//!
//! The life of a server, in order: accept until asked to stop; then reject new work but keep accepting, so that health
//! checks see it; when no work is left, shut connections down gracefully; at the deadline, drop what is still there.
//!
//! The end of a connection is by hand: `hyper_util::server::graceful` waits for every connection, and some never end. One
//! that has sent no byte, one whose peer keeps it open without a request, one that only watches the health, and a stream
//! without a reader must not delay the server.

use super::auth::Principal;
use super::config::ServerConfig;
use super::connection::{CertificateCaller, ClientSocket, ConnectionSlot, Peers, SocketFlags};
use super::dispatch::{self, Dispatch};
use super::http::problem::PROBLEM_JSON;
use super::response_watchdog::ResponseWatchdog;
use super::state::ServerState;
use super::tls::TlsAcceptor;
use axum::body::Body;
use http::{HeaderValue, Request, Response, StatusCode, Version, header};
use hyper::body::Incoming;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use pliant_session::Tenant;
use std::convert::Infallible;
use std::future::Future;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// How long an idle connection may take to notice that it is being closed.
const IDLE_CLOSE: Duration = Duration::from_millis(300);

/// Connections beyond the limit that are rejected at a time.
const REJECTIONS: usize = 64;

/// How long such a rejection may take.
const REJECTION: Duration = Duration::from_secs(1);

/// How long its health request may take, which is answered even then.
const HEALTH_REQUEST: Duration = Duration::from_millis(200);

/// Serves connections of `listener` until `shutdown` and the drain after it.
pub(super) async fn serve(
    listener: TcpListener,
    state: ServerState,
    dispatch: Dispatch,
    shutdown: impl Future<Output = ()>,
) {
    let acceptor = ConnectionAcceptor {
        builder: Arc::new(builder(&state.config)),
        slots: Arc::new(Semaphore::new(state.config.connections as usize)),
        rejections: Arc::new(Semaphore::new(REJECTIONS)),
        peers: Peers::default(),
        connections: TaskTracker::new(),
        shutdown_token: CancellationToken::new(),
        state: state.clone(),
        dispatch: dispatch.clone(),
    };
    tokio::pin!(shutdown);
    tokio::select! {
        () = acceptor.accept(&listener) => {}
        () = &mut shutdown => {}
    }

    let asked = Instant::now();
    let deadline = asked + state.config.drain_deadline;
    // Streams that are cut can still report it before their connection ends.
    let cut = deadline - (state.config.drain_deadline / 4).min(Duration::from_millis(500));
    tracing::info!(
        drain.deadline_ms = state.config.drain_deadline.as_millis() as u64,
        "asked to stop: taking no new work, letting what runs finish"
    );
    state.draining.cancel();
    state.manager.start_drain();
    dispatch.stop_serving().await;
    let finished = tokio::select! {
        () = acceptor.accept(&listener) => false,
        () = state.manager.drained() => true,
        () = tokio::time::sleep_until(cut) => false,
    };
    drop(listener);

    acceptor.shutdown_token.cancel();
    acceptor.connections.close();
    state.sockets.close();
    let give_up = || {
        state.manager.abort();
        state.closing.cancel();
    };
    if !finished {
        tracing::warn!("work is still open at the deadline and is given up");
        give_up();
    }
    let closed = || async {
        acceptor.connections.wait().await;
        // WebSockets outlive their connections.
        state.sockets.wait().await;
    };
    if tokio::time::timeout_at(cut, closed()).await.is_err() {
        give_up();
        let _ = tokio::time::timeout_at(deadline, closed()).await;
    }
    state.dropped.cancel();
    tracing::info!(duration_ms = asked.elapsed().as_millis() as u64, "stopped");
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

/// Accepts connections within the limits, and starts a task for each.
struct ConnectionAcceptor {
    builder: Arc<auto::Builder<TokioExecutor>>,
    slots: Arc<Semaphore>,
    rejections: Arc<Semaphore>,
    peers: Peers,
    connections: TaskTracker,
    /// Cancelled when connections are to shut down gracefully.
    shutdown_token: CancellationToken,
    state: ServerState,
    dispatch: Dispatch,
}

impl ConnectionAcceptor {
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
        let Some(slot) = self.free_slot(peer) else {
            self.state.telemetry.connections_refused.inc();
            if let Ok(permit) = Arc::clone(&self.rejections).try_acquire_owned() {
                let (dispatch, tls) = (self.dispatch.clone(), self.state.tls.clone());
                tokio::spawn(async move {
                    let _ = timeout(REJECTION, reject_over_limit(socket, tls, dispatch)).await;
                    drop(permit);
                });
            }
            return;
        };
        let context = ConnectionContext {
            builder: Arc::clone(&self.builder),
            state: self.state.clone(),
            dispatch: self.dispatch.clone(),
            slot,
            shutdown_token: self.shutdown_token.clone(),
        };
        let state = self.state.clone();
        self.connections.spawn(async move {
            state.telemetry.connections.inc();
            tokio::select! {
                () = context.serve(socket) => {}
                () = state.dropped.cancelled() => {}
            }
            state.telemetry.connections.dec();
        });
    }

    fn free_slot(&self, peer: IpAddr) -> Option<ConnectionSlot> {
        let permit = Arc::clone(&self.slots).try_acquire_owned().ok()?;
        let peer = self.peers.admit(peer, self.state.config.connections_per_peer)?;
        Some(ConnectionSlot::new(permit, peer))
    }
}

/// What a connection is served with.
struct ConnectionContext {
    builder: Arc<auto::Builder<TokioExecutor>>,
    state: ServerState,
    dispatch: Dispatch,
    slot: ConnectionSlot,
    shutdown_token: CancellationToken,
}

impl ConnectionContext {
    /// Serves a connection that was just accepted. TLS negotiation has the same time limit as the head of a request.
    async fn serve(self, socket: TcpStream) {
        let Some(tls) = &self.state.tls else {
            return self.serve_http(socket, CertificateCaller(None)).await;
        };
        let accepted = tokio::select! {
            accepted = timeout(self.state.config.header_timeout, tls.accept(socket)) => accepted,
            () = self.shutdown_token.cancelled() => return,
        };
        match accepted {
            Ok(Ok((stream, tenant))) => {
                let caller = tenant.map(|name| Principal::of_tenant(&name));
                self.serve_http(stream, CertificateCaller(caller)).await;
            }
            Ok(Err(error)) => tracing::debug!("a TLS handshake failed: {error}"),
            Err(_) => tracing::debug!("a TLS handshake took too long"),
        }
    }

    async fn serve_http<S>(self, socket: S, caller: CertificateCaller)
    where
        S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        let Self {
            builder,
            state,
            dispatch,
            slot,
            shutdown_token,
        } = self;
        let flags = SocketFlags::default();
        // Answers under way, each with a token.
        let answers = TaskTracker::new();
        let stalled = CancellationToken::new();
        let service = {
            let (state, flags) = (state.clone(), flags.clone());
            let (answers, stalled) = (answers.clone(), stalled.clone());
            hyper::service::service_fn(move |mut request: Request<Incoming>| {
                let extensions = request.extensions_mut();
                extensions.insert(slot.clone());
                extensions.insert(caller.clone());
                extensions.insert(flags.clone());
                let under_way = (!is_watch(&request)).then(|| answers.token());
                // On HTTP/1 nothing else can follow an answer that is not read; of HTTP/2 it is one of many.
                let stalled = match request.version() {
                    Version::HTTP_2 => CancellationToken::new(),
                    _ => stalled.clone(),
                };
                let (dispatch, state) = (dispatch.clone(), state.clone());
                async move {
                    let is_grpc = dispatch::is_grpc(&request);
                    let response = dispatch.call(request.map(Body::new)).await;
                    let tenant = response.extensions().get::<Tenant>();
                    let account = tenant.and_then(|tenant| state.manager.account(tenant).ok());
                    let watchdog = ResponseWatchdog {
                        ledger: state.manager.ledger(),
                        account: account.as_ref(),
                        deadline: state.config.unread_deadline,
                        stalled,
                    };
                    watchdog
                        .watch(response, under_way.clone())
                        .or_else(|error| watchdog.watch(dispatch::rejection(error, is_grpc), under_way))
                }
            })
        };
        let serving =
            builder.serve_connection_with_upgrades(TokioIo::new(ClientSocket::new(socket, flags.clone())), service);
        tokio::pin!(serving);

        let is_silent = || !flags.has_preface() && answers.is_empty();
        // A connection that does not begin with a request or a preface in time is closed.
        let silent = async {
            tokio::time::sleep(state.config.header_timeout).await;
            if !is_silent() {
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
            () = stalled.cancelled() => return,
            () = shutdown_token.cancelled() => {}
        }
        if is_silent() {
            return;
        }
        serving.as_mut().graceful_shutdown();
        loop {
            let is_idle = answers.is_empty();
            match timeout(IDLE_CLOSE, serving.as_mut()).await {
                Ok(_) => return,
                // It was idle for the whole time, and the peer does not close it.
                Err(_) if is_idle && answers.is_empty() => return,
                Err(_) => {}
            }
        }
    }
}

/// Calls that last as long as the server itself and must not delay its end.
fn is_watch(request: &Request<Incoming>) -> bool {
    let path = request.uri().path();
    path.starts_with("/grpc.health.") || path.starts_with("/grpc.reflection.")
}

/// Answers 503 to a connection beyond the limit. By hand, because it must answer a health request even then, so that many
/// idle clients do not look like a failing server.
async fn reject_over_limit(mut socket: TcpStream, tls: Option<TlsAcceptor>, dispatch: Dispatch) {
    if let Some(tls) = tls {
        // Nothing can be read before the handshake.
        if let Ok((stream, _)) = tls.accept(socket).await {
            answer_health(stream, dispatch).await;
        }
        return;
    }
    let mut head = [0u8; 16];
    let peeked = timeout(HEALTH_REQUEST, socket.peek(&mut head)).await;
    let head = &head[..peeked.map_or(0, |n| n.unwrap_or(0))];
    if head.starts_with(b"GET /healthz ") || head.starts_with(b"GET /readyz ") {
        answer_health(socket, dispatch).await;
        return;
    }
    let answer = format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: {PROBLEM_JSON}\r\nretry-after: 1\r\nconnection: close\r\ncontent-length: {}\r\n\r\n{FULL}",
        FULL.len()
    );
    let _ = socket.write_all(answer.as_bytes()).await;
    let _ = socket.shutdown().await;
    // The server reads what the client sends: unread bytes would cause a reset, and the answer would be lost.
    let mut sink = [0u8; 1024];
    while matches!(socket.read(&mut sink).await, Ok(n) if n > 0) {}
}

/// The answer beyond the limit.
const FULL: &str = r#"{"type":"urn:pliant:problem:unavailable","title":"unavailable","status":503,"detail":"too many connections are open","code":"UNAVAILABLE"}"#;

/// Answers one request, if it asks for the server's health.
async fn answer_health<S: AsyncRead + AsyncWrite + Send + Unpin + 'static>(socket: S, dispatch: Dispatch) {
    let service = hyper::service::service_fn(move |request: Request<Incoming>| {
        let dispatch = dispatch.clone();
        async move {
            if matches!(request.uri().path(), "/healthz" | "/readyz") {
                return Ok::<_, Infallible>(dispatch.call(request.map(Body::new)).await);
            }
            let mut full = Response::new(Body::from(FULL));
            *full.status_mut() = StatusCode::SERVICE_UNAVAILABLE;
            let headers = full.headers_mut();
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
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
