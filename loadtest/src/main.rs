//! Loads a pliant server on loopback, and measures the solver and the pipeline.
//!
//! `loadtest stream` drags a handle of a model at a steady rate over gRPC, from one client or several, and keeps the
//! books: every pose that was sent must come back as a final frame, as an error, or in the `superseded` of a frame.
//! `export-system`, `solver` and `pipeline` are the bench: see [`bench`]. `sheet` draws what deforming does to a folder of
//! models.
//!
//! Exit codes: 0 the books balance, 1 they do not or the server or solver failed, 2 usage.

mod bench;
mod books;
mod client;
mod figures;
mod report;
mod scene;
mod sheet;
mod target;

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// Loads a pliant server on loopback, and measures the solver and the pipeline.
#[derive(Debug, Parser)]
#[command(name = "loadtest", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Drag a handle at a steady rate and measure what comes back
    Stream(StreamArgs),
    /// Write the second-pass system of a pose as files that any solver can read
    ExportSystem(bench::export::ExportArgs),
    /// Solve an exported system and say what it took
    Solver(bench::solver::SolverArgs),
    /// Time every stage from a model's file to the first frame
    Pipeline(bench::pipeline::PipelineArgs),
    /// Edit a region of a model and time everything up to the next frame, repaired and built anew
    Edits(bench::edits::EditsArgs),
    /// Deform every model of a folder and draw them all on one picture
    Sheet(sheet::SheetArgs),
    /// Make the paper's figures 2 and 3: every first pass, and the deformation of space, side by side
    Figures(figures::FiguresArgs),
}

/// Arguments of `loadtest stream`.
#[derive(Debug, Clone, clap::Args)]
struct StreamArgs {
    /// Server to load, such as http://127.0.0.1:7411; loopback only. Without it, a server in this process
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Model that every client opens a session with; without it, the built-in creature
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Poses that every client sends
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    poses: u32,
    /// Poses a second of every client
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=1000))]
    hz: u32,
    /// Clients, each with a session of its own
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    clients: u32,
    /// Stop sending after this many seconds, even when poses are left
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=600))]
    seconds: u32,
    /// Unacknowledged frames in flight
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    window: u32,
    /// Relative residual to reach
    #[arg(long, default_value_t = 1e-4)]
    tolerance: f64,
    /// Ask for better and better frames of one pose
    #[arg(long)]
    progressive: bool,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

impl StreamArgs {
    /// When the pose after `sent` others is due, since the start.
    fn due(&self, sent: u64) -> Duration {
        Duration::from_secs_f64(sent as f64 / f64::from(self.hz))
    }
}

/// Why the load test did not end well.
#[derive(Debug)]
enum Failure {
    /// What was asked for makes no sense: exit code 2.
    Usage(String),
    /// The server or the solver failed, or the books do not balance: exit code 1.
    Server(String),
}

impl From<tonic::Status> for Failure {
    fn from(status: tonic::Status) -> Self {
        Self::Server(format!("the server answered {:?}: {}", status.code(), status.message()))
    }
}

fn main() -> ExitCode {
    let outcome = match &Cli::parse().command {
        Command::Stream(args) => tokio::runtime::Builder::new_multi_thread()
            .enable_all()
            .build()
            .map_err(|e| Failure::Server(format!("cannot start threads: {e}")))
            .and_then(|runtime| runtime.block_on(stream(args))),
        Command::ExportSystem(args) => bench::export::run(args),
        Command::Solver(args) => bench::solver::run(args),
        Command::Pipeline(args) => bench::pipeline::run(args),
        Command::Edits(args) => bench::edits::run(args),
        Command::Sheet(args) => sheet::run(args),
        Command::Figures(args) => figures::run(args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Server(text)) => {
            eprintln!("loadtest: {text}");
            ExitCode::from(1)
        }
        Err(Failure::Usage(text)) => {
            eprintln!("loadtest: {text}");
            ExitCode::from(2)
        }
    }
}

async fn stream(args: &StreamArgs) -> Result<(), Failure> {
    let scene = scene::Scene::load(args.model.as_deref())?;
    let server = target::Server::reach(args.server.as_deref()).await?;
    let outcome = client::run_all(server.channel().await?, &scene, args).await;
    server.stop().await?;
    let books = outcome?;
    let unbalanced = books.problems();
    if args.json {
        println!("{}", report::json(&books, &scene, args));
    } else {
        print!("{}", report::text(&books, &scene, args));
    }
    match unbalanced.is_empty() {
        true => Ok(()),
        false => Err(Failure::Server(unbalanced.join("; "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(line: &str) -> StreamArgs {
        let words = ["loadtest", "stream"].into_iter().chain(line.split_whitespace());
        match Cli::parse_from(words).command {
            Command::Stream(args) => args,
            other => panic!("{other:?}"),
        }
    }

    async fn load(line: &str, scene: &scene::Scene) -> books::Books {
        let args = args(line);
        let server = target::Server::reach(None).await.unwrap();
        let books = client::run_all(server.channel().await.unwrap(), scene, &args)
            .await
            .unwrap();
        server.stop().await.unwrap();
        books
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn every_pose_of_every_client_is_accounted_for() {
        let scene = scene::Scene::load(None).unwrap();
        let books = load("--poses 40 --hz 200 --clients 3", &scene).await;
        assert_eq!(books.problems(), Vec::<String>::new());
        assert_eq!((books.clients, books.sent, books.refused), (3, 120, 0));
        assert!(books.finals >= 3, "every client's last pose has a final frame");
        assert_eq!(books.finals + books.superseded, 120);
        assert_eq!(books.latency_ms.len() as u64, books.finals);
        let report: serde_json::Value = serde_json::from_str(&report::json(&books, &scene, &args("--json"))).unwrap();
        assert_eq!(report["poses"]["sent"], 120);
        assert_eq!(report["poses"]["balanced"], true);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn better_frames_of_one_pose_are_no_answers_of_their_own() {
        let scene = scene::Scene::load(None).unwrap();
        let books = load("--poses 10 --hz 20 --progressive --tolerance 1e-9 --window 8", &scene).await;
        assert_eq!(books.problems(), Vec::<String>::new());
        assert_eq!(books.finals + books.superseded, 10);
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
        ] {
            let words = ["loadtest", "stream"].into_iter().chain(line.split_whitespace());
            assert!(Cli::try_parse_from(words).is_err(), "{line}");
        }
    }
}
