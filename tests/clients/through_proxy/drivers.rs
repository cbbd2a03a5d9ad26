//! A program that drives sessions with one of the clients, for as long as its input is open.

use super::Driven;
use crate::node::build_typescript;
use crate::support::process::{root, show};
use crate::support::server::{HANG, Socket, bar_obj, ends, http, pace, retried, turn_json, turned, within};
use crate::workflows::program_of_package;
use futures::{SinkExt as _, StreamExt as _};
use pliant::wire::pb::{self, deform_request, deform_response};
use prost::Message as _;
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::Message;

/// A running program. Dropping it kills it.
pub(super) struct Driver {
    name: &'static str,
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<BufReader<ChildStdout>>,
    log: PathBuf,
}

/// What the Python client needs, by its own words.
fn python_needs() -> Vec<String> {
    let project = fs::read_to_string(root().join("proto/clients/python/pyproject.toml")).expect("a project");
    let (_, listed) = project.split_once("\ndependencies = [").expect("a list");
    let (listed, _) = listed.split_once(']').expect("its end");
    listed.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

impl Driver {
    /// The Python client; `None` where Python or its packages cannot be had.
    pub(super) fn python(url: &str, folder: &Path, sessions: usize) -> Option<Self> {
        let needs = python_needs();
        let needs: Vec<&str> = needs.iter().map(String::as_str).collect();
        let mut command = Command::new(program_of_package("python-client-needs", &needs, "python")?);
        command
            .arg(root().join("tests/clients/through_proxy/drive.py"))
            .env("PYTHONPATH", root().join("proto/clients/python"))
            .env("PYTHONDONTWRITEBYTECODE", "1");
        Some(Self::start("Python", command, (url, folder, sessions)))
    }

    /// The TypeScript client; `None` where node or its packages cannot be had.
    pub(super) fn typescript(url: &str, folder: &Path, sessions: usize) -> Option<Self> {
        let _held = crate::hold_typescript_package();
        if let Err(reason) = build_typescript() {
            show(&format!("SKIPPED: sessions of the TypeScript client: {reason}"));
            return None;
        }
        let mut command = Command::new("node");
        command.arg(root().join("tests/clients/through_proxy/drive.mjs"));
        Some(Self::start("TypeScript", command, (url, folder, sessions)))
    }

    /// Starts a program, and waits until all of its sessions are open.
    fn start(name: &'static str, mut command: Command, (url, folder, sessions): (&str, &Path, usize)) -> Self {
        let model = folder.join("bar.obj");
        fs::write(&model, bar_obj(12)).expect("written");
        let log = folder.join(name);
        let mut child = command
            .args([url, model.to_str().expect("UTF-8"), &sessions.to_string()])
            .env_remove("PLIANT_TOKEN")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(File::create(&log).expect("a log"))
            .spawn()
            .expect("it starts");
        let mut driver = Self {
            name,
            stdin: child.stdin.take(),
            stdout: child.stdout.take().map(BufReader::new),
            child,
            log,
        };
        let mut line = String::new();
        let read = driver.stdout.as_mut().expect("piped").read_line(&mut line);
        read.expect("a line");
        assert_eq!(line, "ready\n", "{name}: {}", driver.said());
        driver
    }

    fn said(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Ends it; its name, and what came back.
    pub(super) fn finish(mut self) -> (&'static str, Vec<Driven>) {
        drop(self.stdin.take());
        let (said, heard) = mpsc::channel();
        let mut stdout = self.stdout.take().expect("piped");
        std::thread::spawn(move || {
            let mut reply = String::new();
            let read = stdout.read_to_string(&mut reply).map(|_| reply);
            drop(said.send(read));
        });
        let reply = heard
            .recv_timeout(HANG)
            .unwrap_or_else(|_| panic!("{} does not end: {}", self.name, self.said()))
            .expect("UTF-8");
        let status = self.child.wait().expect("it ends");
        assert!(status.success(), "{}: {status}: {}", self.name, self.said());
        let driven = serde_json::from_str(&reply).unwrap_or_else(|e| panic!("{}: {e}: {reply}", self.name));
        (self.name, driven)
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

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
            let reported = (url.to_owned(), id.clone(), Arc::clone(&own.stop));
            own.drags.push(tokio::spawn(keep_dragging(reported.clone())));
            own.commits.push(tokio::spawn(keep_committing(reported)));
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
    let reported = tokio::time::timeout(Duration::from_secs(1), asked).await.ok()?.ok()?;
    let node = reported
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

/// Drags until it is asked to stop.
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
        // One that says nothing for so long is looked for again, as the clients do.
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

/// Commits until it is asked to stop, each under its key; what was acknowledged.
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
