//! Many sessions at once: a row for each number of them, up to and past what the server can do.

use super::StreamArgs;
use super::client::{close_all, drag_all, open_clients};
use super::ledger::PoseLedger;
use super::server::{ProcessUse, ServerProcess};
use crate::failure::LoadtestFailure;
use crate::models::DragScene;
use serde_json::json;

/// What one number of sessions led to.
struct LoadRow {
    sessions: u32,
    /// Sessions that the server had no room for.
    turned_away: u32,
    ledger: PoseLedger,
    server: ProcessUse,
}

/// Runs every row on a server of its own, and prints the table.
pub(crate) async fn load_with_many_sessions(args: &StreamArgs) -> Result<(), LoadtestFailure> {
    let scene = DragScene::load(args.model.as_deref())?;
    let mut rows = Vec::new();
    for &sessions in &args.sessions {
        let server = ServerProcess::start(None).await?;
        let row = load_row(&server, &scene, args, sessions).await?;
        server.stop().await?;
        if !args.json {
            eprintln!("{sessions} sessions: {:.1} frames/s", row.ledger.frames_per_second());
        }
        rows.push(row);
    }
    if args.json {
        println!("{}", json_table(&rows, &scene, args));
    } else {
        print!("{}", text_table(&rows, &scene, args));
    }
    let problems: Vec<String> = rows.iter().flat_map(problems_of).collect();
    LoadtestFailure::of_problems(&problems)
}

fn problems_of(row: &LoadRow) -> Vec<String> {
    let mut problems = row.ledger.problems();
    if row.ledger.failed > 0 {
        problems.push(format!(
            "{} poses failed for other reasons than room",
            row.ledger.failed
        ));
    }
    problems
        .iter()
        .map(|problem| format!("{} sessions: {problem}", row.sessions))
        .collect()
}

async fn load_row(
    server: &ServerProcess,
    scene: &DragScene,
    args: &StreamArgs,
    sessions: u32,
) -> Result<LoadRow, LoadtestFailure> {
    let (clients, turned_away) = open_clients(&server.url, scene, sessions).await?;
    // All begin together, when the last is open.
    let (clients, ledger) = drag_all(clients, scene, args).await?;
    close_all(clients).await?;
    Ok(LoadRow {
        sessions,
        turned_away,
        ledger,
        server: server.now_used(),
    })
}

fn peak_of(rows: &[LoadRow]) -> f64 {
    rows.iter()
        .map(|row| row.ledger.frames_per_second())
        .fold(0.0, f64::max)
}

fn mebibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

fn text_table(rows: &[LoadRow], scene: &DragScene, args: &StreamArgs) -> String {
    let mut text = format!(
        "{} vertices, {} poses/s a session, {} s, latency in ms from when a pose was due\n\
         sessions  turned away  frames/s  of peak  superseded  refused  failed   MiB/s      p50      p90      p99      max  peak MiB\n",
        scene.vertices, args.hz, args.seconds
    );
    for row in rows {
        let LoadRow {
            sessions,
            turned_away,
            ledger,
            server,
        } = row;
        let seconds = ledger.elapsed.as_secs_f64().max(1e-9);
        text += &format!(
            "{sessions:8}  {turned_away:11}  {:8.1}  {:6.0}%  {:10}  {:7}  {:6}  {:6.1}  {}  {:8.0}\n",
            ledger.frames_per_second(),
            100.0 * ledger.frames_per_second() / peak_of(rows).max(1e-9),
            ledger.superseded,
            ledger.refused,
            ledger.failed,
            mebibytes(ledger.bytes) / seconds,
            ledger.latency.cells(1).map(|cell| format!("{cell:>7}")).join("  "),
            mebibytes(server.peak),
        );
    }
    text
}

fn json_table(rows: &[LoadRow], scene: &DragScene, args: &StreamArgs) -> String {
    let rows: Vec<_> = rows
        .iter()
        .map(|row| {
            let ledger = &row.ledger;
            let seconds = ledger.elapsed.as_secs_f64();
            json!({
                "sessions": row.sessions,
                "turnedAway": row.turned_away,
                "sent": ledger.sent,
                "frames": ledger.finals,
                "framesPerSecond": ledger.frames_per_second(),
                "superseded": ledger.superseded,
                "refused": ledger.refused,
                "failed": ledger.failed,
                "bytes": ledger.bytes,
                "seconds": seconds,
                "latencyMs": ledger.latency.to_json(),
                "peakResidentBytes": row.server.peak,
                "problems": problems_of(row),
            })
        })
        .collect();
    json!({"vertices": scene.vertices, "hz": args.hz, "rows": rows}).to_string()
}
