//! Drags beside clients that solve without pause: the same drags alone and beside them, the same solves alone and beside the drags,
//! one after the other on one server.

use super::answer_tally::AnswerTally;
use super::args::StreamArgs;
use super::beside_report::{BesideReport, json_report, text_report};
use super::client::LoadClient;
use super::ledger::PoseLedger;
use super::process::ServerProcess;
use super::sessions::{open_all, open_channels};
use crate::failure::LoadtestFailure;
use crate::shared::drag_scene::DragScene;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use tonic::Status;

/// How long solves go on before the drags begin, so that the server is as full as it gets.
const LEAD: Duration = Duration::from_secs(2);

/// Runs `loadtest stream --beside N`.
pub(crate) async fn load_beside_solves(args: &StreamArgs, solving: u32) -> Result<(), LoadtestFailure> {
    let scene = DragScene::load(args.model.as_deref())?;
    let server = ServerProcess::start_with_queue(args.queue).await?;
    let drags = open_or_fail(&server, &scene, args.clients).await?;
    let solves = open_or_fail(&server, &scene, solving).await?;
    let (drags, drags_alone) = drag_all(drags, &scene, args).await?;

    let under_way = SolvingClients::start(solves, &scene);
    tokio::time::sleep(LEAD).await;
    let (drags, drags_beside) = drag_all(drags, &scene, args).await?;
    let (solves, solves_beside) = under_way.stop().await?;

    let under_way = SolvingClients::start(solves, &scene);
    tokio::time::sleep(LEAD + drags_beside.elapsed).await;
    let (solves, solves_alone) = under_way.stop().await?;
    for client in drags.into_iter().chain(solves) {
        client.close().await?;
    }
    let server_use = server.now_used();
    server.stop().await?;
    let report = BesideReport {
        solving,
        drags_alone,
        drags_beside,
        solves_alone,
        solves_beside,
        peak_bytes: server_use.peak,
    };
    if args.json {
        println!("{}", json_report(&report, &scene, args));
    } else {
        print!("{}", text_report(&report, &scene, args));
    }
    let problems = report.problems();
    match problems.is_empty() {
        true => Ok(()),
        false => Err(LoadtestFailure::Server(problems.join("; "))),
    }
}

async fn open_or_fail(
    server: &ServerProcess,
    scene: &DragScene,
    sessions: u32,
) -> Result<Vec<LoadClient>, LoadtestFailure> {
    let channels = open_channels(server, sessions).await?;
    match open_all(&channels, scene, sessions).await? {
        (clients, 0) => Ok(clients),
        (_, turned_away) => Err(LoadtestFailure::Server(format!(
            "there was no room for {turned_away} of {sessions} sessions"
        ))),
    }
}

/// All clients drag at once.
async fn drag_all(
    clients: Vec<LoadClient>,
    scene: &DragScene,
    args: &StreamArgs,
) -> Result<(Vec<LoadClient>, PoseLedger), LoadtestFailure> {
    let mut dragging = JoinSet::new();
    for mut client in clients {
        let (scene, args) = (scene.clone(), args.clone());
        dragging.spawn(async move { client.drag(&scene, &args).await.map(|ledger| (client, ledger)) });
    }
    let (mut clients, mut total) = (Vec::new(), PoseLedger::default());
    while let Some(done) = dragging.join_next().await {
        let (client, ledger) = done.map_err(|e| LoadtestFailure::Server(format!("a client failed: {e}")))??;
        clients.push(client);
        total.add_ledger(ledger);
    }
    Ok((clients, total))
}

/// Clients that solve until `stop` is set.
struct SolvingClients {
    stop: Arc<AtomicBool>,
    tasks: JoinSet<(LoadClient, AnswerTally)>,
}

impl SolvingClients {
    fn start(clients: Vec<LoadClient>, scene: &DragScene) -> Self {
        let (stop, mut tasks) = (Arc::new(AtomicBool::new(false)), JoinSet::new());
        for client in clients {
            tasks.spawn(solve_without_pause(client, scene.clone(), Arc::clone(&stop)));
        }
        Self { stop, tasks }
    }

    /// Stops the clients and waits for them. Later answers do not count.
    async fn stop(mut self) -> Result<(Vec<LoadClient>, AnswerTally), LoadtestFailure> {
        self.stop.store(true, Ordering::Release);
        let (mut clients, mut total) = (Vec::new(), AnswerTally::default());
        while let Some(done) = self.tasks.join_next().await {
            let (client, tally) = done.map_err(|e| LoadtestFailure::Server(format!("a client failed: {e}")))?;
            clients.push(client);
            total.add_tally(tally);
        }
        Ok((clients, total))
    }
}

/// Solves one pose after the other. After a rejection it waits as the server requires.
async fn solve_without_pause(
    mut client: LoadClient,
    scene: DragScene,
    stop: Arc<AtomicBool>,
) -> (LoadClient, AnswerTally) {
    let (mut tally, begun) = (AnswerTally::default(), Instant::now());
    for number in 1.. {
        let asked = Instant::now();
        let outcome = client.solve(&scene, number).await;
        if stop.load(Ordering::Acquire) {
            break;
        }
        tally.enter_answer(&outcome, asked.elapsed());
        tally.elapsed = begun.elapsed();
        if let Err(status) = outcome {
            tokio::time::sleep(told_delay(&status)).await;
        }
    }
    (client, tally)
}

/// The `retry-after` of a rejection; a second without one.
fn told_delay(status: &Status) -> Duration {
    let told = status.metadata().get("retry-after").and_then(|v| v.to_str().ok());
    Duration::from_secs(told.and_then(|text| text.parse().ok()).unwrap_or(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_refused_waits_as_long_as_is_said() {
        let mut status = Status::resource_exhausted("full");
        assert_eq!(told_delay(&status), Duration::from_secs(1));
        status.metadata_mut().insert("retry-after", 3.into());
        assert_eq!(told_delay(&status), Duration::from_secs(3));
    }
}
