//! How far a result may be from its golden: nothing, unless the case says more and why.

use super::metric::{Metric, format_short};
use serde::Deserialize;
use std::collections::BTreeMap;

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
    Metric::ALL.map(Metric::name).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(text: &str) -> Result<Tolerances, (String, String)> {
        Tolerances::from_entries(&serde_json::from_str::<Vec<ToleranceEntry>>(text).expect("a list"))
    }

    #[test]
    fn without_a_word_nothing_may_differ() {
        let none = check("[]").expect("nothing is wrong");
        assert!(!none.allow_any());
        for metric in Metric::ALL {
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
    fn what_is_wrong_is_told_with_its_place_and_what_is_allowed() {
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
