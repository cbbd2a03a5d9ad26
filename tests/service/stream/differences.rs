//! Streams that ask for what differs: the numbers are those of whole frames, whatever happens on the way.

use super::ack;
use crate::support::server::*;
use pliant::wire::frames::FrameReader;
use pliant::wire::pb::{self, deform_request, deform_response, frame};
use serde_json::json;
use tokio::sync::mpsc;
use tonic::{Code, Streaming};

/// Vertices of the bar of a test session.
const VERTICES: usize = 308;

/// Options that ask for an encoding.
fn asking(encoding: frame::Encoding, normals: bool) -> pb::Options {
    pb::Options {
        output: Some(pb::Output {
            encoding: encoding.into(),
            normals,
            ..Default::default()
        }),
        ..Default::default()
    }
}

/// A client that reads its frames.
struct Reading {
    requests: mpsc::Sender<pb::DeformRequest>,
    responses: Streaming<pb::DeformResponse>,
    reader: FrameReader,
}

impl Reading {
    async fn open(server: &Server, id: &str, options: pb::Options, vertices: usize) -> Self {
        let (requests, responses) = server.stream(id).await;
        let reading = Self {
            requests,
            responses,
            reader: FrameReader::new(vertices),
        };
        reading.ask(options).await;
        reading
    }

    async fn ask(&self, options: pb::Options) {
        let options = message(deform_request::Message::Options(options));
        self.requests.send(options).await.expect("an open stream");
    }

    /// Sends a pose, and reads up to its final frame; the parts of that.
    async fn pose(&mut self, seq: u64, angle: f64, commit: bool) -> Vec<pb::Frame> {
        let pose = message(deform_request::Message::Pose(turned(seq, angle, commit)));
        self.requests.send(pose).await.expect("an open stream");
        let mut parts = Vec::new();
        loop {
            let response = within("a response", self.responses.message())
                .await
                .expect("no failure");
            let Some(deform_response::Message::Frame(part)) = response.and_then(|r| r.message) else {
                panic!("a frame was expected")
            };
            let is_whole = self.reader.take(&part).expect("is read");
            parts.push(part);
            if is_whole {
                let acknowledged = message(ack(seq));
                self.requests.send(acknowledged).await.expect("an open stream");
                assert_eq!(parts[0].seq, seq);
                return parts;
            }
        }
    }
}

fn is_key(parts: &[pb::Frame]) -> bool {
    parts.iter().all(|part| part.encoding() != frame::Encoding::Delta)
}

/// How far two buffers are apart at most.
fn farthest(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| f64::from((a - b).abs()))
        .fold(0.0, f64::max)
}

/// Half a step of the box of a frame, and the rounding to 32 bits.
fn half_step(part: &pb::Frame) -> f64 {
    let extents = part.box_max.iter().zip(&part.box_min).map(|(high, low)| high - low);
    extents.fold(0.0, f64::max) / 65535.0 * 0.5 + 1e-6
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_differences_show_what_whole_frames_show() {
    let server = Server::with(|sessions, _| sessions.part_bytes = 1024).await;
    let (id, twin) = (server.bar_session().await, server.bar_session().await);
    let mut reply = Reading::open(&server, &id, asking(frame::Encoding::Delta, false), VERTICES).await;
    let mut whole = Reading::open(&server, &twin, asking(frame::Encoding::F32, false), VERTICES).await;
    let before = server.manager.ledger().used();
    let mut keys = Vec::new();
    for seq in 1..=24u64 {
        let normals = seq >= 9;
        match seq {
            // The same options again, as a client sends them that lacks the base of differences.
            5 => reply.ask(asking(frame::Encoding::Delta, false)).await,
            9 => {
                reply.ask(asking(frame::Encoding::Delta, true)).await;
                whole.ask(asking(frame::Encoding::F32, true)).await;
            }
            _ => {}
        }
        let (angle, commit) = (0.02 * seq as f64, seq % 8 == 0);
        let parts = reply.pose(seq, angle, commit).await;
        whole.pose(seq, angle, commit).await;
        assert!(parts.len() > 1, "frame {seq} comes in parts");
        assert!(
            parts
                .iter()
                .all(|part| part.number == seq && part.encoding() != frame::Encoding::F32)
        );
        if is_key(&parts) {
            keys.push(seq);
        }
        let seen = |reading: &Reading, attribute| reading.reader.numbers(attribute).to_vec();
        let position = frame::Attribute::Position;
        let apart = farthest(&seen(&reply, position), &seen(&whole, position));
        assert!(apart <= half_step(&parts[0]), "frame {seq}: {apart}");
        if normals {
            let apart = farthest(
                &seen(&reply, frame::Attribute::Normal),
                &seen(&whole, frame::Attribute::Normal),
            );
            assert!(apart <= 1.0 / 65535.0 + 1e-6, "normals of frame {seq}: {apart}");
        }
        let held = VERTICES as u64 * 8 * (1 + u64::from(normals));
        assert!(
            server.manager.ledger().used() >= before + held,
            "what the stream holds is counted"
        );
    }
    assert_eq!(keys, [1, 5, 9], "the first, options again, and normals too");
}

/// Frames of so many vertices are coded on threads beside those that serve connections.
#[tokio::test(flavor = "multi_thread")]
async fn large_frames_of_differences_show_what_whole_frames_show() {
    let server = Server::with(|sessions, _| sessions.part_bytes = 16 << 10).await;
    let mut opened = Vec::new();
    for encoding in [frame::Encoding::Delta, frame::Encoding::F32] {
        let session = server.open(bar([12, 12, 100])).await;
        let id = text(&session["id"]);
        server.hold_ends(&id).await;
        let vertices = session["model"]["vertices"].as_u64().expect("a number") as usize;
        assert!(vertices > 4096);
        opened.push(Reading::open(&server, &id, asking(encoding, true), vertices).await);
    }
    let [reply, whole] = &mut opened[..] else {
        panic!("two streams")
    };
    for seq in 1..=6 {
        let parts = reply.pose(seq, 0.05 * seq as f64, false).await;
        whole.pose(seq, 0.05 * seq as f64, false).await;
        assert_eq!((parts.len() > 4, is_key(&parts)), (true, seq == 1), "frame {seq}");
        let seen = |reading: &Reading| reading.reader.numbers(frame::Attribute::Position).to_vec();
        let apart = farthest(&seen(reply), &seen(whole));
        assert!(apart <= half_step(&parts[0]), "frame {seq}: {apart}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_begins_with_a_key_frame_and_another_stream_with_its_own() {
    let (server, id) = Server::start_with_bar().await;
    let mut reply = Reading::open(&server, &id, asking(frame::Encoding::Delta, false), VERTICES).await;
    assert!(is_key(&reply.pose(1, 0.1, false).await));
    assert!(!is_key(&reply.pose(2, 0.11, false).await));
    let mut other = Reading::open(&server, &id, asking(frame::Encoding::Delta, false), VERTICES).await;
    assert!(is_key(&other.pose(1, 0.1, false).await), "it holds nothing yet");
    drop(other);
    let edit = |body| {
        let url = server.url(&path(&id, "/edits"));
        http().post(url).json(&body).send()
    };
    let cut = json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 0.1}, "keep": "ABOVE", "fill": true}});
    let answer = edit(cut).await.expect("an answer");
    assert_eq!(answer.status(), 200, "{}", answer.text().await.unwrap());
    let session = server.get(&format!("/v1/sessions/{id}")).document().await;
    let left = session["model"]["vertices"].as_u64().expect("a number") as usize;
    assert_ne!(left, VERTICES);
    reply.reader = FrameReader::new(left);
    assert!(is_key(&reply.pose(3, 0.12, false).await), "after an edit");
    assert!(!is_key(&reply.pose(4, 0.13, false).await));
    assert_eq!(reply.reader.numbers(frame::Attribute::Position).len(), left * 3);
}

/// What is skipped was never a base: differences are formed when a frame is sent.
#[tokio::test(flavor = "multi_thread")]
async fn a_websocket_reader_that_stops_reads_on_without_a_gap() {
    let (server, id) = Server::start_with_bar().await;
    let mut socket = server.stream_socket(&id).await;
    let options = asking(frame::Encoding::Delta, false);
    socket.send(deform_request::Message::Options(options)).await;
    for seq in 1..=500u64 {
        let pose = turned(seq, seq as f64 * 0.0005, false);
        socket.send(deform_request::Message::Pose(pose)).await;
    }
    eventually("the poses have arrived", async || {
        server.metric("pliant_poses_received_total").await == 500.0
    })
    .await;
    let (mut reader, mut skipped, mut keys) = (FrameReader::new(VERTICES), 0, 0);
    let last = loop {
        let Some(deform_response::Message::Frame(part)) = socket.response().await else {
            panic!("a frame was expected")
        };
        assert!(reader.take(&part).expect("is read"), "one part");
        skipped += part.superseded;
        keys += u32::from(part.encoding() != frame::Encoding::Delta);
        socket.send(ack(part.seq)).await;
        if part.seq == 500 {
            break part;
        }
    };
    assert!(
        skipped > 0 && keys == 1,
        "{skipped} poses were skipped, {keys} key frames came"
    );
    let twin = server.bar_session().await;
    let mut whole = Reading::open(&server, &twin, asking(frame::Encoding::F32, false), VERTICES).await;
    whole.pose(1, 0.25, false).await;
    let position = frame::Attribute::Position;
    let apart = farthest(reader.numbers(position), whole.reader.numbers(position));
    // Two drags to one pose come to it by different ways, to their tolerance.
    assert!(apart <= half_step(&last) + 1e-3, "{apart}");
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_that_answer_one_frame_answer_a_key_frame() {
    let (server, id) = Server::start_with_bar().await;
    let mut client = server.grpc().await;
    let solve = pb::SolveRequest {
        options: Some(asking(frame::Encoding::Delta, false)),
        ..turn_request(&id, 1, 0.5)
    };
    let mut parts = client.solve(solve).await.expect("a frame").into_inner();
    let mut reader = FrameReader::new(VERTICES);
    while let Some(part) = parts.message().await.expect("a part") {
        assert_eq!((part.encoding(), part.number), (frame::Encoding::Meshopt, 1));
        reader.take(&part).expect("is read");
    }
    assert_eq!(reader.numbers(frame::Attribute::Position).len(), VERTICES * 3);

    let url = server.url(&path(&id, "/solve"));
    let asked = json!({"options": {"output": {"encoding": "DELTA"}}});
    let answer = http().post(&url).json(&asked).document().await;
    assert_eq!(
        (&answer["frames"][0]["encoding"], &answer["frames"][0]["number"]),
        (&json!("MESHOPT"), &json!("1"))
    );
    let buffer = http()
        .post(&url)
        .json(&asked)
        .header("accept", "application/octet-stream");
    assert_eq!(buffer.status().await, 422, "floats alone come as a buffer");
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_and_differences_together_are_refused() {
    let (server, id) = Server::start_with_bar().await;
    let both = || {
        let mut options = asking(frame::Encoding::Delta, false);
        options.output.as_mut().expect("some").changed_only = Some(0.0);
        options
    };
    let (requests, mut responses) = server.stream(&id).await;
    let options = message(deform_request::Message::Options(both()));
    requests.send(options).await.unwrap();
    let response = within("a response", responses.message()).await.unwrap();
    let Some(deform_response::Message::Error(error)) = response.and_then(|r| r.message) else {
        panic!("no error")
    };
    assert_eq!((error.seq, error.code), (0, 3));
    let reply = ["options.output.changedOnly", "DELTA", "next to nothing", "MESHOPT"];
    assert!(
        reply.iter().all(|word| error.message.contains(word)),
        "{}",
        error.message
    );
    let ended = within("the end", responses.message()).await.expect_err("an end");
    assert_eq!(ended.code(), Code::InvalidArgument);

    let solve = pb::SolveRequest {
        options: Some(both()),
        ..turn_request(&id, 1, 0.5)
    };
    let refused = server.grpc().await.solve(solve).await.expect_err("refused");
    assert_eq!(refused.code(), Code::InvalidArgument);
    let asked = json!({"options": {"output": {"encoding": "DELTA", "changedOnly": 0}}});
    let url = server.url(&path(&id, "/solve"));
    let answer = http().post(&url).json(&asked).answer().await;
    assert_eq!(answer.status(), 422);
    assert!(answer.text().await.unwrap().contains("options.output.changedOnly"));
}
