//! The one fixture of the tests that talk to a server: the real server, in this process, on a free loopback port.

use bytes::Bytes;
use futures::{SinkExt as _, StreamExt as _};
use pliant::asset::shapes;
use pliant::server::grpc::client::DeformerClient;
use pliant::server::{self, ServerConfig};
use pliant::session::{self, Manager};
use pliant::wire::pb;
use prost::Message as _;
use reqwest::{RequestBuilder, Response};
use serde_json::{Value, json};
use std::future::Future;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio_stream::wrappers::ReceiverStream;
use tokio_tungstenite::tungstenite::{self, client::IntoClientRequest as _, protocol::CloseFrame};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};
use tonic::transport::{Channel, Endpoint};

/// No step of a test takes this long; one that does hangs, and says so instead of hanging the run.
pub const HANG: Duration = Duration::from_secs(60);

/// Waits for something that must come.
pub async fn within<F: Future>(what: &str, future: F) -> F::Output {
    match tokio::time::timeout(HANG, future).await {
        Ok(output) => output,
        Err(_) => panic!("{what}: nothing came in {HANG:?}"),
    }
}

/// A running server. Dropping it stops it without a drain.
pub struct Server {
    pub address: SocketAddr,
    pub manager: Manager,
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<Result<(), server::Error>>,
}

impl Server {
    /// A server with default limits and two compute threads.
    pub async fn start() -> Self {
        Self::with(|_, _| {}).await
    }

    /// As `start`, with the session of `bar_session`.
    pub async fn start_with_bar() -> (Self, String) {
        Self::bar_with(|_, _| {}).await
    }

    /// As `with`, with the session of `bar_session`.
    pub async fn bar_with(change: impl FnOnce(&mut session::SessionConfig, &mut ServerConfig)) -> (Self, String) {
        let server = Self::with(change).await;
        let id = server.bar_session().await;
        (server, id)
    }

    /// A server with changed limits.
    pub async fn with(change: impl FnOnce(&mut session::SessionConfig, &mut ServerConfig)) -> Self {
        let mut sessions = session::SessionConfig {
            compute_threads: 2,
            ..session::SessionConfig::default()
        };
        let mut config = ServerConfig::default();
        change(&mut sessions, &mut config);
        let manager = Manager::new(sessions).expect("a configuration that holds together");
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address");
        let (stop, stopped) = oneshot::channel();
        let shutdown = async move {
            let _ = stopped.await;
        };
        let task = tokio::spawn(server::run(listener, manager.clone(), config, shutdown));
        Self {
            address,
            manager,
            stop: Some(stop),
            task,
        }
    }

    /// Asks the server to stop, as SIGTERM does, and returns at once.
    pub fn ask_to_stop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
    }

    /// Waits until the server has stopped; how long that took.
    pub async fn stopped(mut self) -> Duration {
        let started = Instant::now();
        within("the end of the server", &mut self.task)
            .await
            .expect("no panic")
            .expect("a clean end");
        started.elapsed()
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub fn get(&self, path: &str) -> RequestBuilder {
        http().get(self.url(path))
    }

    pub fn head(&self, path: &str) -> RequestBuilder {
        http().head(self.url(path))
    }

    pub fn post(&self, path: &str) -> RequestBuilder {
        http().post(self.url(path))
    }

    pub fn put(&self, path: &str) -> RequestBuilder {
        http().put(self.url(path))
    }

    pub fn patch(&self, path: &str) -> RequestBuilder {
        http().patch(self.url(path))
    }

    pub fn delete(&self, path: &str) -> RequestBuilder {
        http().delete(self.url(path))
    }

    /// A gRPC client whose limits let frames through.
    pub async fn grpc(&self) -> DeformerClient<Channel> {
        DeformerClient::new(self.channel().await).max_decoding_message_size(64 << 20)
    }

    pub async fn channel(&self) -> Channel {
        let endpoint = Endpoint::from_shared(self.url("")).expect("a URL");
        within("a gRPC connection", endpoint.connect())
            .await
            .expect("a connection")
    }

    /// A gRPC stream on a session: where requests go, where responses come from.
    pub async fn stream(&self, id: &str) -> (mpsc::Sender<pb::DeformRequest>, tonic::Streaming<pb::DeformResponse>) {
        let (requests, waiting) = mpsc::channel(16);
        let named = pb::DeformRequest {
            session_id: id.to_owned(),
            message: None,
        };
        requests.send(named).await.expect("room");
        let mut client = self.grpc().await;
        let responses = within("a stream", client.deform(ReceiverStream::new(waiting))).await;
        (requests, responses.expect("a stream").into_inner())
    }

    /// A WebSocket on a path; the refusal when there is none.
    pub async fn socket(&self, path: &str) -> Result<Socket, tungstenite::Error> {
        Socket::connect(&format!("ws://{}{path}", self.address)).await
    }

    /// A session with a bar and its two ends as handles; its id.
    pub async fn bar_session(&self) -> String {
        let session = self.open(bar_obj(24)).await;
        let id = text(&session["id"]);
        self.hold_ends(&id).await;
        id
    }

    /// Sets the bar's ends as handles of a session.
    pub async fn hold_ends(&self, id: &str) {
        let handles = self.put(&path(id, "/handles")).json(&json!({"handles": ends()}));
        let answer = handles.answer().await;
        assert_eq!(answer.status(), 200, "{}", answer.text().await.unwrap_or_default());
    }

    /// The JSON at a path.
    pub async fn document(&self, path: &str) -> Value {
        self.get(path).document().await
    }

    /// The bytes at a path.
    pub async fn content(&self, path: &str) -> Bytes {
        self.get(path).content().await
    }

    /// The stream of a session as a WebSocket.
    pub async fn stream_socket(&self, id: &str) -> Socket {
        self.socket(&path(id, "/stream")).await.expect("a socket")
    }

    /// Opens a session over HTTP.
    pub async fn open(&self, model: String) -> Value {
        let answer = self.post("/v1/sessions").body(model).answer().await;
        assert_eq!(answer.status(), 201);
        answer.json().await.expect("JSON")
    }

    /// A session of the default tenant, opened beside all transports.
    pub async fn manager_session(&self) -> String {
        self.labelled_session("default").await
    }

    /// A session of a tenant, labelled with its name and opened beside all transports.
    pub async fn labelled_session(&self, tenant: &str) -> String {
        let files = pliant::asset::FileSet::single("bar.obj", bar_obj(8).into_bytes());
        let options = pliant::wire::SessionOptions {
            label: tenant.into(),
            ..Default::default()
        };
        let tenant = session::Tenant(tenant.into());
        let opened = self.manager.create(&tenant, files, options, None);
        let opened = within("a session", opened).await.expect("a session");
        opened.value.id
    }

    /// A figure of `/metrics`; 0 when it is not there.
    pub async fn metric(&self, name: &str) -> f64 {
        let text = self.get("/metrics").answer().await.text().await.expect("a text");
        let line = text
            .lines()
            .find(|l| l.strip_prefix(name).is_some_and(|rest| rest.starts_with([' ', '{'])));
        line.and_then(|l| l.rsplit(' ').next()?.parse().ok()).unwrap_or(0.0)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.manager.abort();
        self.task.abort();
    }
}

/// A message of a stream whose session is named already.
pub fn message(message: pb::deform_request::Message) -> pb::DeformRequest {
    pb::DeformRequest {
        session_id: String::new(),
        message: Some(message),
    }
}

/// A WebSocket that speaks messages of the schema.
pub struct Socket {
    pub stream: WebSocketStream<MaybeTlsStream<TcpStream>>,
}

/// What came over a socket.
#[derive(Debug)]
// One is looked at at a time; a box would only be in the way.
#[allow(clippy::large_enum_variant)]
pub enum Came {
    Response(pb::DeformResponse),
    Closed(Option<(u16, String)>),
}

impl Socket {
    /// A WebSocket on a `ws://` address; the refusal when there is none.
    pub async fn connect(url: &str) -> Result<Self, tungstenite::Error> {
        let config = tungstenite::protocol::WebSocketConfig::default().max_message_size(Some(64 << 20));
        let connect = tokio_tungstenite::connect_async_with_config(url, Some(config), true);
        let (stream, _) = within("a WebSocket", connect).await?;
        Ok(Self { stream })
    }

    /// As `connect`, with another header.
    pub async fn connect_with(url: &str, name: &'static str, value: &str) -> Result<Self, tungstenite::Error> {
        let mut request = url.into_client_request()?;
        request.headers_mut().insert(name, value.parse().expect("a value"));
        let (stream, _) = within("a WebSocket", tokio_tungstenite::connect_async(request)).await?;
        Ok(Self { stream })
    }

    /// The next response; none where the socket closes.
    pub async fn response(&mut self) -> Option<pb::deform_response::Message> {
        match self.next().await {
            Came::Response(response) => Some(response.message.expect("a message")),
            Came::Closed(_) => None,
        }
    }

    pub async fn send(&mut self, sent: pb::deform_request::Message) {
        let bytes = Bytes::from(message(sent).encode_to_vec());
        within("sending", self.stream.send(tungstenite::Message::Binary(bytes)))
            .await
            .expect("an open socket");
    }

    pub async fn next(&mut self) -> Came {
        loop {
            match within("a message", self.stream.next()).await {
                Some(Ok(tungstenite::Message::Binary(bytes))) => {
                    return Came::Response(pb::DeformResponse::decode(bytes).expect("a DeformResponse"));
                }
                Some(Ok(tungstenite::Message::Close(frame))) => {
                    return Came::Closed(frame.map(|CloseFrame { code, reason }| (code.into(), reason.to_string())));
                }
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return Came::Closed(None),
            }
        }
    }
}

/// The answers of calls, which must come.
pub trait AnsweredCall {
    /// The answer, whatever its status.
    async fn answer(self) -> Response;

    /// The JSON of the answer, whatever its status.
    async fn document(self) -> Value;

    /// The bytes of the answer, whatever its status.
    async fn content(self) -> Bytes;

    /// The status of the answer.
    async fn status(self) -> u16;

    /// The problem document of a refusal with that status.
    async fn refusal(self, status: u16) -> Value;
}

impl AnsweredCall for RequestBuilder {
    async fn answer(self) -> Response {
        within("an answer", self.send()).await.expect("an answer")
    }

    async fn document(self) -> Value {
        self.answer().await.json().await.expect("JSON")
    }

    async fn content(self) -> Bytes {
        self.answer().await.bytes().await.expect("a body")
    }

    async fn status(self) -> u16 {
        self.answer().await.status().as_u16()
    }

    async fn refusal(self, status: u16) -> Value {
        let answer = self.answer().await;
        let seen = answer.status().as_u16();
        let problem = answer.json().await.unwrap_or(Value::Null);
        assert_eq!(seen, status, "{problem}");
        problem
    }
}

/// A client that does not follow proxies of the environment.
pub fn http() -> reqwest::Client {
    reqwest::Client::builder().no_proxy().build().expect("a client")
}

/// A header of an answer, which has it.
pub fn header(answer: &Response, name: impl reqwest::header::AsHeaderName) -> &str {
    let value = answer.headers().get(name).expect("the header");
    value.to_str().expect("a text")
}

/// A path of a session.
pub fn path(id: &str, rest: &str) -> String {
    format!("/v1/sessions/{id}{rest}")
}

/// A request of gRPC with a bearer token.
pub fn with_token<T>(message: T, token: &str) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    let bearer = format!("Bearer {token}").parse().expect("ASCII");
    request.metadata_mut().insert("authorization", bearer);
    request
}

/// The rows of a table in a text: cells stand between bars.
pub fn rows<const N: usize>(table: &'static str) -> impl Iterator<Item = [&'static str; N]> {
    let lines = table.lines().filter(|line| !line.trim().is_empty());
    lines.map(|line| {
        let cells: Vec<&str> = line.split(" | ").map(str::trim).collect();
        cells.try_into().unwrap_or_else(|_| panic!("not {N} cells: {line}"))
    })
}

/// The text of a JSON string.
pub fn text(value: &Value) -> String {
    value
        .as_str()
        .unwrap_or_else(|| panic!("{value} is not a string"))
        .to_owned()
}

/// A bar along z from 0 to 4, closed, as OBJ.
pub fn bar_obj(along: usize) -> String {
    bar([3, 3, along])
}

/// Such a bar with so many vertices that opening it takes a while.
pub fn large_bar() -> String {
    bar([40, 40, 320])
}

/// Such a bar of so many cells along each axis.
pub fn bar(cells: [usize; 3]) -> String {
    super::shapes::obj_text(&shapes::box_with_cells(glam::DVec3::new(0.5, 0.5, 4.0), cells))
}

/// The bar's ends as handles, in JSON.
pub fn ends() -> Value {
    json!([
        {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.25}}},
        {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 3.75}}},
    ])
}

/// The bar's ends as handles, as messages.
pub fn end_handles() -> Vec<pb::Handle> {
    let request: pb::SetHandlesRequest =
        pliant::wire::json::from_json(json!({"handles": ends()}).to_string().as_bytes()).expect("handles");
    request.handles
}

/// Such a pose as a request of a stream.
pub fn turned_request(seq: u64, angle: f64, commit: bool) -> pb::DeformRequest {
    message(pb::deform_request::Message::Pose(turned(seq, angle, commit)))
}

/// A solve call that commits such a pose.
pub fn turn_request(id: &str, seq: u64, angle: f64) -> pb::SolveRequest {
    pb::SolveRequest {
        session_id: id.to_owned(),
        pose: Some(turned(seq, angle, true)),
        options: None,
    }
}

/// A pose that turns the bar's top about z and lifts it.
pub fn turned(seq: u64, angle: f64, commit: bool) -> pb::Pose {
    let pose = pb::HandlePose {
        rotation_vector: vec![0.0, 0.0, angle],
        translation: vec![0.0, 0.0, 0.25],
        ..pb::HandlePose::default()
    };
    pb::Pose {
        seq,
        handles: vec![pb::pose::Entry {
            id: "top".into(),
            pose: Some(pose),
        }],
        commit,
        ..pb::Pose::default()
    }
}

/// The body of a solve call, in JSON.
pub fn turn_json(angle: f64) -> Value {
    json!({"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0, 0, angle], "translation": [0, 0, 0.25]}}]}})
}

/// Little-endian floats.
pub fn floats(bytes: &[u8]) -> Vec<f32> {
    assert_eq!(bytes.len() % 4, 0, "whole floats");
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect()
}

/// Waits until a condition holds; timing does not decide, only whether it ever does.
pub async fn eventually(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    retried(what, Duration::from_millis(10), async || holds().await.then_some(())).await;
}

/// Tries something again and again, with a pause in between, until it gives a value.
pub async fn retried<T>(what: &str, pause: Duration, mut attempt: impl AsyncFnMut() -> Option<T>) -> T {
    within(what, async {
        loop {
            match attempt().await {
                Some(value) => return value,
                None => tokio::time::sleep(pause).await,
            }
        }
    })
    .await
}

/// Ticks with at least such a pause between two.
pub fn pace(pause: Duration) -> tokio::time::Interval {
    let mut pace = tokio::time::interval(pause);
    pace.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    pace
}

/// Asserts that a condition holds, again and again, for as long as that.
pub async fn stays(what: &str, time: Duration, mut holds: impl AsyncFnMut() -> bool) {
    let broken = retried(what, Duration::from_millis(10), async || (!holds().await).then_some(()));
    assert!(
        tokio::time::timeout(time, broken).await.is_err(),
        "{what}: no longer so"
    );
}

/// Tries something on this thread until it gives a value; `None` when that takes longer than the limit.
pub fn retried_here<T>(limit: Duration, mut attempt: impl FnMut() -> Option<T>) -> Option<T> {
    let started = Instant::now();
    loop {
        match attempt() {
            None if started.elapsed() < limit => std::thread::sleep(Duration::from_millis(5)),
            tried => return tried,
        }
    }
}
