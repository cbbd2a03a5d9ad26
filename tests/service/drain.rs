//! Ends: of the server, with streams, silent connections and work under way; and of work whose client is gone.

use crate::support::server::*;
use pliant::wire::pb::{self, deform_request, deform_response};
use serde_json::Value;
use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tonic::Code;
use tonic_health::pb::health_check_response::ServingStatus;

async fn open(server: &Server, id: &str) -> (mpsc::Sender<pb::DeformRequest>, tonic::Streaming<pb::DeformResponse>) {
    let (requests, mut responses) = server.stream(id).await;
    // A first frame shows that the stream is open on the session.
    let pose = deform_request::Message::Pose(turned(1, 0.1, false));
    requests.send(message(pose)).await.unwrap();
    within("a first frame", responses.message())
        .await
        .unwrap()
        .expect("a frame");
    (requests, responses)
}

fn is_notice(response: &pb::DeformResponse) -> bool {
    matches!(&response.message, Some(deform_response::Message::Notice(notice)) if notice.code == "going-away")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drain_ends_as_soon_as_the_streams_have_left() {
    let mut server = Server::with(|_, config| config.drain_deadline = Duration::from_secs(50)).await;
    let id = server.bar_session().await;
    let _silent = TcpStream::connect(server.address).await.unwrap();
    let (requests, mut responses) = open(&server, &id).await;
    let mut socket = server.stream_socket(&id).await;
    // Both are really open before the end begins.
    eventually("two streams", async || server.metric("pliant_streams").await == 2.0).await;

    // One who watches the server's health stays to the end and must not put it off.
    let mut health = tonic_health::pb::health_client::HealthClient::new(server.channel().await);
    let check = || tonic_health::pb::HealthCheckRequest {
        service: "pliant.v1.Deformer".into(),
    };
    let mut watched = health.watch(check()).await.unwrap().into_inner();
    assert_eq!(
        watched.message().await.unwrap().unwrap().status(),
        ServingStatus::Serving
    );

    server.ask_to_stop();
    let reply = within("the notice", async {
        loop {
            let response = responses.message().await.unwrap().expect("an open stream");
            if is_notice(&response) {
                break response;
            }
        }
    })
    .await;
    let Some(deform_response::Message::Notice(notice)) = reply.message else {
        unreachable!()
    };
    assert_eq!(notice.resume_token, id);
    loop {
        if let Came::Response(response) = socket.next().await
            && is_notice(&response)
        {
            break;
        }
    }

    // Meanwhile the server says that it is leaving, and takes nothing new.
    let ready = server.get("/readyz").answer().await;
    assert_eq!(ready.status(), 503);
    assert!(ready.headers().contains_key("retry-after"));
    assert_eq!(server.get("/healthz").status().await, 200);
    let refused = server.post("/v1/sessions").body(bar_obj(4)).answer().await;
    assert_eq!(refused.status(), 503);
    assert_eq!(refused.json::<Value>().await.unwrap()["code"], "UNAVAILABLE");
    let mut client = server.grpc().await;
    assert_eq!(
        client.solve(turn_request(&id, 1, 0.1)).await.unwrap_err().code(),
        Code::Unavailable
    );
    assert_eq!(
        health.check(check()).await.unwrap().into_inner().status(),
        ServingStatus::NotServing
    );
    assert_eq!(
        within("the change of health", watched.message())
            .await
            .unwrap()
            .unwrap()
            .status(),
        ServingStatus::NotServing
    );

    // A last pose is still answered; then both leave, and nothing holds the end up any more.
    let last = deform_request::Message::Pose(turned(2, 0.2, true));
    requests.send(message(last)).await.unwrap();
    drop(requests);
    let mut answered = false;
    while let Some(response) = within("the last frame", responses.message()).await.unwrap() {
        answered |= matches!(&response.message, Some(deform_response::Message::Frame(frame)) if frame.seq == 2 && frame.r#final);
    }
    assert!(answered);
    drop(socket);
    let took = server.stopped().await;
    assert!(
        took < Duration::from_secs(40),
        "the deadline was not needed, yet it took {took:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_leave_is_cut_at_the_deadline() {
    let mut server = Server::with(|_, config| config.drain_deadline = Duration::from_secs(1)).await;
    let id = server.bar_session().await;
    let _silent = TcpStream::connect(server.address).await.unwrap();
    let (_requests, mut responses) = open(&server, &id).await;
    let mut socket = server.stream_socket(&id).await;
    eventually("two streams", async || server.metric("pliant_streams").await == 2.0).await;
    let asked = Instant::now();
    server.ask_to_stop();
    let cut = within("the end of the stream", async {
        loop {
            match responses.message().await {
                Ok(Some(_)) => {}
                Ok(None) => panic!("a cut stream must not look finished"),
                Err(status) => break status,
            }
        }
    })
    .await;
    assert_eq!(cut.code(), Code::Unavailable, "{cut}");
    let code = loop {
        if let Came::Closed(frame) = socket.next().await {
            break frame.map(|(code, _)| code);
        }
    };
    assert!(matches!(code, Some(1001 | 4014)), "{code:?}");
    server.stopped().await;
    // Not a measure of speed: without the deadline it would never have come to an end.
    assert!(asked.elapsed() < Duration::from_secs(30), "{:?}", asked.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn work_under_way_is_finished_before_the_end() {
    let mut server = Server::with(|_, config| config.drain_deadline = Duration::from_secs(50)).await;
    let url = server.url("/v1/sessions?label=late");
    let create = tokio::spawn(async move { http().post(url).body(large_bar()).send().await });
    eventually("work under way", async || {
        server.manager.metrics().pool_busy.get() > 0 || create.is_finished()
    })
    .await;
    server.ask_to_stop();
    let answer = within("the answer", create).await.unwrap().expect("an answer");
    assert_eq!(answer.status(), 201);
    server.stopped().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn work_whose_client_is_gone_is_given_up() {
    let (server, id) = Server::bar_with(|sessions, _| sessions.compute_slots = 1).await;
    let url = server.url("/v1/sessions");
    let create = tokio::spawn(async move { http().post(url).body(large_bar()).send().await });
    let busy = || server.manager.metrics().pool_busy.get() > 0;
    eventually("work under way", async || busy() || create.is_finished()).await;
    create.abort();
    eventually("a free slot", async || !busy()).await;
    assert_eq!(
        server.manager.metrics().sessions.get(),
        1,
        "nothing exists of what nobody waited for"
    );
    let solved = server.post(&path(&id, "/solve")).json(&turn_json(0.1)).answer().await;
    assert_eq!(solved.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_is_dropped_mid_solve_frees_its_slot() {
    let server = Server::with(|sessions, _| sessions.compute_slots = 1).await;
    let id = text(&server.open(large_bar()).await["id"]);
    server.hold_ends(&id).await;
    let mut socket = server.stream_socket(&id).await;
    for seq in 1..=20 {
        socket
            .send(deform_request::Message::Pose(turned(seq, seq as f64 * 0.3, false)))
            .await;
    }
    eventually("a solve", async || server.manager.metrics().poses_received.get() > 0).await;
    drop(socket);
    eventually("free places", async || {
        let metrics = server.manager.metrics();
        metrics.pool_busy.get() == 0 && metrics.pool_waiting.get() == 0 && metrics.streams.get() == 0
    })
    .await;
    let other = server.bar_session().await;
    let solve = server.post(&path(&other, "/solve")).json(&turn_json(0.1));
    assert_eq!(solve.status().await, 200);
}

/// A process that is killed when a test fails.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn serve(arguments: &[&str]) -> Process {
    let child = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .arg("serve")
        .args(arguments)
        .env_remove("PLIANT_CONFIG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    Process(child)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_program_listens_serves_and_ends_well_on_sigterm() {
    let mut process = serve(&["--listen", "127.0.0.1:0", "--drain-deadline", "2s", "--threads", "1"]);
    let mut line = String::new();
    BufReader::new(process.0.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let url = line
        .trim()
        .strip_prefix("listening on ")
        .expect("the line that scripts wait for")
        .to_owned();
    let answer = http().get(format!("{url}/readyz")).answer().await;
    assert_eq!(answer.status(), 200);
    let _silent = std::net::TcpStream::connect(url.strip_prefix("http://").unwrap()).unwrap();
    let killed = Command::new("kill")
        .args(["-TERM", &process.0.id().to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    let status = within("the end", tokio::task::spawn_blocking(move || process.0.wait()))
        .await
        .unwrap()
        .unwrap();
    assert_eq!(status.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_configuration_is_reported_in_the_last_line() {
    let cases: [(&[&str], &[&str]); 3] = [
        (&["--upload-bytes", "much"], &["upload_bytes", "much", "--upload-bytes"]),
        (&["--listen", "256.0.0.1:1"], &["listen", "256.0.0.1:1"]),
        (&["--config", "/nowhere/at/all.toml"], &["/nowhere/at/all.toml"]),
    ];
    for (arguments, words) in cases {
        let mut process = serve(arguments);
        let status = process.0.wait().unwrap();
        assert_eq!(status.code(), Some(2), "{arguments:?}");
        let mut reply = String::new();
        process.0.stderr.take().unwrap().read_to_string(&mut reply).unwrap();
        let last = reply.lines().last().unwrap_or_default();
        for word in words {
            assert!(last.contains(word), "{last:?} lacks {word:?}");
        }
    }
}
