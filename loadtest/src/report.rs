//! The books as a person or a program reads them.

use crate::StreamArgs;
use crate::books::{Books, percentile};
use crate::scene::Scene;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// The shares that are told.
const SHARES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("max", 1.0)];

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values
}

fn times(books: &Books) -> [(&'static str, Vec<f64>); 3] {
    [
        ("latency", sorted(&books.latency_ms)),
        ("solve", sorted(&books.solve_ms)),
        ("queue", sorted(&books.queue_ms)),
    ]
}

/// A table for people.
pub(crate) fn text(books: &Books, scene: &Scene, args: &StreamArgs) -> String {
    let mut text = String::new();
    let balanced = if books.problems().is_empty() {
        "balanced"
    } else {
        "NOT BALANCED"
    };
    let seconds = books.elapsed.as_secs_f64();
    let _ = writeln!(
        text,
        "{} clients at {} Hz on {} vertices, {seconds:.2} s",
        books.clients, args.hz, scene.vertices
    );
    let _ = writeln!(
        text,
        "poses    {} sent = {} final frames + {} superseded + {} refused ({balanced})",
        books.sent, books.finals, books.superseded, books.refused
    );
    let _ = writeln!(
        text,
        "frames   {} final, {} before them, {} parts, {:.1} MiB, {:.1} final frames a second",
        books.finals,
        books.intermediate,
        books.parts,
        books.bytes as f64 / f64::from(1 << 20),
        rate(books)
    );
    let _ = writeln!(
        text,
        "{:9}{}",
        "ms",
        SHARES.map(|(name, _)| format!("{name:>10}")).concat()
    );
    for (name, values) in times(books) {
        let cells = SHARES
            .map(|(_, q)| percentile(&values, q).map_or_else(|| format!("{:>10}", "-"), |ms| format!("{ms:>10.2}")));
        let _ = writeln!(text, "{name:9}{}", cells.concat());
    }
    text
}

/// One JSON document.
pub(crate) fn json(books: &Books, scene: &Scene, args: &StreamArgs) -> String {
    let ms: serde_json::Map<String, Value> = times(books)
        .into_iter()
        .map(|(name, values)| {
            let shares: serde_json::Map<String, Value> = SHARES
                .into_iter()
                .map(|(share, q)| (share.to_owned(), json!(percentile(&values, q))))
                .collect();
            (name.to_owned(), Value::Object(shares))
        })
        .collect();
    let problems = books.problems();
    let report = json!({
        "clients": books.clients,
        "hz": args.hz,
        "vertices": scene.vertices,
        "seconds": books.elapsed.as_secs_f64(),
        "poses": {
            "sent": books.sent,
            "answered": books.finals,
            "superseded": books.superseded,
            "refused": books.refused,
            "balanced": problems.is_empty(),
        },
        "frames": {
            "final": books.finals,
            "intermediate": books.intermediate,
            "parts": books.parts,
            "bytes": books.bytes,
            "finalPerSecond": rate(books),
        },
        "ms": ms,
        "problems": problems,
    });
    report.to_string()
}

fn rate(books: &Books) -> f64 {
    let seconds = books.elapsed.as_secs_f64();
    if seconds > 0.0 {
        books.finals as f64 / seconds
    } else {
        0.0
    }
}
