//! A server whose sessions are kept somewhere, and what its clients measure.

use crate::failure::LoadtestFailure;
use crate::load::client::{deform_request, open_session};
use crate::load::server::LoadedServer;
use crate::shared::drag_scene::DragScene;
use pliant::server::grpc::client::DeformerClient;
use pliant::session::store::{DatabaseStore, StoreLocation};
use pliant::session::{Manager, OpenDeformer, SessionConfig};
use pliant::wire::pb::{self, deform_request::Message, deform_response};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;

/// One commit: until its answer was here, and what of that its solve took.
#[derive(Debug, Clone, Copy)]
pub(super) struct TimedCommit {
    pub total_ms: f64,
    pub solve_ms: f64,
}

/// What was measured of one place.
pub(super) struct PlaceRow {
    pub name: &'static str,
    pub commits: Vec<TimedCommit>,
    /// Time in which they were made.
    pub busy: Duration,
    /// From sending a pose that is not committed until its frame, milliseconds.
    pub drags: Vec<f64>,
}

/// A server, its sessions, and what was measured so far.
pub(super) struct MeasuredPlace {
    server: LoadedServer,
    client: DeformerClient<Channel>,
    sessions: Vec<String>,
    /// Poses so far: no two that follow each other are the same.
    poses: u64,
    row: PlaceRow,
}

impl MeasuredPlace {
    /// Starts a server, and opens a session for every client.
    pub async fn start(
        name: &'static str,
        location: Option<StoreLocation>,
        scene: &DragScene,
        clients: u32,
    ) -> Result<Self, LoadtestFailure> {
        let failed = |e: String| LoadtestFailure::Server(format!("{name}: {e}"));
        let config = SessionConfig::default();
        let manager = match location {
            None => Manager::new(config),
            Some(location) => {
                let store = DatabaseStore::open(&location)
                    .await
                    .map_err(|e| failed(e.to_string()))?;
                Manager::with_store(config, OpenDeformer, Arc::new(store)).await
            }
        };
        let server = LoadedServer::serve(manager.map_err(|e| failed(e.to_string()))?).await;
        let server = server.map_err(failed)?;
        let mut client = DeformerClient::new(server.open_channel().await?);
        let mut sessions = Vec::new();
        for number in 0..clients {
            sessions.push(open_session(&mut client, scene, number).await?);
        }
        Ok(Self {
            server,
            client,
            sessions,
            poses: 0,
            row: PlaceRow {
                name,
                commits: Vec::new(),
                busy: Duration::ZERO,
                drags: Vec::new(),
            },
        })
    }

    /// Commits so many poses of every client, all clients at once, each one after the other.
    pub async fn commit(&mut self, scene: &DragScene, poses: u32, counts: bool) -> Result<(), LoadtestFailure> {
        let mut clients = JoinSet::new();
        let first = self.poses;
        self.poses += u64::from(poses);
        let started = Instant::now();
        for id in &self.sessions {
            let (mut client, scene, id) = (self.client.clone(), scene.clone(), id.clone());
            clients.spawn(async move {
                let mut timed = Vec::new();
                for k in 1..=u64::from(poses) {
                    timed.push(commit_one(&mut client, &id, scene.pose_number(first + k)).await?);
                }
                Ok::<_, LoadtestFailure>(timed)
            });
        }
        let mut all = Vec::new();
        while let Some(done) = clients.join_next().await {
            all.extend(done.map_err(|e| LoadtestFailure::Server(format!("a client failed: {e}")))??);
        }
        if counts {
            self.row.busy += started.elapsed();
            self.row.commits.extend(all);
        }
        Ok(())
    }

    /// Drags so many poses on the first session: each is sent when the frame of the one before is here.
    pub async fn drag(&mut self, scene: &DragScene, poses: u32, counts: bool) -> Result<(), LoadtestFailure> {
        let Some(id) = self.sessions.first() else { return Ok(()) };
        let (requests, outbound) = mpsc::channel(8);
        let first = pb::DeformRequest {
            session_id: id.clone(),
            message: Some(Message::Options(pb::Options::default())),
        };
        let gone = |_| LoadtestFailure::Server("the stream ended".into());
        requests.send(first).await.map_err(gone)?;
        let mut answers = self.client.deform(ReceiverStream::new(outbound)).await?.into_inner();
        for seq in 1..=u64::from(poses) {
            let mut pose = scene.pose_number(self.poses + seq);
            pose.seq = seq;
            let sent = Instant::now();
            requests.send(deform_request(Message::Pose(pose))).await.map_err(gone)?;
            loop {
                let answer = answers.message().await?;
                let answer = answer.ok_or_else(|| LoadtestFailure::Server("the stream ended".into()))?;
                match answer.message {
                    Some(deform_response::Message::Frame(f)) if f.r#final && f.part + 1 == f.parts => break,
                    Some(deform_response::Message::Error(e)) => return Err(LoadtestFailure::Server(e.message)),
                    _ => {}
                }
            }
            if counts {
                self.row.drags.push(sent.elapsed().as_secs_f64() * 1e3);
            }
            requests
                .send(deform_request(Message::Ack(pb::Ack { seq })))
                .await
                .map_err(gone)?;
        }
        self.poses += u64::from(poses);
        drop(requests);
        while answers.message().await?.is_some() {}
        Ok(())
    }

    /// Deletes the sessions and stops the server.
    pub async fn finish(mut self) -> Result<PlaceRow, LoadtestFailure> {
        for session_id in self.sessions {
            self.client.delete_session(pb::SessionRequest { session_id }).await?;
        }
        self.server.stop_own().await?;
        Ok(self.row)
    }
}

async fn commit_one(
    client: &mut DeformerClient<Channel>,
    id: &str,
    pose: pb::Pose,
) -> Result<TimedCommit, LoadtestFailure> {
    let request = pb::SolveRequest {
        session_id: id.to_owned(),
        pose: Some(pose),
        ..Default::default()
    };
    let sent = Instant::now();
    let mut frames = client.solve(request).await?.into_inner();
    let mut solve_ms = 0.0;
    while let Some(frame) = frames.message().await? {
        solve_ms = frame.solve_ms;
    }
    Ok(TimedCommit {
        total_ms: sent.elapsed().as_secs_f64() * 1e3,
        solve_ms,
    })
}
