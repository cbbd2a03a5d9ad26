//! `loadtest soak`: sessions are opened, dragged, edited and closed over and over; the server must not grow, and must hold nothing
//! at the end.

use super::client::LoadClient;
use super::server::{ProcessUse, ServerProcess, connect};
use crate::failure::{LoadtestFailure, block_on};
use crate::models::DragScene;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tonic::transport::Channel;

/// Arguments of `loadtest soak`.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct SoakArgs {
    /// Rounds: open, drag, commit, edit, undo, close
    #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(10..=1_000_000))]
    pub rounds: u32,
    /// Rounds at the same time
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=32))]
    pub at_once: u32,
    /// Maximum growth of the server's memory after the first tenth of the rounds, as a fraction
    #[arg(long, default_value_t = 0.05)]
    pub growth: f64,
}

/// What a server holds between rounds, by the names of its metrics.
const GAUGES: [&str; 9] = [
    "pliant_sessions",
    "pliant_streams",
    "pliant_animations",
    "pliant_pool_busy",
    "pliant_pool_waiting",
    "pliant_requests_in_flight",
    "pliant_memory_bytes",
    "pliant_websockets",
    "pliant_connections",
];

/// Those that this program itself keeps above zero while it looks.
const OWN: [&str; 3] = ["pliant_connections", "pliant_requests_in_flight", "pliant_memory_bytes"];

pub(crate) fn run_soak(args: &SoakArgs) -> Result<(), LoadtestFailure> {
    block_on(soak(args))
}

async fn soak(args: &SoakArgs) -> Result<(), LoadtestFailure> {
    let scene = DragScene::small_bar()?;
    let server = ServerProcess::start(None).await?;
    let channel = connect(&server.url).await?;
    let begun = Instant::now();
    let warm_up = (args.rounds / 10).max(1);
    run_rounds(&channel, &scene, 0..warm_up, args.at_once).await?;
    let (warm, held_warm) = settled(&server, usize::MAX).await?;
    let mut seen = vec![(warm_up, warm)];
    println!("{:>8}  {:>9}  {:>5}  {:>7}", "rounds", "MiB", "files", "threads");
    print_row(warm_up, warm);
    for k in 1..10 {
        let (from, to) = (args.rounds / 10 * k, args.rounds / 10 * (k + 1));
        run_rounds(&channel, &scene, from.max(warm_up)..to.max(warm_up), args.at_once).await?;
        let (used, _) = settled(&server, warm.files).await?;
        print_row(to, used);
        seen.push((to, used));
    }
    let (end, held) = settled(&server, warm.files).await?;
    drop(channel);
    server.stop().await?;
    let growth = end.resident as f64 / warm.resident.max(1) as f64 - 1.0;
    println!(
        "{} rounds in {:.0} s; memory grew by {:.1} % after the first {warm_up}",
        args.rounds,
        begun.elapsed().as_secs_f64(),
        growth * 100.0
    );
    let mut problems = Vec::new();
    if growth > args.growth {
        problems.push(format!("memory grew by {:.1} %", growth * 100.0));
    }
    if end.files > warm.files {
        problems.push(format!("{} files are open, {} were", end.files, warm.files));
    }
    if end.threads > warm.threads {
        problems.push(format!("{} threads run, {} did", end.threads, warm.threads));
    }
    for ((name, before), (_, after)) in held_warm.iter().zip(&held) {
        if after > before {
            problems.push(format!("{name} is {after}, it was {before}"));
        }
    }
    LoadtestFailure::of_problems(&problems)
}

fn print_row(rounds: u32, used: ProcessUse) {
    println!(
        "{rounds:8}  {:9.1}  {:5}  {:7}",
        used.resident as f64 / f64::from(1 << 20),
        used.files,
        used.threads
    );
}

async fn run_rounds(
    channel: &Channel,
    scene: &DragScene,
    numbers: std::ops::Range<u32>,
    at_once: u32,
) -> Result<(), LoadtestFailure> {
    let (mut rounds, mut numbers) = (JoinSet::new(), numbers);
    loop {
        while rounds.len() < at_once as usize {
            let Some(number) = numbers.next() else { break };
            let (channel, scene) = (channel.clone(), scene.clone());
            rounds.spawn(async move {
                LoadClient::open(channel, &scene, number)
                    .await?
                    .work_and_close(&scene)
                    .await
            });
        }
        let Some(done) = rounds.join_next().await else {
            return Ok(());
        };
        done??;
    }
}

/// What the server holds once it has put everything away, at most two seconds later: what it held before is `most`.
async fn settled(
    server: &ServerProcess,
    most: usize,
) -> Result<(ProcessUse, Vec<(&'static str, f64)>), LoadtestFailure> {
    let mut held = gauges(&server.url).await?;
    for _ in 0..20 {
        let is_quiet = held.iter().all(|(name, value)| *value == 0.0 || OWN.contains(name));
        if is_quiet && server.now_used().files <= most {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        held = gauges(&server.url).await?;
    }
    Ok((server.now_used(), held))
}

/// The server's gauges; those that it does not have are left out.
async fn gauges(url: &str) -> Result<Vec<(&'static str, f64)>, LoadtestFailure> {
    let failed = |e: std::io::Error| LoadtestFailure::Server(format!("/metrics: {e}"));
    let mut connection = TcpStream::connect(url.trim_start_matches("http://"))
        .await
        .map_err(failed)?;
    let request = "GET /metrics HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n";
    connection.write_all(request.as_bytes()).await.map_err(failed)?;
    let mut text = String::new();
    connection.read_to_string(&mut text).await.map_err(failed)?;
    let value = |name: &str| {
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let of_name = lines.filter_map(|line| {
            let rest = line.strip_prefix(name)?;
            (rest.starts_with(' ') || rest.starts_with('{')).then_some(rest)
        });
        let values = of_name.filter_map(|rest| rest.rsplit(' ').next()?.parse::<f64>().ok());
        values.fold(None, |sum: Option<f64>, v| Some(sum.unwrap_or(0.0) + v))
    };
    Ok(GAUGES.iter().filter_map(|&name| Some((name, value(name)?))).collect())
}
