//! `loadtest stream`: drags a handle of a model at a steady rate, from one client or several, and accounts for every pose.

use super::StreamArgs;
use super::beside::load_beside_solves;
use super::client::{close_all, drag_all, open_all};
use super::ledger::{PoseLedger, Times};
use super::server::LoadedServer;
use super::sessions::load_with_many_sessions;
use crate::failure::{LoadtestFailure, block_on};
use crate::models::DragScene;
use serde_json::{Value, json};

/// Runs `loadtest stream`: loads the server, prints the report, and fails when a pose is not accounted for.
pub(crate) fn run_stream(args: &StreamArgs) -> Result<(), LoadtestFailure> {
    if let Some(solving) = args.beside {
        block_on(load_beside_solves(args, solving))
    } else if args.sessions.is_empty() {
        block_on(stream_poses(args))
    } else {
        block_on(load_with_many_sessions(args))
    }
}

async fn stream_poses(args: &StreamArgs) -> Result<(), LoadtestFailure> {
    let scene = DragScene::load(args.model.as_deref())?;
    let server = LoadedServer::connect_or_start(args.server.as_deref()).await?;
    let outcome = drag_once(&server.url, &scene, args).await;
    server.stop_own().await?;
    let ledger = outcome?;
    if args.json {
        println!("{}", json_report(&ledger, &scene, args));
    } else {
        print!("{}", text_report(&ledger, &scene, args));
    }
    LoadtestFailure::of_problems(&ledger.problems())
}

/// Drags with all clients, each with a session of its own.
async fn drag_once(url: &str, scene: &DragScene, args: &StreamArgs) -> Result<PoseLedger, LoadtestFailure> {
    let clients = open_all(url, scene, args.clients).await?;
    let (clients, ledger) = drag_all(clients, scene, args).await?;
    close_all(clients).await?;
    Ok(ledger)
}

fn times(ledger: &PoseLedger) -> [(&'static str, &Times); 3] {
    [
        ("latency", &ledger.latency),
        ("solve", &ledger.solve),
        ("queue", &ledger.queue),
    ]
}

/// A table for people.
pub(crate) fn text_report(ledger: &PoseLedger, scene: &DragScene, args: &StreamArgs) -> String {
    let balanced = match ledger.problems().is_empty() {
        true => "balanced",
        false => "NOT BALANCED",
    };
    let mut text = format!(
        "{} clients at {} Hz on {} vertices, {:.2} s\n\
         poses    {} sent = {} final frames + {} superseded + {} refused ({balanced})\n\
         frames   {} final, {} before them, {} parts, {:.1} MiB, {:.1} final frames a second\n\
         {:9}{}\n",
        ledger.clients,
        args.hz,
        scene.vertices,
        ledger.elapsed.as_secs_f64(),
        ledger.sent,
        ledger.finals,
        ledger.superseded,
        ledger.refused,
        ledger.finals,
        ledger.intermediate,
        ledger.parts,
        ledger.bytes as f64 / f64::from(1 << 20),
        ledger.frames_per_second(),
        "ms",
        Times::SHARES.map(|(name, _)| format!("{name:>10}")).concat()
    );
    for (name, values) in times(ledger) {
        let cells = values.cells(2).map(|cell| format!("{cell:>10}"));
        text += &format!("{name:9}{}\n", cells.concat());
    }
    text
}

/// One JSON document.
pub(crate) fn json_report(ledger: &PoseLedger, scene: &DragScene, args: &StreamArgs) -> String {
    let ms: serde_json::Map<String, Value> = (times(ledger).into_iter())
        .map(|(name, values)| (name.to_owned(), values.to_json()))
        .collect();
    let problems = ledger.problems();
    let report = json!({
        "clients": ledger.clients,
        "hz": args.hz,
        "vertices": scene.vertices,
        "seconds": ledger.elapsed.as_secs_f64(),
        "poses": {
            "sent": ledger.sent,
            "answered": ledger.finals,
            "superseded": ledger.superseded,
            "refused": ledger.refused,
            "balanced": problems.is_empty(),
        },
        "frames": {
            "final": ledger.finals,
            "intermediate": ledger.intermediate,
            "parts": ledger.parts,
            "bytes": ledger.bytes,
            "finalPerSecond": ledger.frames_per_second(),
        },
        "ms": ms,
        "problems": problems,
    });
    report.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load::ledger::PoseLedger;
    use clap::Parser as _;

    fn args(line: &str) -> StreamArgs {
        StreamArgs::parse_from(std::iter::once("stream").chain(line.split_whitespace()))
    }

    async fn load_with(line: &str, scene: &DragScene) -> PoseLedger {
        let args = args(line);
        let server = LoadedServer::connect_or_start(None).await.unwrap();
        let ledger = drag_once(&server.url, scene, &args).await.unwrap();
        server.stop_own().await.unwrap();
        ledger
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn every_pose_of_every_client_is_accounted_for() {
        let scene = DragScene::load(None).unwrap();
        let ledger = load_with("--poses 40 --hz 200 --clients 3", &scene).await;
        assert_eq!(ledger.problems(), Vec::<String>::new());
        assert_eq!((ledger.clients, ledger.sent, ledger.refused), (3, 120, 0));
        assert!(ledger.finals >= 3, "every client's last pose has a final frame");
        assert_eq!(ledger.finals + ledger.superseded, 120);
        assert_eq!(ledger.latency.count(), ledger.finals);
        let report: serde_json::Value = serde_json::from_str(&json_report(&ledger, &scene, &args("--json"))).unwrap();
        assert_eq!(report["poses"]["sent"], 120);
        assert_eq!(report["poses"]["balanced"], true);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn better_frames_of_one_pose_are_no_answers_of_their_own() {
        let scene = DragScene::load(None).unwrap();
        let ledger = load_with("--poses 10 --hz 20 --progressive --tolerance 1e-9 --window 8", &scene).await;
        assert_eq!(ledger.problems(), Vec::<String>::new());
        assert_eq!(ledger.finals + ledger.superseded, 10);
    }

    #[test]
    fn numbers_are_bounded() {
        for line in [
            "--poses 0",
            "--poses 100001",
            "--hz 1001",
            "--clients 65",
            "--seconds 601",
            "--window 0",
            "--sessions 257",
            "--sessions 1,0",
            "--sessions 4 --clients 2",
            "--beside 0",
            "--beside 193",
            "--queue 4",
            "--beside 4 --sessions 2",
            "--beside 4 --server http://127.0.0.1:7411",
        ] {
            let words = std::iter::once("stream").chain(line.split_whitespace());
            assert!(StreamArgs::try_parse_from(words).is_err(), "{line}");
        }
    }
}
