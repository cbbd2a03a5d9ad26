//! The ledger as a person or a program reads it.

use super::args::StreamArgs;
use super::ledger::PoseLedger;
use super::times::Times;
use crate::shared::drag_scene::DragScene;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// The reported quantiles.
const SHARES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("max", 1.0)];

fn times(ledger: &PoseLedger) -> [(&'static str, &Times); 3] {
    [
        ("latency", &ledger.latency),
        ("solve", &ledger.solve),
        ("queue", &ledger.queue),
    ]
}

/// A table for people.
pub(crate) fn text_report(ledger: &PoseLedger, scene: &DragScene, args: &StreamArgs) -> String {
    let mut text = String::new();
    let balanced = if ledger.problems().is_empty() {
        "balanced"
    } else {
        "NOT BALANCED"
    };
    let seconds = ledger.elapsed.as_secs_f64();
    let _ = writeln!(
        text,
        "{} clients at {} Hz on {} vertices, {seconds:.2} s",
        ledger.clients, args.hz, scene.vertices
    );
    let _ = writeln!(
        text,
        "poses    {} sent = {} final frames + {} superseded + {} refused ({balanced})",
        ledger.sent, ledger.finals, ledger.superseded, ledger.refused
    );
    let _ = writeln!(
        text,
        "frames   {} final, {} before them, {} parts, {:.1} MiB, {:.1} final frames a second",
        ledger.finals,
        ledger.intermediate,
        ledger.parts,
        ledger.bytes as f64 / f64::from(1 << 20),
        ledger.frames_per_second()
    );
    let _ = writeln!(
        text,
        "{:9}{}",
        "ms",
        SHARES.map(|(name, _)| format!("{name:>10}")).concat()
    );
    for (name, values) in times(ledger) {
        let cells = SHARES.map(|(_, q)| {
            values
                .share_ms(q)
                .map_or_else(|| format!("{:>10}", "-"), |ms| format!("{ms:>10.2}"))
        });
        let _ = writeln!(text, "{name:9}{}", cells.concat());
    }
    text
}

/// One JSON document.
pub(crate) fn json_report(ledger: &PoseLedger, scene: &DragScene, args: &StreamArgs) -> String {
    let ms: serde_json::Map<String, Value> = times(ledger)
        .into_iter()
        .map(|(name, values)| {
            let shares: serde_json::Map<String, Value> = SHARES
                .into_iter()
                .map(|(share, q)| (share.to_owned(), json!(values.share_ms(q))))
                .collect();
            (name.to_owned(), Value::Object(shares))
        })
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
