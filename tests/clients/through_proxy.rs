//! Three nodes behind HAProxy, as `deploy/haproxy.cfg` sets it up: sessions are dragged and committed through the proxy while nodes are
//! killed, drained and stopped past their leases. What was acknowledged is there once, with the bits of a single server.

use super::{LEASE, signal};
use crate::durable::place::StorePlace;
use crate::durable::{bar_session, path, seen, turn};
use crate::support::program::ServedProgram;
use crate::support::server::{Socket, bar_obj, ends, http, turn_json, turned, within};
use futures::{SinkExt as _, StreamExt as _};
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::pb::{self, deform_request, deform_response};
use prost::Message as _;
use serde_json::{Value, json};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::Message;

const NAMES: [&str; 3] = ["a", "b", "c"];
/// A stream is to be back within this time.
const BACK: Duration = Duration::from_secs(5);

/// A running proxy. Dropping it ends it.
struct Proxy(Child);

impl Drop for Proxy {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A port that nobody uses at the moment.
fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").port()
}

/// Starts HAProxy with the file of `deploy/`, on this port and before nodes on these; `None` where it is not installed.
fn proxy(place: &StorePlace, port: u16, nodes: [u16; 3]) -> Option<Proxy> {
    let program = ["/usr/sbin/haproxy", "/usr/bin/haproxy"]
        .into_iter()
        .find(|p| Path::new(p).exists());
    let Some(program) = program else {
        println!("SKIPPED: HAProxy is not installed (apt-get install haproxy); nodes were not called through it");
        return None;
    };
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/haproxy.cfg");
    let mut text = std::fs::read_to_string(file).expect("the file of deploy/");
    text = text.replace("bind :7411\n", &format!("bind 127.0.0.1:{port}\n"));
    for (k, node) in nodes.iter().enumerate() {
        let told = format!("10.0.0.{}:7411", 5 + k);
        assert!(text.contains(&told), "deploy/haproxy.cfg names {told}");
        text = text.replace(&told, &format!("127.0.0.1:{node}"));
    }
    let config = place.top().join("haproxy.cfg");
    std::fs::write(&config, text).expect("written");
    let checked = Command::new(program).args(["-c", "-q", "-f"]).arg(&config).status();
    assert!(
        checked.expect("haproxy runs").success(),
        "deploy/haproxy.cfg can be read"
    );
    let log = std::fs::File::create(place.top().join("haproxy.log")).expect("a log");
    let child = Command::new(program)
        .args(["-db", "-f"])
        .arg(&config)
        .stdout(Stdio::null())
        .stderr(log)
        .spawn();
    Some(Proxy(child.expect("haproxy starts")))
}

/// A node on a port of its own, under the proxy's address.
fn node(place: &StorePlace, (name, own): (&str, u16), proxy: u16) -> ServedProgram {
    let (listen, advertise) = (format!("127.0.0.1:{own}"), format!("http://127.0.0.1:{proxy}"));
    let told = [
        "--advertise",
        &advertise,
        "--node",
        name,
        "--lease",
        "1s",
        "--heartbeat",
        "200ms",
    ];
    let told = [&told[..], &["--drain-deadline", "5s", "--listen", &listen]].concat();
    let log = format!("log-{name}-{}", std::process::id());
    place
        .start_logged(&log, place.database().map(|d| d.url.as_str()), &told)
        .expect("the node starts")
}

/// Makes a call until it is answered; calls that change something carry a key, so that they happen once.
async fn insist(url: &str, (method, rest): (&str, &str), body: Option<&Value>, key: &str) -> Value {
    let since = Instant::now();
    loop {
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
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Opens a stream where the session is: a call finds that out, as the clients do, since a socket's refusal says little.
async fn open_stream(url: &str, id: &str) -> Option<Socket> {
    let asked = http()
        .get(format!("{url}{}", path(id, "")))
        .header("x-pliant-hops", "0")
        .send();
    let told = tokio::time::timeout(Duration::from_secs(1), asked).await.ok()?.ok()?;
    let node = told
        .headers()
        .get("x-pliant-node")
        .and_then(|node| node.to_str().ok())
        .map(str::to_owned);
    let named = node.map(|node| format!("?pliant-node={node}")).unwrap_or_default();
    let address = format!("{}{}{named}", url.replace("http", "ws"), path(id, "/stream"));
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

/// Drags until it is told to stop; the longest time that the stream was away.
async fn keep_dragging(url: String, id: String, stop: Arc<AtomicBool>) -> Duration {
    let (mut longest, mut since, mut seq) = (Duration::ZERO, Instant::now(), 0);
    let mut socket: Option<Socket> = None;
    while !stop.load(SeqCst) {
        let Some(open) = &mut socket else {
            socket = open_stream(&url, &id).await;
            seq = 0;
            tokio::time::sleep(Duration::from_millis(30)).await;
            continue;
        };
        seq += 1;
        let pose = turned(seq, 0.01 * (seq % 50) as f64, false);
        // One that says nothing for so long is looked for anew, as the clients do.
        match tokio::time::timeout(Duration::from_millis(1500), try_drag(open, pose)).await {
            Ok(Some(())) => {
                longest = longest.max(since.elapsed());
                since = Instant::now();
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            _ => socket = None,
        }
    }
    longest.max(since.elapsed())
}

/// Commits until it is told to stop, each under its key; the angles that were acknowledged.
async fn keep_committing(url: String, id: String, stop: Arc<AtomicBool>) -> Vec<f64> {
    let mut angles = Vec::new();
    while !stop.load(SeqCst) {
        let angle = 0.02 * ((angles.len() * 7) % 40) as f64 - 0.4;
        let key = format!("{id}-{}", angles.len());
        insist(&url, ("POST", &path(&id, "/solve")), Some(&turn_json(angle)), &key).await;
        angles.push(angle);
        tokio::time::sleep(Duration::from_millis(80)).await;
    }
    angles
}

/// The id of a session as gRPC tells it: the call goes where its session hashes to, and from there to the node that has it.
async fn told_by_grpc(url: &str, id: &str) -> String {
    let mut client = DeformerClient::connect(url.to_owned()).await.expect("a connection");
    let mut node = None;
    for _ in 0..4 {
        let mut request = tonic::Request::new(pb::SessionRequest { session_id: id.into() });
        request
            .metadata_mut()
            .insert("x-pliant-session", id.parse().expect("a value"));
        if let Some(node) = node {
            request.metadata_mut().insert("x-pliant-node", node);
        }
        match client.get_session(request).await {
            Ok(session) => return session.into_inner().id,
            Err(sent) => node = Some(sent.metadata().get("x-pliant-node").expect("a node").clone()),
        }
    }
    panic!("sent around");
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_outlive_their_nodes_behind_a_proxy() {
    let Some(place) = StorePlace::remote().await else {
        return;
    };
    let front = free_port();
    let own = [free_port(), free_port(), free_port()];
    let Some(_proxy) = proxy(&place, front, own) else {
        return;
    };
    let mut nodes: Vec<Option<ServedProgram>> = Vec::new();
    for (name, own) in NAMES.into_iter().zip(own) {
        nodes.push(Some(node(&place, (name, own), front)));
    }
    let url = format!("http://127.0.0.1:{front}");
    let mut ids = Vec::new();
    for k in 0..6 {
        let since = Instant::now();
        let session: Value = loop {
            let sent = http()
                .post(format!("{url}/v1/sessions"))
                .header("idempotency-key", format!("create-{k}"));
            match within("a session", sent.body(bar_obj(12)).send()).await {
                Ok(answer) if answer.status().is_success() => break answer.json().await.expect("JSON"),
                _ => assert!(since.elapsed() < Duration::from_secs(20), "no session"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        let id = session["id"].as_str().expect("an id").to_owned();
        insist(
            &url,
            ("PUT", &path(&id, "/handles")),
            Some(&json!({"handles": ends()})),
            &format!("hold-{k}"),
        )
        .await;
        ids.push(id);
    }
    for id in &ids {
        assert_eq!(told_by_grpc(&url, id).await, *id);
    }
    let stop = Arc::new(AtomicBool::new(false));
    let mut drags = Vec::new();
    let mut writers = Vec::new();
    for (k, id) in ids.iter().enumerate() {
        match k % 2 {
            0 => writers.push(tokio::spawn(keep_committing(
                url.clone(),
                id.clone(),
                Arc::clone(&stop),
            ))),
            _ => drags.push(tokio::spawn(keep_dragging(url.clone(), id.clone(), Arc::clone(&stop)))),
        }
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    nodes[0].take().expect("a node").kill();
    tokio::time::sleep(Duration::from_secs(3)).await;
    nodes[0] = Some(node(&place, (NAMES[0], own[0]), front));
    nodes[1].take().expect("a node").stop().await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    nodes[1] = Some(node(&place, (NAMES[1], own[1]), front));
    let stale = nodes[2].as_ref().expect("a node");
    signal(stale, "-STOP");
    tokio::time::sleep(LEASE * 3).await;
    signal(stale, "-CONT");
    tokio::time::sleep(Duration::from_secs(3)).await;
    stop.store(true, SeqCst);
    for dragged in drags {
        let longest = dragged.await.expect("no panic");
        assert!(longest < BACK, "a stream was away for {longest:?}");
    }
    let alone = StorePlace::folder().await.expect("a folder");
    let single = alone.start(&[]);
    for (written, id) in writers.into_iter().zip(ids.iter().step_by(2)) {
        let angles = written.await.expect("no panic");
        assert!(angles.len() > 10, "{} commits", angles.len());
        let history = insist(&url, ("GET", &path(id, "/history")), None, "").await;
        let reference = bar_session(&single).await;
        for angle in &angles {
            turn(&single, &reference, *angle).await;
        }
        let (_, expected, _) = seen(&single, &reference).await;
        assert_eq!(
            history, expected,
            "each acknowledged commit is there once, with the same digest"
        );
    }
}
