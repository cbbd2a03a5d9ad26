//! What is told of a suite: lines for people, JSON, JUnit XML, and a page with pictures.
//!
//! All of it is a pure function of the cases' results: no time and no thread count is in it, so two runs that find the
//! same say the same.

mod html;
mod json;
mod junit;
mod page;
mod text;

pub use html::html;
pub use json::json;
pub use junit::junit;
pub use text::{changes, line, summary};

use super::pictures::Plate;
use super::{Inputs, Status, Verdict};

/// A case that was run, or could not be.
#[derive(Debug, Clone)]
pub struct CaseReport {
    /// Its name.
    pub name: String,
    /// What it shows; maybe empty.
    pub title: String,
    /// Its model, as the case names it.
    pub model: String,
    /// What its result depends on; `None` when it was not read.
    pub inputs: Option<Inputs>,
    /// Digest of its positions; empty when it was not run.
    pub digest: String,
    /// Digest in its golden; empty without one.
    pub stored_digest: String,
    /// How it ended.
    pub verdict: Verdict,
    /// Pictures, for the page.
    pub plates: Vec<Plate>,
    /// What someone should know beside, such as why there is no picture.
    pub notes: Vec<String>,
}

/// A suite that was run.
#[derive(Debug, Clone)]
pub struct SuiteReport {
    /// The name of its folder.
    pub suite: String,
    /// How its cases were run: `in process` or `on` a server.
    pub how: String,
    /// In the order of their names.
    pub cases: Vec<CaseReport>,
}

impl SuiteReport {
    /// How many cases ended so.
    pub fn count(&self, status: Status) -> usize {
        self.cases.iter().filter(|c| c.verdict.status == status).count()
    }
}

impl Status {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
            Self::Blessed => "blessed",
        }
    }
}

/// A text without characters that no XML document may hold, each replaced by U+FFFD.
fn printable(text: &str) -> String {
    let allowed = |c: char| {
        matches!(c, '\t' | '\n' | '\r') || (c >= ' ' && !matches!(c, '\u{7f}'..='\u{9f}' | '\u{fffe}' | '\u{ffff}'))
    };
    text.chars().map(|c| if allowed(c) { c } else { '\u{fffd}' }).collect()
}

#[cfg(test)]
pub(super) mod samples {
    //! Reports for the tests of this module.

    use super::super::pictures::Plate;
    use super::super::{Inputs, Measure, Metric, Reason, Status, Verdict};
    use super::{CaseReport, SuiteReport};

    fn case(name: &str, title: &str, verdict: Verdict) -> CaseReport {
        CaseReport {
            name: name.into(),
            title: title.into(),
            model: "models/bar.obj".into(),
            inputs: Some(Inputs {
                model: "aa".into(),
                job: "bb".into(),
            }),
            digest: "xxh3:1".into(),
            stored_digest: "xxh3:2".into(),
            verdict,
            plates: Vec::new(),
            notes: Vec::new(),
        }
    }

    fn measure(metric: Metric, difference: f64, allowed: f64) -> Measure {
        Measure {
            metric,
            value: Some(difference),
            stored: None,
            difference: Some(difference),
            allowed,
            reason: if allowed > 0.0 {
                "rounding".into()
            } else {
                String::new()
            },
            place: "vertex 7".into(),
        }
    }

    /// A case of each kind, with names and texts that try to break out.
    pub fn suite() -> SuiteReport {
        let passed = Verdict {
            status: Status::Passed,
            reasons: Vec::new(),
            identical: true,
            measures: vec![measure(Metric::MaxDisplacement, 0.0, 0.0)],
        };
        let close = Verdict {
            identical: false,
            measures: vec![measure(Metric::MaxDisplacement, 5e-7, 1e-6)],
            ..passed.clone()
        };
        let measures = vec![
            measure(Metric::MaxDisplacement, 3e-4, 0.0),
            measure(Metric::FlippedTriangles, 2.0, 0.0),
            measure(Metric::NormalDegrees, 0.0, 0.0),
        ];
        let failed = Verdict {
            status: Status::Failed,
            reasons: measures[..2]
                .iter()
                .map(|m| Reason {
                    code: "metric",
                    text: m.show(),
                })
                .collect(),
            identical: false,
            measures,
        };
        let skipped = Verdict::without_result(Status::Skipped, "skipped", "data:arm.off is absent");
        let broken = Verdict::without_result(Status::Failed, "not-run", "a <b> & \"c\" \u{1}]]>");
        let mut shown = case("d-failed", "<script>alert('x')</script> & more", failed);
        shown.plates.push(Plate {
            caption: "after",
            description: "a \"shape\" <b>".into(),
            size: [4, 3],
            png: vec![1, 2, 3],
        });
        shown.notes.push("a <note>".into());
        SuiteReport {
            suite: "su<i>te".into(),
            how: "in process".into(),
            cases: vec![
                case("a-passed", "", passed),
                case("b-close", "", close),
                case("c-skipped", "", skipped),
                shown,
                case("e-broken", "", broken),
            ],
        }
    }
}
