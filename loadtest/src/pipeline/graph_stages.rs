//! How long each part of building a volume graph takes, by the fractions of the work that the builder reports.

use pliant::progress::Progress;
use std::sync::{Mutex, PoisonError};

/// The parts in the order in which they run: the fraction of the work that is reported when each begins, its name, and what
/// it is.
pub(crate) const GRAPH_STAGES: [(f32, &str, &str); 5] = [
    (0.0, "sort", "edges, and the faces by cells"),
    (0.1, "inside", "which parts enclose space, and which way leads in"),
    (
        0.2,
        "lattice",
        "nodes inside (of the paper's graph with a shell), their edges and ties",
    ),
    (0.6, "struts", "across what is too thin for the lattice"),
    (0.9, "rows", "all edges of all nodes"),
];

/// Adds up the milliseconds of the parts of building graphs.
pub(crate) struct GraphStageClock<'a> {
    now_ms: Box<dyn Fn() -> f64 + Send + Sync + 'a>,
    times: Mutex<GraphStageTimes>,
}

#[derive(Default)]
struct GraphStageTimes {
    /// The part under way and when it began.
    open: Option<(usize, f64)>,
    ms: [f64; GRAPH_STAGES.len()],
}

impl<'a> GraphStageClock<'a> {
    /// Creates an idle clock; `now_ms` returns milliseconds since any fixed moment.
    pub(crate) fn new(now_ms: impl Fn() -> f64 + Send + Sync + 'a) -> Self {
        Self {
            now_ms: Box::new(now_ms),
            times: Mutex::default(),
        }
    }

    /// The milliseconds of each part so far.
    pub(crate) fn stage_ms(&self) -> [f64; GRAPH_STAGES.len()] {
        self.times.lock().unwrap_or_else(PoisonError::into_inner).ms
    }
}

impl Progress for GraphStageClock<'_> {
    fn cancelled(&self) -> bool {
        false
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        let now_ms = (self.now_ms)();
        let mut times = self.times.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((part, since)) = times.open.take() {
            times.ms[part] += now_ms - since;
        }
        if stage == "graph" && fraction < 1.0 {
            let begun = GRAPH_STAGES.iter().rposition(|s| s.0 <= fraction);
            times.open = begun.map(|part| (part, now_ms));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    #[test]
    fn parts_of_several_graphs_add_up_and_other_stages_do_not_count() {
        let ticks = AtomicU32::new(0);
        let clock = GraphStageClock::new(|| f64::from(ticks.fetch_add(1, Relaxed)));
        let reports = [
            ("mesh", 0.5),
            ("graph", 0.0),
            ("graph", 0.1),
            ("graph", 1.0),
            ("graph", 0.1),
            ("graph", 0.9),
            ("hierarchy", 0.0),
            ("hierarchy", 0.5),
        ];
        reports
            .iter()
            .for_each(|(stage, fraction)| clock.report(stage, *fraction));
        assert_eq!(clock.stage_ms(), [1.0, 2.0, 0.0, 0.0, 1.0]);
    }
}
