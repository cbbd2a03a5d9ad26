//! The deform stream, over gRPC and over a WebSocket: what is counted, what a slow reader costs, how it ends.

mod differences;
mod sockets;

use crate::support::data::{data_folder, report_skipped};
use crate::support::process::needed;
use crate::support::process::{memory, runs_alone};
use crate::support::server::*;
use pliant::wire::pb::{self, deform_request, deform_response};
use serde_json::json;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_tungstenite::tungstenite;
use tonic::Code;

/// What a stream's client writes down.
#[derive(Debug, Default)]
struct Books {
    finals: u64,
    errors: u64,
    superseded: u64,
    seqs: Vec<u64>,
    last: Vec<f32>,
    notices: Vec<String>,
    parts: BTreeMap<u64, u32>,
}

impl Books {
    /// Enters a response; the sequence number to acknowledge when it completes a frame.
    fn enter(&mut self, response: &pb::DeformResponse) -> Option<u64> {
        match response.message.as_ref()? {
            deform_response::Message::Frame(frame) => {
                let seen = self.parts.entry(frame.seq).or_default();
                *seen += 1;
                if frame.part == 0 {
                    self.superseded += u64::from(frame.superseded);
                }
                if frame.part + 1 < frame.parts {
                    return None;
                }
                assert!(*seen >= frame.parts, "every part of frame {} came", frame.seq);
                if frame.r#final {
                    self.finals += 1;
                    self.seqs.push(frame.seq);
                    self.last = floats(&frame.data);
                }
                Some(frame.seq)
            }
            deform_response::Message::Error(error) => {
                assert_ne!(error.seq, 0, "the stream failed: {error:?}");
                self.errors += 1;
                None
            }
            deform_response::Message::Notice(notice) => {
                self.notices.push(notice.code.clone());
                None
            }
            deform_response::Message::Pong(_) => None,
        }
    }

    /// Reads and acknowledges frames up to the final one of a pose.
    async fn read_to(
        &mut self,
        last: u64,
        requests: &mpsc::Sender<pb::DeformRequest>,
        responses: &mut tonic::Streaming<pb::DeformResponse>,
    ) {
        while self.seqs.last() != Some(&last) {
            let response = within("a response", responses.message()).await.unwrap();
            if let Some(seq) = self.enter(&response.expect("an open stream")) {
                requests.send(message(ack(seq))).await.unwrap();
            }
        }
    }

    /// As `read_to`, over a WebSocket.
    async fn read_socket_to(&mut self, last: u64, socket: &mut Socket) {
        while self.seqs.last() != Some(&last) {
            let Came::Response(response) = socket.next().await else {
                panic!("closed")
            };
            if let Some(seq) = self.enter(&response) {
                socket.send(ack(seq)).await;
            }
        }
    }

    fn total(&self) -> u64 {
        self.finals + self.errors + self.superseded
    }
}

fn ack(seq: u64) -> deform_request::Message {
    deform_request::Message::Ack(pb::Ack { seq })
}

/// The answer of HTTP to who is given no WebSocket.
async fn refused_socket(server: &Server, id: &str) -> tungstenite::handshake::client::Response {
    match server.socket(&path(id, "/stream")).await {
        Err(tungstenite::Error::Http(refused)) => *refused,
        Err(other) => panic!("no HTTP answer, but {other}"),
        Ok(_) => panic!("a WebSocket"),
    }
}

const POSES: u64 = 200;

#[tokio::test(flavor = "multi_thread")]
async fn every_pose_at_60_hz_is_accounted_for_over_grpc() {
    let (server, id) = Server::start_with_bar().await;
    drag_at_60_hz(&server, &id).await;
}

/// The paper's kind of model, 43 K vertices with a volume graph: a solve takes longer than the time between two poses.
#[tokio::test(flavor = "multi_thread")]
async fn a_scan_at_60_hz_ends_with_the_last_pose_and_holds_no_growing_memory() {
    if !runs_alone("stream::a_scan_at_60_hz_ends_with_the_last_pose_and_holds_no_growing_memory") {
        return;
    }
    let data = needed!(data_folder("the stream on armadillo.obj"));
    let Ok(model) = std::fs::read_to_string(data.join("meshes/armadillo.obj")) else {
        report_skipped("the stream on armadillo.obj", "it is not in the data folder");
        return;
    };
    let server = Server::start().await;
    let session = server.open(model).await;
    let id = text(&session["id"]);
    let handles = json!({"handles": [
        {"id": "legs", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": 0.05}}},
        {"id": "top", "region": {"box": {"min": [-1, 0.05, -1], "max": [-0.33, 1, 1]}}},
    ]});
    let answer = server.put(&path(&id, "/handles")).json(&handles).answer().await;
    assert_eq!(answer.status(), 200, "{}", answer.text().await.unwrap());
    let before = memory();
    let books = drag_at_60_hz(&server, &id).await;
    let grown = memory().saturating_sub(before);
    println!(
        "{} frames, {} superseded; memory grew by {} MiB",
        books.finals,
        books.superseded,
        grown >> 20
    );
    assert!(grown < 256 << 20, "memory grew by {grown} bytes");
}

/// Sends the poses, acknowledges every frame, and checks that everything was counted.
async fn drag_at_60_hz(server: &Server, id: &str) -> Books {
    let (requests, mut responses) = server.stream(id).await;
    let sender = requests.clone();
    let dragging = tokio::spawn(async move {
        let mut tick = tokio::time::interval(Duration::from_micros(16_667));
        for seq in 1..=POSES {
            tick.tick().await;
            sender
                .send(turned_request(seq, seq as f64 * 0.005, false))
                .await
                .unwrap();
        }
    });
    let mut books = Books::default();
    books.read_to(POSES, &requests, &mut responses).await;
    dragging.await.unwrap();
    assert_eq!(books.total(), POSES, "{books:?}");
    assert_eq!(books.errors, 0);
    assert!(books.seqs.is_sorted(), "frames come in the order of their poses");
    drop(requests);
    assert!(
        within("the end", responses.message()).await.unwrap().is_none(),
        "a half-closed stream ends well"
    );
    eventually("the stream's place", async || {
        server.metric("pliant_streams").await == 0.0
    })
    .await;
    assert_eq!(server.metric("pliant_poses_received_total").await, POSES as f64);
    books
}

#[tokio::test(flavor = "multi_thread")]
async fn every_pose_at_60_hz_is_accounted_for_over_a_websocket() {
    let (server, id) = Server::start_with_bar().await;
    let mut socket = server.stream_socket(&id).await;
    let mut books = Books::default();
    let mut tick = tokio::time::interval(Duration::from_micros(16_667));
    let mut next = 1;
    while books.seqs.last() != Some(&POSES) {
        tokio::select! {
            _ = tick.tick(), if next <= POSES => {
                socket.send(deform_request::Message::Pose(turned(next, next as f64 * 0.005, false))).await;
                next += 1;
            }
            came = socket.next() => match came {
                Came::Response(response) => {
                    if let Some(seq) = books.enter(&response) {
                        socket.send(ack(seq)).await;
                    }
                }
                Came::Closed(frame) => panic!("closed: {frame:?}"),
            },
        }
    }
    assert_eq!(books.total(), POSES, "{books:?}");
    drop(socket);
    eventually("the stream's place", async || {
        server.metric("pliant_streams").await == 0.0
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_only_half_closes_still_gets_its_last_frame() {
    let (server, id) = Server::start_with_bar().await;
    let (requests, mut responses) = server.stream(&id).await;
    requests.send(turned_request(9, 0.3, false)).await.unwrap();
    drop(requests);
    let mut books = Books::default();
    while let Some(response) = within("a response", responses.message()).await.unwrap() {
        books.enter(&response);
    }
    assert_eq!(books.seqs, [9]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_committed_pose_equals_a_solve_call_to_the_bit() {
    let (server, id) = Server::start_with_bar().await;
    let (requests, mut responses) = server.stream(&id).await;
    for seq in 1..=5 {
        requests
            .send(turned_request(seq, 0.1 * seq as f64, seq == 5))
            .await
            .unwrap();
    }
    let mut books = Books::default();
    books.read_to(5, &requests, &mut responses).await;
    let stored = server.content(&path(&id, "/positions")).await;
    assert_eq!(floats(&stored), books.last, "what was acknowledged is what is stored");
    let twin = server.bar_session().await;
    let solve = server
        .post(&path(&twin, "/solve"))
        .json(&turn_json(0.5))
        .header("accept", "application/octet-stream");
    assert_eq!(solve.answer().await.bytes().await.unwrap(), stored);
}

/// A reader that stops: few frames are made for it, memory stays flat, and when it reads on it gets the newest pose.
#[tokio::test(flavor = "multi_thread")]
async fn a_reader_that_stops_gets_fewer_frames_not_older_ones() {
    if !runs_alone("stream::a_reader_that_stops_gets_fewer_frames_not_older_ones") {
        return;
    }
    let (server, id) = Server::start_with_bar().await;
    let (requests, mut responses) = server.stream(&id).await;
    let before = memory();
    for seq in 1..=2000u64 {
        requests
            .send(turned_request(seq, seq as f64 * 0.0005, false))
            .await
            .unwrap();
    }
    eventually("the poses have arrived", async || {
        server.metric("pliant_poses_received_total").await == 2000.0
    })
    .await;
    let solved = server.metric("pliant_frames_sent_total").await;
    assert!(solved <= 10.0, "{solved} frames for a reader that acknowledged none");
    let grown = memory().saturating_sub(before);
    assert!(grown < 256 << 20, "{grown} bytes more");
    let mut books = Books::default();
    books.read_to(2000, &requests, &mut responses).await;
    assert_eq!(books.total(), 2000);
    assert!(books.finals < 100, "{} frames", books.finals);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_websocket_reader_that_stops_costs_no_growing_memory() {
    let (server, id) = Server::start_with_bar().await;
    let mut socket = server.stream_socket(&id).await;
    for seq in 1..=2000u64 {
        socket
            .send(deform_request::Message::Pose(turned(seq, seq as f64 * 0.0005, false)))
            .await;
    }
    eventually("the poses have arrived", async || {
        server.metric("pliant_poses_received_total").await == 2000.0
    })
    .await;
    assert!(server.metric("pliant_frames_sent_total").await <= 10.0);
    let mut books = Books::default();
    books.read_socket_to(2000, &mut socket).await;
    assert_eq!(books.total(), 2000);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_belongs_to_one_session_that_exists() {
    let (server, id) = Server::start_with_bar().await;
    let (_requests, mut responses) = server.stream("nobody").await;
    let refused = within("a refusal", responses.message()).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound);
    let (requests, mut responses) = server.stream(&id).await;
    requests
        .send(pb::DeformRequest {
            session_id: "another".into(),
            message: None,
        })
        .await
        .unwrap();
    let refused = within("a refusal", responses.message()).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);

    assert_eq!(refused_socket(&server, "nobody").await.status(), 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_never_names_a_session_is_not_waited_for() {
    let server = Server::with(|_, config| config.header_timeout = Duration::from_millis(200)).await;
    let mut client = server.grpc().await;
    let (_requests, waiting) = mpsc::channel(1);
    let mut responses = client.deform(ReceiverStream::new(waiting)).await.unwrap().into_inner();
    let refused = within("a refusal", responses.message()).await.unwrap_err();
    assert_eq!(refused.code(), Code::DeadlineExceeded, "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn large_frames_come_in_parts_that_fit_default_limits() {
    let (server, id) = Server::bar_with(|sessions, _| sessions.part_bytes = 1024).await;
    let mut client = server.grpc().await;
    let solve = turn_request(&id, 1, 0.5);
    let mut parts = Vec::new();
    let mut stream = client.solve(solve).await.unwrap().into_inner();
    while let Some(frame) = stream.message().await.unwrap() {
        parts.push(frame);
    }
    let count = parts.len() as u32;
    assert!(count > 1);
    let mut next_vertex = 0;
    for (k, part) in parts.iter().enumerate() {
        assert_eq!(
            (part.part, part.parts, part.first_vertex),
            (k as u32, count, next_vertex)
        );
        assert!(part.data.len() <= 1024);
        next_vertex += part.vertex_count;
    }
    let whole: Vec<u8> = parts.iter().flat_map(|p| p.data.to_vec()).collect();
    assert_eq!(server.content(&path(&id, "/positions")).await, whole);
    let body = json!({"options": {"output": {"normals": true}}});
    let answer = server
        .post(&path(&id, "/solve"))
        .header("accept", "application/octet-stream")
        .json(&body)
        .send();
    assert_eq!(
        answer.await.unwrap().bytes().await.unwrap().len(),
        whole.len() * 2,
        "blocks of positions, then normals"
    );
}
