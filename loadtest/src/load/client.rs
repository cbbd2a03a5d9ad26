//! Clients: each opens a session, drags, keeps its ledger and closes its session.

use super::StreamArgs;
use super::ledger::PoseLedger;
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
use tonic::transport::Channel;

/// How long the last frames may take after the last pose.
const GRACE: Duration = Duration::from_secs(120);
/// Bytes of one piece of an upload.
const PIECE: usize = 1 << 20;

/// Runs all clients at once and adds their ledgers up.
pub(crate) async fn drag_with_all_clients(
    channel: Channel,
    scene: &DragScene,
    args: &StreamArgs,
) -> Result<PoseLedger, LoadtestFailure> {
    let mut clients = JoinSet::new();
    for number in 0..args.clients {
        let (channel, scene, args) = (channel.clone(), scene.clone(), args.clone());
        clients.spawn(async move {
            let client = LoadClient::open(channel, &scene, number).await?;
            client.drag_and_close(&scene, &args).await
        });
    }
    let mut total = PoseLedger::default();
    while let Some(done) = clients.join_next().await {
        total.add_ledger(done.map_err(|e| LoadtestFailure::Server(format!("a client failed: {e}")))??);
    }
    Ok(total)
}

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
        let id = open_session(&mut client, scene, number).await?;
        Ok(Self { client, id })
    }

    /// Drags until the poses or the time have ended.
    pub async fn drag(&mut self, scene: &DragScene, args: &StreamArgs) -> Result<PoseLedger, LoadtestFailure> {
        drag_session(&mut self.client, &self.id, scene, args).await
    }

    /// Solves and commits the pose of that number, and takes the answer.
    pub async fn solve(&mut self, scene: &DragScene, number: u64) -> Result<(), tonic::Status> {
        let solve = pb::SolveRequest {
            session_id: self.id.clone(),
            pose: Some(scene.pose_number(number)),
            ..Default::default()
        };
        let mut frames = self.client.solve(solve).await?.into_inner();
        while frames.message().await?.is_some() {}
        Ok(())
    }

    /// Drags until the poses or the time have ended, and closes the session.
    pub async fn drag_and_close(mut self, scene: &DragScene, args: &StreamArgs) -> Result<PoseLedger, LoadtestFailure> {
        let outcome = self.drag(scene, args).await;
        // Also after a failure: a session of a client that has gone would only wait for its expiry.
        let closed = self.close().await;
        let ledger = outcome?;
        closed?;
        Ok(ledger)
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

/// Opens a session on the scene's model and sets its handles; its id.
///
/// # Errors
/// What the server answers.
pub(crate) async fn open_session(
    client: &mut DeformerClient<Channel>,
    scene: &DragScene,
    number: u32,
) -> Result<String, tonic::Status> {
    let opened = client.create_session(tokio_stream::iter(upload_messages(scene, number)));
    let session_id = opened.await?.into_inner().id;
    let handles = pb::SetHandlesRequest {
        session_id: session_id.clone(),
        handles: scene.handles(),
        ..Default::default()
    };
    if let Err(status) = client.set_handles(handles).await {
        // A session of a client that has gone would only wait for its expiry.
        let _ = client.delete_session(pb::SessionRequest { session_id }).await;
        return Err(status);
    }
    Ok(session_id)
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

async fn drag_session(
    client: &mut DeformerClient<Channel>,
    id: &str,
    scene: &DragScene,
    args: &StreamArgs,
) -> Result<PoseLedger, LoadtestFailure> {
    let (requests, outbound) = mpsc::channel(8);
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
    let first = pb::DeformRequest {
        session_id: id.to_owned(),
        message: Some(deform_request::Message::Options(options)),
    };
    let _ = requests.send(first).await;
    let mut responses = client.deform(ReceiverStream::new(outbound)).await?.into_inner();

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
    let mut ledger = PoseLedger::for_one_client();
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
                if ledger.enter_part(&frame, latency) {
                    Some(frame.seq)
                } else {
                    None
                }
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
