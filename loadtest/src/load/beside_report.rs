//! Drags beside solves, as a person or a program reads it.

use super::answer_tally::AnswerTally;
use super::args::StreamArgs;
use super::ledger::PoseLedger;
use super::times::Times;
use crate::shared::drag_scene::DragScene;
use serde_json::{Value, json};

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
    let of = |q: f64| {
        times
            .share_ms(q)
            .map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1}"))
    };
    [0.5, 0.9, 0.99, 1.0].map(|q| format!("  {:>7}", of(q))).concat()
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
            "latencyMs": json_shares(&ledger.latency),
        })
    };
    let solves = |tally: &AnswerTally| {
        json!({
            "solvesPerSecond": tally.solves_per_second(),
            "solved": tally.solved,
            "refused": tally.refusal.count(),
            "failed": tally.failed,
            "latencyMs": json_shares(&tally.latency),
            "refusalMs": json_shares(&tally.refusal),
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

fn json_shares(times: &Times) -> Value {
    json!({
        "p50": times.share_ms(0.5),
        "p90": times.share_ms(0.9),
        "p99": times.share_ms(0.99),
        "max": times.share_ms(1.0),
    })
}
