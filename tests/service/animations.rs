//! Animations from a server: their frames, where they go on, what they leave alone, and how they end.

mod calls;
mod endings;
mod refusals;

use crate::support::server::*;
use bytes::Bytes;
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::pb::{self, animate_options::Source, animate_request::Message};
use serde_json::{Value, json};
use std::fmt::Write as _;
use tokio::sync::mpsc;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::transport::Channel;

/// A clip of so many frames that bends the upper half of the bar and turns and carries the whole.
pub(crate) fn bending_clip(frames: usize) -> String {
    let mut clip = String::from(
        "HIERARCHY\nROOT low\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
         JOINT high\n{\nOFFSET 0 0 2\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 0 2\n}\n}\n}\nMOTION\n",
    );
    writeln!(clip, "Frames: {frames}\nFrame Time: 0.05").expect("text");
    for k in 0..frames {
        let (k, wave) = (k as f64, (k as f64 * 0.1).sin());
        writeln!(clip, "{} {} 0 {} 0 0 0 {} 0", 0.01 * k, 0.02 * k, 0.5 * k, 40.0 * wave).expect("text");
    }
    clip
}

/// A clip of three frames in which a body of usual names lifts its left arm.
fn waving_clip() -> String {
    let mut clip = String::from("HIERARCHY\nROOT Hips\n{\nOFFSET 0 95 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n");
    // Each chain of joints hangs on the hips or, for arms and head, on the spine; braces that end it follow its name.
    let joints = [
        ("Spine", "0 30 0", 0),
        ("Head", "0 30 0", 1),
        ("LeftArm", "18 15 0", 0),
        ("LeftForeArm", "27 0 0", 0),
        ("LeftHand", "25 0 0", 3),
        ("RightArm", "-18 15 0", 0),
        ("RightForeArm", "-27 0 0", 0),
        ("RightHand", "-25 0 0", 4),
        ("LeftUpLeg", "9 -5 0", 0),
        ("LeftLeg", "0 -42 0", 2),
        ("RightUpLeg", "-9 -5 0", 0),
        ("RightLeg", "0 -42 0", 2),
    ];
    for (name, offset, ended) in joints {
        let channels = if name == "LeftArm" { "1 Zrotation" } else { "0" };
        write!(clip, "JOINT {name}\n{{\nOFFSET {offset}\nCHANNELS {channels}\n").expect("text");
        if ended > 0 {
            write!(clip, "End Site\n{{\nOFFSET {offset}\n}}\n{}", "}\n".repeat(ended)).expect("text");
        }
    }
    clip + "}\nMOTION\nFrames: 3\nFrame Time: 0.1\n0 0 0 0\n0 0 5 30\n0 0 10 60\n"
}

/// The rig that goes with the bar, in JSON.
pub(crate) fn bar_rig() -> Value {
    json!({
        "version": 1,
        "joints": {"bottom": [0.25, 0.25, 0.1], "middle": [0.25, 0.25, 2], "top": [0.25, 0.25, 3.9]},
        "bones": [
            {"id": "low", "from": "bottom", "to": "middle", "joint": "low", "rest": "ORIENTATION", "radius": 0.3},
            {"id": "high", "from": "middle", "to": "top", "parent": "low", "joint": "high", "rest": "ORIENTATION", "radius": 0.3}
        ]
    })
}

/// Options that drive the session's bar by a clip.
fn bar_options(id: &str, clip: &str) -> pb::AnimateOptions {
    let text = json!({"sessionId": id, "rig": bar_rig(), "skipFirst": "NO"}).to_string();
    let options = pliant::wire::animate_options_from_json(text.as_bytes()).expect("options");
    pb::AnimateOptions {
        source: Some(Source::Bvh(Bytes::copy_from_slice(clip.as_bytes()))),
        ..options
    }
}

/// A whole frame of an animation.
#[derive(Debug, Clone, PartialEq)]
struct WholeFrame {
    reply: pb::Animated,
    quality: Option<pb::Quality>,
    seq: u64,
    data: Vec<u8>,
}

/// The client's side of an animation.
struct Animating {
    requests: Option<mpsc::UnboundedSender<pb::AnimateRequest>>,
    frames: tonic::Streaming<pb::Frame>,
    stages: Vec<String>,
    report: Option<pb::AnimationReport>,
}

impl Animating {
    async fn begin(client: &mut DeformerClient<Channel>, options: pb::AnimateOptions) -> Self {
        Self::begin_with(client, [Message::Options(options)]).await
    }

    async fn begin_with(client: &mut DeformerClient<Channel>, messages: impl IntoIterator<Item = Message>) -> Self {
        let (requests, inbound) = mpsc::unbounded_channel();
        for message in messages {
            let request = pb::AnimateRequest { message: Some(message) };
            requests.send(request).expect("open");
        }
        let answer = client.animate(UnboundedReceiverStream::new(inbound));
        let frames = within("the head of an animation", answer).await.expect("an answer");
        Self {
            requests: Some(requests),
            frames: frames.into_inner(),
            stages: Vec::new(),
            report: None,
        }
    }

    fn send(&self, message: Message) {
        let request = pb::AnimateRequest { message: Some(message) };
        if let Some(requests) = &self.requests {
            // Of an animation that has ended no one listens.
            let _ = requests.send(request);
        }
    }

    fn acknowledge(&self, seq: u64) {
        self.send(Message::Ack(pb::Ack { seq }));
    }

    /// No acknowledgement follows.
    fn half_close(&mut self) {
        self.requests = None;
    }

    /// The next frame, put together of its parts; `None` when all have come.
    async fn next_frame(&mut self) -> Result<Option<WholeFrame>, tonic::Status> {
        let mut data = Vec::new();
        loop {
            let Some(part) = within("a part of a frame", self.frames.message()).await? else {
                assert!(self.report.is_some(), "a report comes last");
                return Ok(None);
            };
            let reply = part.animated.expect("of an animation");
            if part.parts == 0 {
                assert!(data.is_empty() && self.report.is_none());
                match reply.report {
                    Some(report) => self.report = Some(report),
                    None => self.stages.push(reply.stage),
                }
                continue;
            }
            data.extend_from_slice(&part.data);
            if part.part + 1 == part.parts {
                return Ok(Some(WholeFrame {
                    reply,
                    quality: part.quality,
                    seq: part.seq,
                    data,
                }));
            }
        }
    }

    /// The next frame, which must come.
    async fn frame(&mut self) -> WholeFrame {
        self.next_frame().await.expect("no failure").expect("a frame")
    }

    /// All frames, each acknowledged.
    async fn all_frames(&mut self) -> Vec<WholeFrame> {
        let mut all = Vec::new();
        while let Some(frame) = self.next_frame().await.expect("no failure") {
            self.acknowledge(frame.seq);
            all.push(frame);
        }
        all
    }
}

/// A server, and a session on a bar without handles.
async fn opened_bar() -> (Server, String) {
    let server = Server::start().await;
    let id = text(&server.open(bar_obj(16)).await["id"]);
    (server, id)
}

/// All frames of an animation.
async fn animated(server: &Server, options: pb::AnimateOptions) -> Vec<WholeFrame> {
    Animating::begin(&mut server.grpc().await, options)
        .await
        .all_frames()
        .await
}

/// The form of a call over HTTP.
fn animation_form(options: &Value, clip: Option<String>) -> String {
    let part = |name: &str, text: &str| {
        format!("--cut\r\nContent-Disposition: form-data; name=\"{name}\"; filename=\"{name}\"\r\n\r\n{text}\r\n")
    };
    let clip = clip.map_or_else(String::new, |clip| part("clip", &clip));
    part("options", &options.to_string()) + &clip + "--cut--\r\n"
}

/// Asks for an animation over HTTP.
async fn post_animation(server: &Server, id: &str, accept: &str, form: String) -> reqwest::Response {
    let url = server.url(&path(id, "/animations"));
    let request = http().post(url).header("Accept", accept).body(form);
    let answer = request
        .header("Content-Type", "multipart/form-data; boundary=cut")
        .send();
    within("an animation over HTTP", answer).await.expect("an answer")
}
