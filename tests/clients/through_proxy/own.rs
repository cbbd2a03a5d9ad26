//! Sessions that this program drives itself, over HTTP and WebSocket: each is dragged and committed at the same time.

use super::Driven;
use crate::support::server::{Socket, bar_obj, ends, http, pace, retried, turn_json, turned, within};
use futures::{SinkExt as _, StreamExt as _};
use pliant::wire::pb::{self, deform_request, deform_response};
use prost::Message as _;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::Message;

/// Between two poses of a drag, and between two commits.
const PAUSES: [Duration; 2] = [Duration::from_millis(120), Duration::from_millis(500)];

/// Sessions that are being driven.
pub(super) struct OwnDriver {
    pub(super) ids: Vec<String>,
    drags: Vec<JoinHandle<Dragged>>,
    commits: Vec<JoinHandle<Vec<(f64, u64)>>>,
    stop: Arc<AtomicBool>,
}

/// What came back of one stream.
struct Dragged {
    answers: u64,
    away: Duration,
    opened: u64,
}

impl OwnDriver {
    /// Opens sessions and begins.
    pub(super) async fn start(url: &str, sessions: usize) -> Self {
        let mut own = Self {
            ids: Vec::new(),
            drags: Vec::new(),
            commits: Vec::new(),
            stop: Arc::default(),
        };
        for k in 0..sessions {
            let id = open(url, k).await;
            let told = (url.to_owned(), id.clone(), Arc::clone(&own.stop));
            own.drags.push(tokio::spawn(keep_dragging(told.clone())));
            own.commits.push(tokio::spawn(keep_committing(told)));
            own.ids.push(id);
        }
        own
    }

    /// Ends; what came back.
    pub(super) async fn finish(self) -> Vec<Driven> {
        self.stop.store(true, SeqCst);
        let mut all = Vec::new();
        for ((id, drag), commits) in self.ids.into_iter().zip(self.drags).zip(self.commits) {
            let dragged = within("the end of a drag", drag).await.expect("no panic");
            all.push(Driven {
                id,
                commits: within("the last commit", commits).await.expect("no panic"),
                answers: dragged.answers,
                away: dragged.away.as_secs_f64(),
                reconnects: dragged.opened.saturating_sub(1),
            });
        }
        all
    }
}

async fn open(url: &str, k: usize) -> String {
    let created = retried("a session", Duration::from_millis(50), async || {
        let sent = http()
            .post(format!("{url}/v1/sessions"))
            .header("idempotency-key", format!("create-{k}"));
        let answer = sent.body(bar_obj(12)).send().await.ok()?;
        answer.status().is_success().then_some(answer)
    });
    let created = tokio::time::timeout(Duration::from_secs(20), created).await;
    let session: Value = created.expect("a session").json().await.expect("JSON");
    let id = session["id"].as_str().expect("an id").to_owned();
    let handles = json!({"handles": ends()});
    let path = format!("/v1/sessions/{id}/handles");
    insist(url, ("PUT", &path), Some(&handles), &format!("hold-{k}")).await;
    id
}

/// Makes a call until it is answered; calls that change something carry a key, so that they happen once.
pub(super) async fn insist(url: &str, (method, rest): (&str, &str), body: Option<&Value>, key: &str) -> Value {
    let mut ticks = pace(Duration::from_millis(100));
    let since = Instant::now();
    loop {
        ticks.tick().await;
        let mut call = http().request(method.parse().expect("a method"), format!("{url}{rest}"));
        if let Some(body) = body {
            call = call.json(body);
        }
        if !key.is_empty() {
            call = call.header("idempotency-key", key);
        }
        let answer = tokio::time::timeout(Duration::from_secs(4), call.send()).await;
        if let Ok(Ok(answer)) = answer {
            let status = answer.status().as_u16();
            if status < 300 {
                return answer.json().await.unwrap_or(Value::Null);
            }
            let may_pass = [307, 409, 429, 500, 502, 503, 504].contains(&status);
            assert!(
                may_pass,
                "{method} {rest}: {status} {}",
                answer.text().await.unwrap_or_default()
            );
        }
        assert!(
            since.elapsed() < Duration::from_secs(40),
            "{method} {rest} is not answered any more"
        );
    }
}

/// Opens a stream where the session is: a call finds that out, as the clients do, since a socket's refusal says little.
async fn open_stream(url: &str, id: &str) -> Option<Socket> {
    let asked = http()
        .get(format!("{url}/v1/sessions/{id}"))
        .header("x-pliant-hops", "0")
        .send();
    let told = tokio::time::timeout(Duration::from_secs(1), asked).await.ok()?.ok()?;
    let node = told
        .headers()
        .get("x-pliant-node")
        .and_then(|node| node.to_str().ok())
        .map(str::to_owned);
    let named = node.map(|node| format!("?pliant-node={node}")).unwrap_or_default();
    let address = format!("{}/v1/sessions/{id}/stream{named}", url.replace("http", "ws"));
    let opened = tokio::time::timeout(Duration::from_secs(1), tokio_tungstenite::connect_async(address)).await;
    Some(Socket {
        stream: opened.ok()?.ok()?.0,
    })
}

/// Sends a pose, waits for its last frame and acknowledges it; `None` where the stream has ended, or its node is about to stop.
async fn try_drag(socket: &mut Socket, pose: pb::Pose) -> Option<()> {
    let seq = pose.seq;
    say(socket, deform_request::Message::Pose(pose)).await?;
    loop {
        let Message::Binary(bytes) = socket.stream.next().await?.ok()? else {
            continue;
        };
        match pb::DeformResponse::decode(bytes).ok()?.message? {
            deform_response::Message::Frame(frame) if frame.r#final && frame.seq == seq => break,
            deform_response::Message::Error(_) | deform_response::Message::Notice(_) => return None,
            _ => {}
        }
    }
    say(socket, deform_request::Message::Ack(pb::Ack { seq })).await
}

async fn say(socket: &mut Socket, message: deform_request::Message) -> Option<()> {
    let request = pb::DeformRequest {
        session_id: String::new(),
        message: Some(message),
    };
    let bytes = request.encode_to_vec().into();
    socket.stream.send(Message::Binary(bytes)).await.ok()
}

/// Drags until it is told to stop.
async fn keep_dragging((url, id, stop): (String, String, Arc<AtomicBool>)) -> Dragged {
    let (mut asked, mut seq) = (None, 0);
    let mut dragged = Dragged {
        answers: 0,
        away: Duration::ZERO,
        opened: 0,
    };
    let mut socket: Option<Socket> = None;
    let [mut retries, mut poses] = [Duration::from_millis(30), PAUSES[0]].map(pace);
    while !stop.load(SeqCst) {
        let Some(open) = &mut socket else {
            socket = open_stream(&url, &id).await;
            dragged.opened += u64::from(socket.is_some());
            seq = 0;
            retries.tick().await;
            continue;
        };
        seq += 1;
        // A pose that got no answer is asked again on the next stream.
        let since = *asked.get_or_insert_with(Instant::now);
        let pose = turned(seq, 0.01 * (seq % 50) as f64, false);
        // One that says nothing for so long is looked for anew, as the clients do.
        match tokio::time::timeout(Duration::from_millis(1500), try_drag(open, pose)).await {
            Ok(Some(())) => {
                dragged.answers += 1;
                dragged.away = dragged.away.max(since.elapsed());
                asked = None;
                poses.tick().await;
            }
            _ => socket = None,
        }
    }
    dragged
}

/// Commits until it is told to stop, each under its key; what was acknowledged.
async fn keep_committing((url, id, stop): (String, String, Arc<AtomicBool>)) -> Vec<(f64, u64)> {
    let mut acknowledged: Vec<(f64, u64)> = Vec::new();
    let path = format!("/v1/sessions/{id}/solve");
    let mut commits = pace(PAUSES[1]);
    while !stop.load(SeqCst) {
        let angle = 0.02 * ((acknowledged.len() * 7) % 40) as f64 - 0.4;
        let key = format!("{id}-{}", acknowledged.len());
        let solved = insist(&url, ("POST", &path), Some(&turn_json(angle)), &key).await;
        let revision = &solved["revision"];
        let revision = revision.as_u64().or_else(|| revision.as_str()?.parse().ok());
        acknowledged.push((angle, revision.expect("a revision")));
        commits.tick().await;
    }
    acknowledged
}
