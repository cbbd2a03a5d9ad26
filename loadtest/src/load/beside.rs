//! Drags beside clients that solve without pause: the same drags alone and beside them, the same solves alone and beside the drags,
//! one after the other on one server.

use super::StreamArgs;
use super::client::{LoadClient, close_all, drag_all, open_all};
use super::ledger::{AnswerTally, PoseLedger, Times};
use super::server::ServerProcess;
use crate::failure::LoadtestFailure;
use crate::models::DragScene;
use serde_json::json;
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
    let server = ServerProcess::start(args.queue).await?;
    let drags = open_all(&server.url, &scene, args.clients).await?;
    let solves = open_all(&server.url, &scene, solving).await?;
    let (drags, drags_alone) = drag_all(drags, &scene, args).await?;

    let under_way = SolvingClients::start(solves, &scene);
    tokio::time::sleep(LEAD).await;
    let (drags, drags_beside) = drag_all(drags, &scene, args).await?;
    let (solves, solves_beside) = under_way.stop().await?;

    let under_way = SolvingClients::start(solves, &scene);
    tokio::time::sleep(LEAD + drags_beside.elapsed).await;
    let (solves, solves_alone) = under_way.stop().await?;
    close_all(drags.into_iter().chain(solves).collect()).await?;
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
    LoadtestFailure::of_problems(&problems)
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
            let (client, tally) = done?;
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
            tokio::time::sleep(requested_delay(&status)).await;
        }
    }
    (client, tally)
}

/// The `retry-after` of a rejection; a second without one.
fn requested_delay(status: &Status) -> Duration {
    let seconds = status.metadata().get("retry-after").and_then(|v| v.to_str().ok());
    Duration::from_secs(seconds.and_then(|text| text.parse().ok()).unwrap_or(1))
}

/// What drags and solves came to, alone and beside each other.
pub(crate) struct BesideReport {
    /// Clients that solve.
    pub solving: u32,
    pub drags_alone: PoseLedger,
    pub drags_beside: PoseLedger,
    pub solves_alone: AnswerTally,
    pub solves_beside: AnswerTally,
    /// The most memory that the server had.
    pub peak_bytes: u64,
}

impl BesideReport {
    /// Lists everything that went wrong.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = self.drags_alone.problems();
        problems.extend(self.drags_beside.problems());
        let failed = self.drags_alone.failed + self.drags_beside.failed;
        if failed > 0 {
            problems.push(format!("{failed} poses failed for other reasons than room"));
        }
        for tally in [&self.solves_alone, &self.solves_beside] {
            if let Some(failure) = &tally.failure {
                problems.push(format!("{} solves failed, as with {failure}", tally.failed));
            }
        }
        problems
    }
}

/// A table for people.
pub(crate) fn text_report(report: &BesideReport, scene: &DragScene, args: &StreamArgs) -> String {
    let mut text = format!(
        "{} clients drag at {} poses/s, {} clients solve without pause, {} vertices; times in ms\n\
         drags             frames/s    change  superseded  refused      p50      p90      p99      max\n",
        args.clients, args.hz, report.solving, scene.vertices
    );
    let alone = report.drags_alone.frames_per_second();
    for (name, ledger) in [("alone", &report.drags_alone), ("beside solves", &report.drags_beside)] {
        text += &format!(
            "  {name:14}  {:8.1}  {:+7.1}%  {:10}  {:7}{}\n",
            ledger.frames_per_second(),
            100.0 * (ledger.frames_per_second() / alone.max(1e-9) - 1.0),
            ledger.superseded,
            ledger.refused,
            shares(&ledger.latency)
        );
    }
    text += "solves            solves/s     solved     refused   failed      p50      p90      p99      max\n";
    for (name, tally) in tallies(report) {
        text += &format!(
            "  {name:14}  {:8.1}  {:9}  {:10}  {:7}{}\n",
            tally.solves_per_second(),
            tally.solved,
            tally.refusal.count(),
            tally.failed,
            shares(&tally.latency)
        );
    }
    text += "until a refusal                                                  p50      p90      p99      max\n";
    for (name, tally) in tallies(report) {
        text += &format!("  {name:14}{:43}{}\n", "", shares(&tally.refusal));
    }
    text + &format!(
        "the server's memory at most: {:.0} MiB\n",
        report.peak_bytes as f64 / f64::from(1 << 20)
    )
}

fn tallies(report: &BesideReport) -> [(&'static str, &AnswerTally); 2] {
    [("alone", &report.solves_alone), ("beside drags", &report.solves_beside)]
}

fn shares(times: &Times) -> String {
    times.cells(1).map(|cell| format!("  {cell:>7}")).concat()
}

/// One JSON document.
pub(crate) fn json_report(report: &BesideReport, scene: &DragScene, args: &StreamArgs) -> String {
    let drags = |ledger: &PoseLedger| {
        json!({
            "framesPerSecond": ledger.frames_per_second(),
            "sent": ledger.sent,
            "frames": ledger.finals,
            "superseded": ledger.superseded,
            "refused": ledger.refused,
            "failed": ledger.failed,
            "latencyMs": ledger.latency.to_json(),
        })
    };
    let solves = |tally: &AnswerTally| {
        json!({
            "solvesPerSecond": tally.solves_per_second(),
            "solved": tally.solved,
            "refused": tally.refusal.count(),
            "failed": tally.failed,
            "latencyMs": tally.latency.to_json(),
            "refusalMs": tally.refusal.to_json(),
        })
    };
    json!({
        "clients": args.clients,
        "beside": report.solving,
        "hz": args.hz,
        "vertices": scene.vertices,
        "drags": {"alone": drags(&report.drags_alone), "besideSolves": drags(&report.drags_beside)},
        "solves": {"alone": solves(&report.solves_alone), "besideDrags": solves(&report.solves_beside)},
        "peakResidentBytes": report.peak_bytes,
        "problems": report.problems(),
    })
    .to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_client_waits_as_long_as_the_server_says() {
        let mut status = Status::resource_exhausted("full");
        assert_eq!(requested_delay(&status), Duration::from_secs(1));
        status.metadata_mut().insert("retry-after", 3.into());
        assert_eq!(requested_delay(&status), Duration::from_secs(3));
    }
}
