//! Clients: each opens a session, drags, keeps its ledger and closes its session.

use super::StreamArgs;
use super::ledger::PoseLedger;
use super::server::connect;
use crate::failure::LoadtestFailure;
use crate::models::{DragScene, FARTHEST_POSE};
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::frames::FrameReader;
use pliant::wire::pb::{self, create_session_request, deform_request, deform_response, frame};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout_at};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Code;
use tonic::transport::Channel;

/// How long the last frames may take after the last pose.
const GRACE: Duration = Duration::from_secs(120);
/// Bytes of one piece of an upload.
const PIECE: usize = 1 << 20;

/// Sessions that are opened at the same time.
const OPENED_AT_ONCE: usize = 4;
/// Sessions that share a connection.
const PER_CONNECTION: u32 = 16;

/// Opens so many sessions, a few at a time; how many the server had no room for.
pub(crate) async fn open_clients(
    url: &str,
    scene: &DragScene,
    sessions: u32,
) -> Result<(Vec<LoadClient>, u32), LoadtestFailure> {
    let mut channels = Vec::new();
    for _ in 0..sessions.div_ceil(PER_CONNECTION) {
        channels.push(connect(url).await?);
    }
    let (mut clients, mut turned_away, mut opening) = (Vec::new(), 0, JoinSet::new());
    let mut numbers = 0..sessions;
    loop {
        while opening.len() < OPENED_AT_ONCE {
            let Some(number) = numbers.next() else { break };
            let channel = channels[(number / PER_CONNECTION) as usize].clone();
            let scene = scene.clone();
            opening.spawn(async move { LoadClient::open(channel, &scene, number).await });
        }
        let Some(done) = opening.join_next().await else { break };
        match done? {
            Ok(client) => clients.push(client),
            Err(status) if status.code() == Code::ResourceExhausted => turned_away += 1,
            Err(status) => return Err(status.into()),
        }
    }
    Ok((clients, turned_away))
}

/// Opens so many sessions, all of them.
pub(crate) async fn open_all(url: &str, scene: &DragScene, sessions: u32) -> Result<Vec<LoadClient>, LoadtestFailure> {
    match open_clients(url, scene, sessions).await? {
        (clients, 0) => Ok(clients),
        (_, turned_away) => Err(LoadtestFailure::Server(format!(
            "there was no room for {turned_away} of {sessions} sessions"
        ))),
    }
}

/// All clients drag at once. Where one fails, all are closed.
pub(crate) async fn drag_all(
    clients: Vec<LoadClient>,
    scene: &DragScene,
    args: &StreamArgs,
) -> Result<(Vec<LoadClient>, PoseLedger), LoadtestFailure> {
    let mut dragging = JoinSet::new();
    for mut client in clients {
        let (scene, args) = (scene.clone(), args.clone());
        dragging.spawn(async move {
            let outcome = client.drag(&scene, &args).await;
            (client, outcome)
        });
    }
    let (mut clients, mut total, mut failed) = (Vec::new(), PoseLedger::default(), None);
    while let Some(done) = dragging.join_next().await {
        let (client, outcome) = done?;
        clients.push(client);
        match outcome {
            Ok(ledger) => total.add_ledger(ledger),
            Err(failure) => failed = Some(failure),
        }
    }
    match failed {
        None => Ok((clients, total)),
        Some(failure) => {
            // A session of a client that has gone would only wait for its expiry.
            let _ = close_all(clients).await;
            Err(failure)
        }
    }
}

/// Closes the sessions.
pub(crate) async fn close_all(clients: Vec<LoadClient>) -> Result<(), LoadtestFailure> {
    for client in clients {
        client.close().await?;
    }
    Ok(())
}

/// Where requests of a stream go, and where its answers come from.
type StreamEnds = (mpsc::Sender<pb::DeformRequest>, tonic::Streaming<pb::DeformResponse>);

/// A client with a session of its own, ready to drag.
pub(crate) struct LoadClient {
    client: DeformerClient<Channel>,
    id: String,
}

impl LoadClient {
    /// Opens a session and sets its handles.
    ///
    /// # Errors
    /// What the server answers.
    pub async fn open(channel: Channel, scene: &DragScene, number: u32) -> Result<Self, tonic::Status> {
        let mut client = DeformerClient::new(channel);
        let opened = client.create_session(tokio_stream::iter(upload_messages(scene, number)));
        let id = opened.await?.into_inner().id;
        let handles = pb::SetHandlesRequest {
            session_id: id.clone(),
            handles: scene.handles(),
            ..Default::default()
        };
        let set = client.set_handles(handles).await;
        let opened = Self { client, id };
        match set {
            Ok(_) => Ok(opened),
            Err(status) => {
                // A session of a client that has gone would only wait for its expiry.
                let _ = opened.close().await;
                Err(status)
            }
        }
    }

    /// Opens the stream of the session: where requests go, and where answers come from.
    pub async fn open_stream(&mut self, options: pb::Options) -> Result<StreamEnds, tonic::Status> {
        let (requests, outbound) = mpsc::channel(8);
        let first = pb::DeformRequest {
            session_id: self.id.clone(),
            message: Some(deform_request::Message::Options(options)),
        };
        let _ = requests.send(first).await;
        let responses = self.client.deform(ReceiverStream::new(outbound)).await?;
        Ok((requests, responses.into_inner()))
    }

    /// Drags until the poses or the time have ended.
    pub async fn drag(&mut self, scene: &DragScene, args: &StreamArgs) -> Result<PoseLedger, LoadtestFailure> {
        let options = pb::Options {
            tolerance: args.tolerance,
            window: args.window,
            progressive: args.progressive,
            output: Some(pb::Output {
                encoding: frame::Encoding::from(args.encoding).into(),
                ..Default::default()
            }),
            ..Default::default()
        };
        let (requests, mut responses) = self.open_stream(options).await?;
        let start = Instant::now();
        // The number of the last pose, known a moment before it is sent; 0 until then.
        let last = Arc::new(AtomicU64::new(0));
        let sender = tokio::spawn(send_poses(
            requests.clone(),
            scene.clone(),
            args.clone(),
            start,
            Arc::clone(&last),
        ));
        let patience = start + Duration::from_secs(args.seconds.into()) + GRACE;
        let mut acknowledge = Some(requests);
        let mut ledger = PoseLedger::default();
        let mut reader = FrameReader::new(scene.vertices);
        loop {
            let Ok(response) = timeout_at(patience, responses.message()).await else {
                ledger.note_problem(format!("no end came within {} s of the last pose", GRACE.as_secs()));
                break;
            };
            let answered = match response?.and_then(|r| r.message) {
                None => break,
                Some(deform_response::Message::Frame(frame)) => {
                    // A frame is here when its numbers are.
                    if let Err(error) = reader.take(&frame) {
                        ledger.note_problem(format!("frame {}: {error}", frame.seq));
                    }
                    let latency = |seq: u64| start.elapsed().saturating_sub(args.pose_due_at(seq - 1));
                    ledger.enter_part(&frame, latency).then_some(frame.seq)
                }
                Some(deform_response::Message::Error(error)) if error.seq == 0 => {
                    return Err(LoadtestFailure::Server(format!("the stream failed: {}", error.message)));
                }
                Some(deform_response::Message::Error(error)) => {
                    ledger.enter_error(error.code);
                    Some(error.seq)
                }
                Some(deform_response::Message::Notice(_) | deform_response::Message::Pong(_)) => None,
            };
            let Some(seq) = answered else { continue };
            if let Some(requests) = &acknowledge {
                let _ = requests
                    .send(deform_request(deform_request::Message::Ack(pb::Ack { seq })))
                    .await;
            }
            if seq == last.load(Ordering::Acquire) {
                // All is said; the server ends the stream once both senders are gone.
                acknowledge = None;
                ledger.elapsed = start.elapsed();
            }
        }
        sender.abort();
        ledger.sent = sender.await.unwrap_or_default();
        Ok(ledger)
    }

    /// Solves and commits the pose of that number, and takes the answer: the milliseconds that its solve took.
    pub async fn solve(&mut self, scene: &DragScene, number: u64) -> Result<f64, tonic::Status> {
        let solve = pb::SolveRequest {
            session_id: self.id.clone(),
            pose: Some(scene.pose_number(number)),
            ..Default::default()
        };
        let mut frames = self.client.solve(solve).await?.into_inner();
        let mut solve_ms = 0.0;
        while let Some(frame) = frames.message().await? {
            solve_ms = frame.solve_ms;
        }
        Ok(solve_ms)
    }

    /// Drags a little, commits, edits, goes back, and closes the session.
    pub async fn work_and_close(mut self, scene: &DragScene) -> Result<(), LoadtestFailure> {
        let args = StreamArgs::short();
        let ledger = self.drag(scene, &args).await?;
        if let Some(problem) = ledger.problems().first() {
            return Err(LoadtestFailure::Server(problem.clone()));
        }
        self.solve(scene, FARTHEST_POSE).await?;
        let decimate = pb::edit_request::Decimate {
            ratio: 0.8,
            ..Default::default()
        };
        let edit = pb::EditRequest {
            session_id: self.id.clone(),
            operation: Some(pb::edit_request::Operation::Decimate(decimate)),
            ..Default::default()
        };
        self.client.edit(edit).await?;
        self.client
            .undo(pb::SessionRequest {
                session_id: self.id.clone(),
            })
            .await?;
        Ok(self.close().await?)
    }

    /// Closes the session.
    pub async fn close(mut self) -> Result<(), tonic::Status> {
        let session_id = self.id;
        self.client.delete_session(pb::SessionRequest { session_id }).await?;
        Ok(())
    }
}

fn upload_messages(scene: &DragScene, number: u32) -> Vec<pb::CreateSessionRequest> {
    use create_session_request::Message;
    let message = |message| pb::CreateSessionRequest { message: Some(message) };
    let options = pb::CreateOptions {
        label: format!("loadtest {number}"),
        ..Default::default()
    };
    let pieces = scene
        .bytes
        .chunks(PIECE)
        .map(|piece| message(Message::Chunk(piece.to_vec().into())));
    std::iter::once(message(Message::Options(options)))
        .chain(pieces)
        .collect()
}

/// A message of a stream that is open.
pub(crate) fn deform_request(message: deform_request::Message) -> pb::DeformRequest {
    pb::DeformRequest {
        session_id: String::new(),
        message: Some(message),
    }
}

/// Sends poses when they are due and returns their number. Poses that are late are sent at once, not left out.
async fn send_poses(
    requests: mpsc::Sender<pb::DeformRequest>,
    scene: DragScene,
    args: StreamArgs,
    start: Instant,
    last: Arc<AtomicU64>,
) -> u64 {
    let end = Duration::from_secs(args.seconds.into());
    for seq in 1..=u64::from(args.poses) {
        sleep_until(start + args.pose_due_at(seq - 1)).await;
        let is_last = seq == u64::from(args.poses) || args.pose_due_at(seq) >= end || start.elapsed() >= end;
        if is_last {
            last.store(seq, Ordering::Release);
        }
        if requests
            .send(deform_request(deform_request::Message::Pose(scene.pose_number(seq))))
            .await
            .is_err()
        {
            return seq - 1;
        }
        if is_last {
            return seq;
        }
    }
    0
}
