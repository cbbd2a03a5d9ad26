//! `loadtest stream`: drags a handle of a model at a steady rate, from one client or several, and accounts for every pose.

use super::args::StreamArgs;
use super::beside::load_beside_solves;
use super::client::drag_with_all_clients;
use super::report::{json_report, text_report};
use super::server::LoadedServer;
use super::sessions::load_with_many_sessions;
use crate::failure::LoadtestFailure;
use crate::shared::drag_scene::DragScene;

/// Runs `loadtest stream`: loads the server, prints the report, and fails when a pose is not accounted for.
pub(crate) fn run_stream(args: &StreamArgs) -> Result<(), LoadtestFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|e| LoadtestFailure::Server(format!("cannot start threads: {e}")))?;
    if let Some(solving) = args.beside {
        runtime.block_on(load_beside_solves(args, solving))
    } else if args.sessions.is_empty() {
        runtime.block_on(stream_poses(args))
    } else {
        runtime.block_on(load_with_many_sessions(args))
    }
}

async fn stream_poses(args: &StreamArgs) -> Result<(), LoadtestFailure> {
    let scene = DragScene::load(args.model.as_deref())?;
    let server = LoadedServer::connect_or_start(args.server.as_deref()).await?;
    let outcome = drag_with_all_clients(server.open_channel().await?, &scene, args).await;
    server.stop_own().await?;
    let ledger = outcome?;
    let unbalanced = ledger.problems();
    if args.json {
        println!("{}", json_report(&ledger, &scene, args));
    } else {
        print!("{}", text_report(&ledger, &scene, args));
    }
    match unbalanced.is_empty() {
        true => Ok(()),
        false => Err(LoadtestFailure::Server(unbalanced.join("; "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load::ledger::PoseLedger;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct StreamCommand {
        #[command(flatten)]
        args: StreamArgs,
    }

    fn args(line: &str) -> StreamArgs {
        StreamCommand::parse_from(std::iter::once("stream").chain(line.split_whitespace())).args
    }

    async fn load_with(line: &str, scene: &DragScene) -> PoseLedger {
        let args = args(line);
        let server = LoadedServer::connect_or_start(None).await.unwrap();
        let ledger = drag_with_all_clients(server.open_channel().await.unwrap(), scene, &args)
            .await
            .unwrap();
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
            assert!(StreamCommand::try_parse_from(words).is_err(), "{line}");
        }
    }
}
