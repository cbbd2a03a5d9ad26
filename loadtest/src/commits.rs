//! `loadtest commits`: what it costs that commits outlive the server.
//!
//! The same poses are committed, and dragged, on servers that keep their sessions in memory, in SQLite and in PostgreSQL, in turns, in
//! one run: what else the machine does falls on all of them.

use crate::failure::{LoadtestFailure, block_on};
use crate::load::client::{LoadClient, close_all, deform_request, open_all};
use crate::load::server::LoadedServer;
use crate::models::DragScene;
use pliant::session::store::{Store, StoreLocation};
use pliant::session::{Manager, OpenDeformer, SessionConfig};
use pliant::wire::pb::deform_request::Message;
use pliant::wire::pb::{self, deform_response};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::JoinSet;

/// Arguments of `loadtest commits`.
#[derive(Debug, Clone, clap::Parser)]
pub(crate) struct CommitsArgs {
    /// Model file of every session [default: the built-in creature]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Commits of every client, and poses of one drag
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(10..=100_000))]
    pub commits: u32,
    /// Clients, each with a session of its own
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub clients: u32,
    /// Folder for SQLite and models [default: a temporary one]
    #[arg(long, value_name = "FOLDER")]
    pub data_dir: Option<PathBuf>,
    /// PostgreSQL database to measure too, postgres://USER:PASSWORD@HOST/DATABASE
    #[arg(long, value_name = "URL")]
    pub database: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    pub json: bool,
}

/// Turns that every server has.
const TURNS: u32 = 10;

pub(crate) fn run_commits(args: &CommitsArgs) -> Result<(), LoadtestFailure> {
    block_on(measure(args))
}

async fn measure(args: &CommitsArgs) -> Result<(), LoadtestFailure> {
    let scene = DragScene::load(args.model.as_deref())?;
    let temporary = tempfile::tempdir().map_err(|e| LoadtestFailure::Server(format!("no temporary folder: {e}")))?;
    let folder = args.data_dir.clone().unwrap_or_else(|| temporary.path().to_owned());
    let mut locations = vec![
        ("memory", None),
        ("SQLite", Some(StoreLocation::in_folder(folder.join("sqlite")))),
    ];
    if let Some(url) = &args.database {
        let location = StoreLocation {
            database: Some(url.clone()),
            ..StoreLocation::in_folder(folder.join("postgres"))
        };
        locations.push(("PostgreSQL", Some(location)));
    }
    let mut places = Vec::new();
    for (name, location) in locations {
        places.push(MeasuredPlace::start(name, location, &scene, args.clients).await?);
    }
    let turn = args.commits.div_ceil(TURNS);
    // The first turn warms up, and is not counted.
    for round in 0..=TURNS {
        for place in &mut places {
            place.commit(&scene, turn, round > 0).await?;
            place.drag(&scene, turn, round > 0).await?;
        }
    }
    let mut rows = Vec::new();
    for place in places {
        rows.push(place.finish().await?);
    }
    match args.json {
        true => println!("{}", json_report(&rows, &scene, args)),
        false => print!("{}", text_report(&rows, &scene, args)),
    }
    Ok(())
}

/// One commit: until its answer was here, and what of that its solve took.
#[derive(Debug, Clone, Copy)]
struct TimedCommit {
    total_ms: f64,
    solve_ms: f64,
}

/// What was measured of one place.
struct PlaceRow {
    pub name: &'static str,
    pub commits: Vec<TimedCommit>,
    /// Time in which they were made.
    pub busy: Duration,
    /// From sending a pose that is not committed until its frame, milliseconds.
    pub drags: Vec<f64>,
}

/// A server, its sessions, and what was measured so far.
struct MeasuredPlace {
    server: LoadedServer,
    clients: Vec<LoadClient>,
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
        let config = SessionConfig::default();
        let manager = match location {
            None => Manager::new(config),
            Some(location) => {
                let store = Store::open(&location).await;
                let store = store.map_err(|e| LoadtestFailure::Server(format!("{name}: {e}")))?;
                Manager::with_store(config, OpenDeformer, Arc::new(store)).await
            }
        };
        let server = LoadedServer::serve(manager?).await?;
        Ok(Self {
            clients: open_all(&server.url, scene, clients).await?,
            server,
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
        let mut committing = JoinSet::new();
        let first = self.poses;
        self.poses += u64::from(poses);
        let started = Instant::now();
        for mut client in self.clients.drain(..) {
            let scene = scene.clone();
            committing.spawn(async move {
                let mut timed = Vec::new();
                for k in 1..=u64::from(poses) {
                    let sent = Instant::now();
                    let solve_ms = client.solve(&scene, first + k).await?;
                    let total_ms = sent.elapsed().as_secs_f64() * 1e3;
                    timed.push(TimedCommit { total_ms, solve_ms });
                }
                Ok::<_, LoadtestFailure>((client, timed))
            });
        }
        let mut all = Vec::new();
        while let Some(done) = committing.join_next().await {
            let (client, timed) = done??;
            self.clients.push(client);
            all.extend(timed);
        }
        if counts {
            self.row.busy += started.elapsed();
            self.row.commits.extend(all);
        }
        Ok(())
    }

    /// Drags so many poses on the first session: each is sent when the frame of the one before is here.
    pub async fn drag(&mut self, scene: &DragScene, poses: u32, counts: bool) -> Result<(), LoadtestFailure> {
        let Some(client) = self.clients.first_mut() else {
            return Ok(());
        };
        let gone = |_| LoadtestFailure::Server("the stream ended".into());
        let (requests, mut answers) = client.open_stream(pb::Options::default()).await?;
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
    pub async fn finish(self) -> Result<PlaceRow, LoadtestFailure> {
        close_all(self.clients).await?;
        self.server.stop_own().await?;
        Ok(self.row)
    }
}

/// The figures of a place.
struct PlaceFigures {
    a_second: f64,
    /// Median and the 99th percentile of a commit, of what it took above its solve, and of a dragged pose, milliseconds.
    commit: [f64; 2],
    above: [f64; 2],
    drag: [f64; 2],
}

/// The smallest of `sorted` that at least the share `q` (above 0, at most 1) of them does not exceed.
fn percentile(sorted: &[f64], q: f64) -> Option<f64> {
    let rank = (q * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied()
}

fn shares_of(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    [0.5, 0.99].map(|q| percentile(&sorted, q).unwrap_or(f64::NAN))
}

fn figures_of(row: &PlaceRow) -> PlaceFigures {
    let of = |value: fn(&TimedCommit) -> f64| shares_of(row.commits.iter().map(value));
    PlaceFigures {
        a_second: row.commits.len() as f64 / row.busy.as_secs_f64(),
        commit: of(|c| c.total_ms),
        above: of(|c| c.total_ms - c.solve_ms),
        drag: shares_of(row.drags.iter().copied()),
    }
}

/// A table, and what durability costs.
fn text_report(rows: &[PlaceRow], scene: &DragScene, args: &CommitsArgs) -> String {
    let mut text = format!(
        "{} vertices, {} clients, {} commits each; milliseconds, median and 99th percentile\n\n\
         place        commits/s          commit     above its solve      a dragged pose\n",
        scene.vertices, args.clients, args.commits
    );
    for row in rows {
        let f = figures_of(row);
        let [commit, above, drag] = [f.commit, f.above, f.drag].map(|[p50, p99]| format!("{p50:.2} {p99:>8.2}"));
        let _ = writeln!(
            text,
            "{:<12}{:>10.1}{commit:>16}{above:>20}{drag:>20}",
            row.name, f.a_second
        );
    }
    if let Some((memory, kept)) = rows.split_first() {
        let memory = figures_of(memory);
        text.push('\n');
        for row in kept {
            let f = figures_of(row);
            let more = |k: usize| f.above[k] - memory.above[k];
            let drag = f.drag[0] - memory.drag[0];
            let _ = writeln!(
                text,
                "{}: a commit costs {:+.2} ms more than in memory (99th percentile {:+.2} ms), a dragged pose {drag:+.2} ms",
                row.name,
                more(0),
                more(1)
            );
        }
    }
    text
}

/// One JSON document.
fn json_report(rows: &[PlaceRow], scene: &DragScene, args: &CommitsArgs) -> Value {
    let place = |row: &PlaceRow| {
        let f = figures_of(row);
        let pair = |[p50, p99]: [f64; 2]| json!({"p50": p50, "p99": p99});
        json!({
            "place": row.name, "commits": row.commits.len(), "commitsPerSecond": f.a_second,
            "commitMs": pair(f.commit), "aboveSolveMs": pair(f.above), "dragMs": pair(f.drag),
        })
    };
    json!({
        "vertices": scene.vertices, "clients": args.clients,
        "places": rows.iter().map(place).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[tokio::test(flavor = "multi_thread")]
    async fn every_place_has_its_row_and_all_commits_are_counted() {
        let scene = DragScene::load(None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut rows = Vec::new();
        for (name, location) in [
            ("memory", None),
            ("SQLite", Some(StoreLocation::in_folder(folder.path()))),
        ] {
            let mut place = MeasuredPlace::start(name, location, &scene, 2).await.unwrap();
            place.commit(&scene, 3, false).await.unwrap();
            place.commit(&scene, 3, true).await.unwrap();
            place.drag(&scene, 4, true).await.unwrap();
            rows.push(place.finish().await.unwrap());
        }
        for row in &rows {
            assert_eq!((row.commits.len(), row.drags.len()), (6, 4));
            assert!(row.commits.iter().all(|c| c.solve_ms <= c.total_ms));
        }
        let args = CommitsArgs::parse_from(["commits", "--commits", "10", "--clients", "2"]);
        let text = text_report(&rows, &scene, &args);
        assert!(text.contains("memory") && text.contains("SQLite"), "{text}");
        let json = json_report(&rows, &scene, &args);
        assert_eq!(json["places"][1]["commits"], 6);
    }

    #[test]
    fn percentiles_are_values_that_were_seen() {
        let hundred: Vec<f64> = (1..=100).map(f64::from).collect();
        let of = |q| percentile(&hundred, q);
        assert_eq!(
            (of(0.5), of(0.99), of(1.0), of(1e-9)),
            (Some(50.0), Some(99.0), Some(100.0), Some(1.0))
        );
        assert_eq!((percentile(&[7.0], 0.99), percentile(&[], 0.5)), (Some(7.0), None));
    }
}
