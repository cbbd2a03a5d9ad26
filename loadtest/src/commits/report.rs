//! What was measured, place beside place.

use super::args::CommitsArgs;
use super::measured_place::{PlaceRow, TimedCommit};
use crate::shared::drag_scene::DragScene;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// The figures of a place.
struct PlaceFigures {
    a_second: f64,
    /// Median and the 99th percentile of a commit, of what it took above its solve, and of a dragged pose, milliseconds.
    commit: [f64; 2],
    above: [f64; 2],
    drag: [f64; 2],
}

/// The smallest of `sorted` that at least the share `q` (above 0, at most 1) of them does not exceed.
fn percentile(sorted: &[f64], q: f64) -> Option<f64> {
    let rank = (q * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied()
}

fn shares_of(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    [0.5, 0.99].map(|q| percentile(&sorted, q).unwrap_or(f64::NAN))
}

fn figures_of(row: &PlaceRow) -> PlaceFigures {
    let of = |value: fn(&TimedCommit) -> f64| shares_of(row.commits.iter().map(value));
    PlaceFigures {
        a_second: row.commits.len() as f64 / row.busy.as_secs_f64(),
        commit: of(|c| c.total_ms),
        above: of(|c| c.total_ms - c.solve_ms),
        drag: shares_of(row.drags.iter().copied()),
    }
}

/// A table, and what durability costs.
pub(super) fn text_report(rows: &[PlaceRow], scene: &DragScene, args: &CommitsArgs) -> String {
    let mut text = format!(
        "{} vertices, {} clients, {} commits each; milliseconds, median and 99th percentile\n\n\
         place        commits/s          commit     above its solve      a dragged pose\n",
        scene.vertices, args.clients, args.commits
    );
    for row in rows {
        let f = figures_of(row);
        let [commit, above, drag] = [f.commit, f.above, f.drag].map(|[p50, p99]| format!("{p50:.2} {p99:>8.2}"));
        let _ = writeln!(
            text,
            "{:<12}{:>10.1}{commit:>16}{above:>20}{drag:>20}",
            row.name, f.a_second
        );
    }
    if let Some((memory, kept)) = rows.split_first() {
        let memory = figures_of(memory);
        text.push('\n');
        for row in kept {
            let f = figures_of(row);
            let more = |k: usize| f.above[k] - memory.above[k];
            let drag = f.drag[0] - memory.drag[0];
            let _ = writeln!(
                text,
                "{}: a commit costs {:+.2} ms more than in memory (99th percentile {:+.2} ms), a dragged pose {drag:+.2} ms",
                row.name,
                more(0),
                more(1)
            );
        }
    }
    text
}

/// One JSON document.
pub(super) fn json_report(rows: &[PlaceRow], scene: &DragScene, args: &CommitsArgs) -> Value {
    let place = |row: &PlaceRow| {
        let f = figures_of(row);
        let pair = |[p50, p99]: [f64; 2]| json!({"p50": p50, "p99": p99});
        json!({
            "place": row.name, "commits": row.commits.len(), "commitsPerSecond": f.a_second,
            "commitMs": pair(f.commit), "aboveSolveMs": pair(f.above), "dragMs": pair(f.drag),
        })
    };
    json!({
        "vertices": scene.vertices, "clients": args.clients,
        "places": rows.iter().map(place).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_values_that_were_seen() {
        let hundred: Vec<f64> = (1..=100).map(f64::from).collect();
        let of = |q| percentile(&hundred, q);
        assert_eq!(
            (of(0.5), of(0.99), of(1.0), of(1e-9)),
            (Some(50.0), Some(99.0), Some(100.0), Some(1.0))
        );
        assert_eq!((percentile(&[7.0], 0.99), percentile(&[], 0.5)), (Some(7.0), None));
    }
}
