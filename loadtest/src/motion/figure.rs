//! Measured numbers with what they must be and what is aimed at.

use serde_json::{Value, json};

/// A measured number.
#[derive(Debug, Clone)]
pub(super) struct MotionFigure {
    row: u8,
    what: String,
    value: f64,
    unit: &'static str,
    /// Must, and aim.
    bounds: [Option<f64>; 2],
    /// Whether more is better.
    is_floor: bool,
}

impl MotionFigure {
    /// A number with upper bounds on its magnitude.
    pub fn below(
        row: u8,
        what: impl Into<String>,
        (value, unit): (f64, &'static str),
        bounds: [Option<f64>; 2],
    ) -> Self {
        Self {
            row,
            what: what.into(),
            value,
            unit,
            bounds,
            is_floor: false,
        }
    }

    /// A number with lower bounds.
    pub fn above(row: u8, what: impl Into<String>, value: (f64, &'static str), bounds: [Option<f64>; 2]) -> Self {
        Self {
            is_floor: true,
            ..Self::below(row, what, value, bounds)
        }
    }

    /// A number without bounds, for comparison.
    pub fn told(row: u8, what: impl Into<String>, value: (f64, &'static str)) -> Self {
        Self::below(row, what, value, [None, None])
    }

    fn reaches(&self, bound: Option<f64>) -> Option<bool> {
        bound.map(|bound| match self.is_floor {
            true => self.value >= bound,
            false => self.value.abs() <= bound,
        })
    }

    fn verdict(&self) -> &'static str {
        match self.bounds.map(|bound| self.reaches(bound)) {
            [_, Some(true)] => "aim",
            [Some(true), _] => "must",
            [Some(false), _] => "SHORT",
            _ => "",
        }
    }

    /// Whether it is not what it must be.
    pub fn is_short(&self) -> bool {
        self.reaches(self.bounds[0]) == Some(false)
    }

    /// A line of the table.
    pub fn line(&self) -> String {
        let bound = |bound: Option<f64>| bound.map_or_else(|| "-".to_owned(), |bound| number(bound, self.unit));
        let [must, aim] = self.bounds.map(bound);
        let value = number(self.value, self.unit);
        format!(
            "{:>2}  {:<58} {value:>12} {must:>10} {aim:>10}  {}",
            self.row,
            self.what,
            self.verdict()
        )
    }

    /// The same for programs.
    pub fn json(&self) -> Value {
        let [must, aim] = self.bounds;
        json!({"row": self.row, "what": self.what, "value": self.value, "unit": self.unit, "must": must, "aim": aim,
            "verdict": self.verdict()})
    }
}

/// A number with three digits and its unit.
fn number(value: f64, unit: &str) -> String {
    let digits = match value.abs() {
        v if v == 0.0 || v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        v if v >= 1.0 => 2,
        v if v >= 0.01 => 3,
        _ => return format!("{value:.1e}{unit}"),
    };
    format!("{value:.digits$}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_held_against_their_bounds() {
        let verdict = |value: f64| MotionFigure::below(1, "v", (value, " %"), [Some(2.5), Some(1.5)]).verdict();
        assert_eq!([verdict(-1.0), verdict(2.0), verdict(-2.6)], ["aim", "must", "SHORT"]);
        let rate = |value: f64| MotionFigure::above(5, "f", (value, ""), [Some(8.0), None]);
        assert_eq!([rate(9.0).verdict(), rate(7.0).verdict()], ["must", "SHORT"]);
        assert!(rate(7.0).is_short() && !MotionFigure::told(3, "t", (9.0, "")).is_short());
        let line = rate(0.0123).line();
        assert!(line.starts_with(" 5  f ") && line.contains("0.012"), "{line}");
        assert_eq!(number(-12.34, " %"), "-12.3 %");
    }
}
