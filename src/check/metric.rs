//! What is measured of a result, and how far it may be from its golden.

use super::named::Named;
use glam::DVec3;
use serde::Deserialize;
use std::collections::BTreeMap;

/// A metric is one measure of how far a result is from its golden.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Metric {
    /// Largest distance of a vertex from its stored place.
    MaxDisplacement,
    /// Mean of these distances.
    MeanDisplacement,
    /// Root of their mean square.
    RmsDisplacement,
    /// Largest distance of a point of one surface from the nearest point of the other, both ways.
    Hausdorff,
    /// 95th percentile of the angles between the normals of triangles and the stored ones.
    NormalDegrees,
    /// Triangles whose normal opposes the stored one.
    FlippedTriangles,
    /// Largest relative change of an edge's length against the stored one.
    EdgeStretch,
    /// Root mean square of relative edge changes against the rest shape.
    EdgeRms,
    /// Largest stretch of a triangle against the rest shape.
    MaxStretch,
    /// Relative change of the volume against the rest shape.
    VolumeChange,
    /// Relative change of the area against the rest shape.
    AreaChange,
    /// Triangles that turned over against the rest shape.
    FoldedTriangles,
    /// Pairs of triangles that cross each other and do not in the rest shape; known where the job counts them.
    NewSelfIntersections,
    /// Largest distance of a vertex that a hard handle holds from where the handle puts it.
    ConstraintError,
    /// Relative residual that the solver reached.
    Residual,
    /// Cycles of the solver, all steps together.
    Cycles,
    /// Bytes that the solver held at the end.
    Bytes,
}

/// What a metric's number counts in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MetricUnit {
    /// Shares of the diagonal of the stored shape's bounding box.
    Diagonal,
    /// Degrees.
    Degrees,
    /// A share, or a factor.
    Ratio,
    /// Whole things.
    Count,
}

impl MetricUnit {
    /// The unit's name, as the page of suites has it too.
    pub fn name(self) -> &'static str {
        match self {
            Self::Diagonal => "diagonal",
            Self::Degrees => "degrees",
            Self::Ratio => "ratio",
            Self::Count => "count",
        }
    }
}

/// How a metric is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MetricKind {
    /// Against the stored positions: the number is the difference.
    Shape,
    /// Against the stored number, either way.
    Change,
    /// Against the stored number; only more is worse.
    Growth,
}

impl Named for Metric {
    const WHAT: &'static str = "a metric";
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::MaxDisplacement, "maxDisplacement"),
        (Self::MeanDisplacement, "meanDisplacement"),
        (Self::RmsDisplacement, "rmsDisplacement"),
        (Self::Hausdorff, "hausdorff"),
        (Self::NormalDegrees, "normalDegrees"),
        (Self::FlippedTriangles, "flippedTriangles"),
        (Self::EdgeStretch, "edgeStretch"),
        (Self::EdgeRms, "edgeRms"),
        (Self::MaxStretch, "maxStretch"),
        (Self::VolumeChange, "volumeChange"),
        (Self::AreaChange, "areaChange"),
        (Self::FoldedTriangles, "foldedTriangles"),
        (Self::NewSelfIntersections, "newSelfIntersections"),
        (Self::ConstraintError, "constraintError"),
        (Self::Residual, "residual"),
        (Self::Cycles, "cycles"),
        (Self::Bytes, "bytes"),
    ];
}

impl Metric {
    /// All metrics, in the order of reports.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::NAMES.iter().map(|(metric, _)| *metric)
    }

    /// What the metric's number counts in, and how it is compared.
    fn facts(self) -> (MetricUnit, MetricKind) {
        match self {
            Self::MaxDisplacement | Self::MeanDisplacement | Self::RmsDisplacement | Self::Hausdorff => {
                (MetricUnit::Diagonal, MetricKind::Shape)
            }
            Self::NormalDegrees => (MetricUnit::Degrees, MetricKind::Shape),
            Self::FlippedTriangles => (MetricUnit::Count, MetricKind::Shape),
            Self::EdgeStretch => (MetricUnit::Ratio, MetricKind::Shape),
            Self::EdgeRms | Self::MaxStretch | Self::VolumeChange | Self::AreaChange => {
                (MetricUnit::Ratio, MetricKind::Change)
            }
            Self::ConstraintError => (MetricUnit::Diagonal, MetricKind::Growth),
            Self::Residual => (MetricUnit::Ratio, MetricKind::Growth),
            Self::FoldedTriangles | Self::NewSelfIntersections | Self::Cycles | Self::Bytes => (MetricUnit::Count, MetricKind::Growth),
        }
    }

    /// What the metric's number counts in.
    pub fn unit(self) -> MetricUnit {
        self.facts().0
    }

    /// How the metric is compared.
    pub fn kind(self) -> MetricKind {
        self.facts().1
    }

    /// Writes a number of this metric for people: about three digits, counts whole.
    pub fn format_value(self, value: f64) -> String {
        let number = format_short(value);
        match self.unit() {
            MetricUnit::Degrees => format!("{number}°"),
            // A tolerance may be any number, and not all of its digits would help.
            MetricUnit::Count if value.abs() >= 1e15 => number,
            MetricUnit::Count => format!("{value:.0}"),
            MetricUnit::Diagonal | MetricUnit::Ratio => number,
        }
    }
}

/// Writes a number in about three digits.
pub(super) fn format_short(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&size) {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.2e}")
    }
}

/// Writes a number with all its digits, for programs: as digits where those are few, else with an exponent.
pub(super) fn format_exact(value: f64) -> String {
    if value == 0.0 || (1e-9..1e15).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Writes a point for people.
pub(super) fn format_point(p: DVec3) -> String {
    let [x, y, z] = p.to_array().map(format_short);
    format!("[{x}, {y}, {z}]")
}

/// A tolerance entry is one entry of a case's list, as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ToleranceEntry {
    metrics: Vec<String>,
    most: f64,
    #[serde(default)]
    reason: String,
}

/// Tolerances are what a case allows, metric by metric.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tolerances(BTreeMap<Metric, Tolerance>);

/// A tolerance is what is allowed of one metric.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tolerance {
    /// The largest difference that passes.
    pub most: f64,
    /// Why it is not 0; empty when it is.
    pub reason: String,
    /// It was not given for this metric but follows from one that was.
    pub inherited: bool,
}

impl Tolerances {
    /// Checks a list. Errors are (place below the list, what is wrong).
    pub(super) fn from_entries(list: &[ToleranceEntry]) -> Result<Self, (String, String)> {
        let mut all = BTreeMap::new();
        for (k, entry) in list.iter().enumerate() {
            let place = |name: &str| format!("tolerances[{k}].{name}");
            if !(entry.most.is_finite() && entry.most >= 0.0) {
                let problem = format!(
                    "is {}, a finite number of at least 0 is needed",
                    format_short(entry.most)
                );
                return Err((place("most"), problem));
            }
            if entry.most > 0.0 && entry.reason.trim().is_empty() {
                let problem = "is missing: a tolerance above 0 needs a sentence that says why the result may differ";
                return Err((place("reason"), problem.into()));
            }
            if entry.metrics.is_empty() {
                return Err((place("metrics"), format!("names none, allowed are {}", metric_names())));
            }
            for (i, name) in entry.metrics.iter().enumerate() {
                let place = place(&format!("metrics[{i}]"));
                let Some(metric) = Metric::from_name(name) else {
                    return Err((
                        place,
                        format!("\"{name}\" is not a metric, allowed are {}", metric_names()),
                    ));
                };
                let tolerance = Tolerance {
                    most: entry.most,
                    reason: entry.reason.trim().to_owned(),
                    inherited: false,
                };
                if all.insert(metric, tolerance).is_some() {
                    return Err((place, format!("\"{name}\" has a tolerance already, one is allowed")));
                }
            }
        }
        Ok(Self(all))
    }

    /// Returns a metric's tolerance. Mean, root mean square and Hausdorff distance never exceed the largest
    /// displacement, so they inherit its tolerance.
    pub fn for_metric(&self, metric: Metric) -> Tolerance {
        if let Some(own) = self.0.get(&metric) {
            return own.clone();
        }
        let follows = matches!(
            metric,
            Metric::MeanDisplacement | Metric::RmsDisplacement | Metric::Hausdorff
        );
        match self.0.get(&Metric::MaxDisplacement).filter(|_| follows) {
            Some(from) => Tolerance {
                inherited: true,
                ..from.clone()
            },
            None => Tolerance::default(),
        }
    }

    /// Whether any difference of the bits is allowed.
    pub fn allow_any(&self) -> bool {
        self.0.values().any(|t| t.most > 0.0)
    }
}

fn metric_names() -> String {
    Metric::all().map(Metric::name).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_its_own_and_found_again() {
        for metric in Metric::all() {
            assert_eq!(Metric::from_name(metric.name()), Some(metric));
        }
        assert_eq!(Metric::from_name("MaxDisplacement"), None);
    }

    #[test]
    fn numbers_are_short_and_never_hide_a_difference_as_zero() {
        assert_eq!(Metric::NormalDegrees.format_value(0.5), "0.5°");
        assert_eq!(Metric::Cycles.format_value(12.0), "12");
        assert_eq!(Metric::Bytes.format_value(123_456_789.0), "123456789");
        assert_eq!(Metric::Hausdorff.format_value(1.234_56e-7), "1.23e-7");
        assert_eq!(Metric::Hausdorff.format_value(0.0), "0");
        assert_eq!(Metric::VolumeChange.format_value(-0.25), "-0.25");
    }

    #[test]
    fn no_number_has_hundreds_of_digits() {
        for metric in Metric::all() {
            assert!(metric.format_value(1e300).len() < 12 && metric.format_value(1e-300).len() < 12);
        }
        assert_eq!(Metric::Bytes.format_value(1e300), "1.00e300");
        for (value, text) in [
            (0.0, "0"),
            (1e-6, "0.000001"),
            (123_456_789.0, "123456789"),
            (1e300, "1e300"),
            (-1.25e-30, "-1.25e-30"),
        ] {
            assert_eq!(format_exact(value), text);
            assert_eq!(text.parse(), Ok(value));
        }
    }

    fn check(text: &str) -> Result<Tolerances, (String, String)> {
        Tolerances::from_entries(&serde_json::from_str::<Vec<ToleranceEntry>>(text).expect("a list"))
    }

    #[test]
    fn without_a_word_nothing_may_differ() {
        let none = check("[]").expect("nothing is wrong");
        assert!(!none.allow_any());
        for metric in Metric::all() {
            assert_eq!(none.for_metric(metric), Tolerance::default());
        }
        assert!(
            !check(r#"[{"metrics": ["bytes"], "most": 0}]"#)
                .expect("0 needs no reason")
                .allow_any()
        );
    }

    #[test]
    fn what_bounds_the_largest_displacement_bounds_what_follows_from_it() {
        let some = check(
            r#"[{"metrics": ["maxDisplacement"], "most": 1e-6, "reason": "rounding"},
                {"metrics": ["rmsDisplacement", "bytes"], "most": 1e-7, "reason": "more so"}]"#,
        )
        .expect("nothing is wrong");
        assert!(some.allow_any());
        assert_eq!(some.for_metric(Metric::Hausdorff).most, 1e-6);
        assert!(some.for_metric(Metric::MeanDisplacement).inherited);
        assert_eq!(some.for_metric(Metric::RmsDisplacement).most, 1e-7);
        assert_eq!(some.for_metric(Metric::NormalDegrees).most, 0.0);
    }

    #[test]
    fn what_is_wrong_is_reported_with_its_place_and_what_is_allowed() {
        let refused = |text: &str, place: &str, words: &str| {
            let (at, problem) = check(text).expect_err(text);
            assert_eq!(at, place, "{text}");
            assert!(problem.contains(words), "{problem}");
        };
        refused(r#"[{"metrics": ["bytes"], "most": 1}]"#, "tolerances[0].reason", "why");
        refused(
            r#"[{"metrics": ["bytes"], "most": 1, "reason": " "}]"#,
            "tolerances[0].reason",
            "why",
        );
        refused(
            r#"[{"metrics": ["bytes"], "most": -1, "reason": "x"}]"#,
            "tolerances[0].most",
            "at least 0",
        );
        refused(r#"[{"metrics": [], "most": 0}]"#, "tolerances[0].metrics", "hausdorff");
        refused(
            r#"[{"metrics": ["speed"], "most": 0}]"#,
            "tolerances[0].metrics[0]",
            "hausdorff",
        );
        refused(
            r#"[{"metrics": ["bytes"], "most": 0}, {"metrics": ["cycles", "bytes"], "most": 0}]"#,
            "tolerances[1].metrics[1]",
            "already",
        );
    }
}
