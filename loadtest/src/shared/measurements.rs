//! The measurements of one run: one JSON line for programs, a table for people.

use serde_json::{Map, Value, json};

/// Measurements are values by key, in the order in which they were measured.
#[derive(Debug, Clone, Default)]
pub(crate) struct Measurements(Map<String, Value>);

impl Measurements {
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
}
