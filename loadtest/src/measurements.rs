//! The measurements of one run: one JSON line for programs, a table for people.

use serde_json::{Map, Value, json};
use std::path::Path;
use std::time::Instant;

/// Measurements are values by key, in the order in which they were measured.
#[derive(Debug, Clone, Default)]
pub(crate) struct Measurements(Map<String, Value>);

impl Measurements {
    /// Starts with the name of a model file.
    pub fn of_model(path: &Path) -> Self {
        let mut measurements = Self::default();
        measurements.set_value("model", path.file_name().unwrap_or_default().to_string_lossy().as_ref());
        measurements
    }

    /// Sets a text, a count or a list.
    pub fn set_value(&mut self, key: &str, value: impl Into<Value>) {
        self.0.insert(key.into(), value.into());
    }

    /// Sets a measured number, rounded to six digits; null if not finite.
    pub fn set_number(&mut self, key: &str, value: f64) {
        if let Ok(rounded) = format!("{value:.5e}").parse::<f64>() {
            // JSON has no infinities; they become null.
            self.0.insert(key.into(), json!(rounded));
        }
    }

    /// Sets bytes as binary megabytes.
    pub fn set_megabytes(&mut self, key: &str, bytes: f64) {
        self.set_number(key, bytes / f64::from(1 << 20));
    }

    /// A number set before.
    pub fn number(&self, key: &str) -> Option<f64> {
        self.0.get(key)?.as_f64()
    }

    /// A list of numbers set before; empty if there is none.
    pub fn list(&self, key: &str) -> Vec<f64> {
        let list = self.0.get(key).and_then(Value::as_array);
        list.map(|l| l.iter().filter_map(Value::as_f64).collect())
            .unwrap_or_default()
    }

    /// Everything on one line.
    pub fn to_json(&self) -> String {
        Value::Object(self.0.clone()).to_string()
    }

    /// A line for each of `lines` (key, what it means) that was measured.
    pub fn to_table(&self, lines: &[(&str, &str)]) -> String {
        let shown = |value: &Value| match value {
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        lines
            .iter()
            .filter_map(|(key, meaning)| Some((key, shown(self.0.get(*key)?), meaning)))
            .map(|(key, value, meaning)| format!("{key:<18} {value:>14}  {meaning}\n"))
            .collect()
    }
}

/// No further run begins once all before it took this many seconds.
const PATIENCE: f64 = 4.0;

/// Run times are how many seconds the runs of one piece of work took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RunTimes {
    /// The fastest.
    pub best: f64,
    /// The first, which also pays for fresh memory.
    pub first: f64,
    /// All together.
    pub sum: f64,
}

impl RunTimes {
    /// Starts with the time of one run.
    pub fn from_one(seconds: f64) -> Self {
        Self {
            best: seconds,
            first: seconds,
            sum: seconds,
        }
    }

    /// Adds a run.
    pub fn add_run(&mut self, seconds: f64) {
        self.best = self.best.min(seconds);
        self.sum += seconds;
    }

    /// Whether another run may begin.
    pub fn may_repeat(&self) -> bool {
        self.sum < PATIENCE
    }
}

/// The middle of sorted numbers; 0 without any.
pub(crate) fn median(sorted: &[f64]) -> f64 {
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Runs `work` and times it in seconds.
pub(crate) fn time_once<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed().as_secs_f64())
}

/// Runs `work` at most `repeat` times; the result is that of the last run. Each run gets what `prepare` made, outside
/// the clock, after the result before it is gone.
pub(crate) fn time_best_of<S, T, E>(
    repeat: u32,
    mut prepare: impl FnMut() -> S,
    mut work: impl FnMut(S) -> Result<T, E>,
) -> Result<(T, RunTimes), E> {
    let subject = prepare();
    let (first, seconds) = time_once(|| work(subject));
    let (mut last, mut times) = (first?, RunTimes::from_one(seconds));
    for _ in 1..repeat {
        if !times.may_repeat() {
            break;
        }
        drop(last);
        let subject = prepare();
        let (next, seconds) = time_once(|| work(subject));
        last = next?;
        times.add_run(seconds);
    }
    Ok((last, times))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_keep_their_order_and_six_digits() {
        let mut measurements = Measurements::default();
        measurements.set_value("status", "ok");
        measurements.set_number("wu_s", 0.000_249_123_456_7);
        measurements.set_megabytes("mem_MB", f64::from(3 << 19));
        measurements.set_number("factor", f64::NAN);
        assert_eq!(
            measurements.to_json(),
            r#"{"status":"ok","wu_s":0.000249123,"mem_MB":1.5,"factor":null}"#
        );
        let table = measurements.to_table(&[("wu_s", "seconds of a unit"), ("missing", "nothing")]);
        assert_eq!(table.lines().count(), 1);
        assert!(table.contains("0.000249123  seconds of a unit"));
    }

    #[test]
    fn runs_end_early_when_they_fail_or_enough_are_done() {
        let mut runs = 0;
        let (last, times) = time_best_of(
            3,
            || 2,
            |two| {
                runs += 1;
                Ok::<_, ()>(runs * two)
            },
        )
        .unwrap();
        assert_eq!((runs, last), (3, 6));
        assert!(times.best <= times.first && times.first <= times.sum);
        let mut runs = 0;
        let failed = time_best_of(
            3,
            || (),
            |()| {
                runs += 1;
                if runs == 2 { Err(runs) } else { Ok(()) }
            },
        );
        assert_eq!(failed.err(), Some(2));
        assert!(!RunTimes::from_one(PATIENCE).may_repeat());
    }
}
