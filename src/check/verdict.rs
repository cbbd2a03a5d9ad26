//! Whether a result passes, and if not, why: in a fixed order, each reason with a word of its own.

use super::case_result::{CaseResult, TopologyDigests};
use super::comparison::{GoldenComparison, compare_with_golden};
use super::golden::{Golden, InputHashes};
use super::metric::{Metric, MetricKind, Tolerances, format_short};
use super::named::{self, Named};
use super::number;
use crate::pool::Pool;
use crate::wire::pb;
use serde::{Deserialize, Serialize};

/// How a case ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CaseStatus {
    /// It equals the stored result bit for bit, or within tolerances.
    Passed,
    /// It does not pass.
    #[default]
    Failed,
    /// It could not be run here.
    Skipped,
    /// Its golden was stored.
    Blessed,
}

impl Named for CaseStatus {
    const WHAT: &'static str = "a status of a case";
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Passed, "passed"),
        (Self::Failed, "failed"),
        (Self::Skipped, "skipped"),
        (Self::Blessed, "blessed"),
    ];
}

/// What can be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum ReasonCode {
    NotFinite,
    MissingGolden,
    BrokenGolden,
    StaleGolden,
    NotRun,
    Skipped,
    Topology,
    Winding,
    Frames,
    Digest,
    Expectation,
    Metric,
}

impl Named for ReasonCode {
    const WHAT: &'static str = "a reason";
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::NotFinite, "not-finite"),
        (Self::MissingGolden, "missing-golden"),
        (Self::BrokenGolden, "broken-golden"),
        (Self::StaleGolden, "stale-golden"),
        (Self::NotRun, "not-run"),
        (Self::Skipped, "skipped"),
        (Self::Topology, "topology"),
        (Self::Winding, "winding"),
        (Self::Frames, "frames"),
        (Self::Digest, "digest"),
        (Self::Expectation, "expectation"),
        (Self::Metric, "metric"),
    ];
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VerdictReason {
    /// A stable word.
    #[serde(with = "named")]
    pub code: ReasonCode,
    /// What, in a sentence.
    pub text: String,
}

/// One number beside its golden. In JSON unknown numbers are absent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MetricDifference {
    /// What it is.
    #[serde(rename = "name", with = "named")]
    pub metric: Metric,
    /// Of the result; `None` when unknown.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "number")]
    pub value: Option<f64>,
    /// In the golden; `None` for what is measured against the stored positions.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "number")]
    pub stored: Option<f64>,
    /// What is compared with `allowed`; `None` when there is nothing to compare.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "number")]
    pub difference: Option<f64>,
    /// The largest difference that passes.
    pub allowed: f64,
    /// Why that is not 0.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// Where it is worst; maybe empty.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub place: String,
    /// Whether the difference is within what is allowed.
    pub holds: bool,
    /// Whether the shape has such a number at all; an open surface has no volume. Absent in JSON when true.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub applies: bool,
}

fn yes() -> bool {
    true
}

fn is_yes(value: &bool) -> bool {
    *value
}

impl MetricDifference {
    /// Finds whether the difference is within what is allowed.
    pub(super) fn judge(&mut self) {
        self.holds = self.difference.is_none_or(|d| d <= self.allowed);
    }

    /// The difference as a share of what is allowed.
    pub fn share_of_bound(&self) -> f64 {
        match self.difference {
            Some(d) if d > 0.0 => d / self.allowed,
            _ => 0.0,
        }
    }

    /// What stands for people where there is no number.
    pub fn absent_word(&self) -> &'static str {
        if self.applies { "not reported" } else { "n/a" }
    }

    /// Writes the difference and what is allowed, for people.
    pub fn describe(&self) -> String {
        let name = self.metric.name();
        let Some(difference) = self.difference else {
            return format!("{name} {}", self.absent_word());
        };
        let more = match (self.metric.kind(), self.value, self.stored) {
            (MetricKind::Shape, ..) => String::new(),
            (_, Some(value), Some(stored)) => format!(
                " ({} -> {})",
                self.metric.format_value(stored),
                self.metric.format_value(value)
            ),
            _ => String::new(),
        };
        let place = if self.place.is_empty() {
            String::new()
        } else {
            format!(", {}", self.place)
        };
        format!(
            "{name} {}, limit {}{more}{place}",
            self.metric.format_value(difference),
            self.metric.format_value(self.allowed)
        )
    }
}

/// A case verdict is what is said of a case.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseVerdict {
    /// How it ended.
    pub status: CaseStatus,
    /// What is wrong, most basic first; for a skipped case, why.
    pub reasons: Vec<VerdictReason>,
    /// Whether positions are bit-identical to the golden's.
    pub identical: bool,
    /// All numbers; empty when there was nothing to compare.
    pub measures: Vec<MetricDifference>,
}

impl CaseVerdict {
    /// Makes the verdict of a case that has no result.
    pub fn without_result(status: CaseStatus, code: ReasonCode, text: impl Into<String>) -> Self {
        Self {
            status,
            reasons: vec![VerdictReason {
                code,
                text: text.into(),
            }],
            identical: false,
            measures: Vec::new(),
        }
    }
}

/// Finds the number that is nearest to its bound, or farthest beyond it; `None` when none differs.
pub(super) fn largest_share(measures: &[MetricDifference]) -> Option<&MetricDifference> {
    farthest(measures.iter().filter(|m| m.share_of_bound() > 0.0))
}

/// The number that has the largest share of its bound; the first of several.
pub(super) fn farthest<'a>(measures: impl Iterator<Item = &'a MetricDifference>) -> Option<&'a MetricDifference> {
    measures.reduce(|worst, m| {
        if m.share_of_bound() > worst.share_of_bound() {
            m
        } else {
            worst
        }
    })
}

/// Judges a result. `golden` is what the golden's file holds, or the reason why it cannot be read.
pub fn judge_result(
    found: &CaseResult,
    golden: Option<Result<Golden, String>>,
    inputs: &InputHashes,
    tolerances: &Tolerances,
    expect: Option<&pb::Expect>,
    pool: &Pool,
) -> (CaseVerdict, Option<GoldenComparison>) {
    let failed = |code, text: String| (CaseVerdict::without_result(CaseStatus::Failed, code, text), None);
    if let Some(text) = found.describe_not_finite() {
        return failed(ReasonCode::NotFinite, text);
    }
    let golden = match golden {
        None => {
            return failed(
                ReasonCode::MissingGolden,
                "there is no golden; look at the result and bless it".into(),
            );
        }
        Some(Err(text)) => {
            let text = format!("{text}; look at the result and bless it again");
            return failed(ReasonCode::BrokenGolden, text);
        }
        Some(Ok(golden)) => golden,
    };
    let comparison = compare_with_golden(found, &golden, pool);
    let same_digest = found.digest == golden.digest;
    let mut reasons = topology_reasons(found, &golden);
    reasons.extend(frames_reason(found, &golden, tolerances));
    let measures = measure_differences(found, &golden, &comparison, tolerances);
    // Of a server only the digest of what it has is known, so what it sent must be the stored shape too.
    let sent = comparison.numbers.get(&Metric::MaxDisplacement).copied();
    let identical = reasons.is_empty() && same_digest && sent == Some(0.0);
    if reasons.is_empty() && !identical {
        let over = measures.iter().filter(|m| !m.holds);
        reasons.extend(over.map(|m| VerdictReason {
            code: ReasonCode::Metric,
            text: m.describe(),
        }));
        if same_digest {
            let text = "the digest is the stored one, the positions that came with it are not".into();
            reasons.insert(
                0,
                VerdictReason {
                    code: ReasonCode::Digest,
                    text,
                },
            );
        } else if !tolerances.allow_any() {
            reasons.insert(0, digest_reason(found, &golden, sent == Some(0.0)));
        }
    }
    let expectations = found
        .unmet
        .iter()
        .cloned()
        .chain(unmet_expectations(expect, &comparison, &golden));
    reasons.extend(expectations.map(|text| VerdictReason {
        code: ReasonCode::Expectation,
        text,
    }));
    // What differs from a stale golden is reported too, so that no change is blessed unseen.
    if let Some(text) = golden.stale_reason(inputs) {
        let code = ReasonCode::StaleGolden;
        reasons.insert(0, VerdictReason { code, text });
    }
    let verdict = CaseVerdict {
        status: if reasons.is_empty() {
            CaseStatus::Passed
        } else {
            CaseStatus::Failed
        },
        reasons,
        identical,
        measures,
    };
    (verdict, Some(comparison))
}

/// What is wrong with the frames of an animation: their number, or the first that is another one.
fn frames_reason(found: &CaseResult, golden: &Golden, tolerances: &Tolerances) -> Option<VerdictReason> {
    let (count, stored) = (found.frames.len(), golden.frames.len());
    let text = if count != stored {
        format!("there are {count} frames, stored are {stored}")
    } else {
        let differing = found.frames.iter().zip(&golden.frames).enumerate();
        let mut differing = differing.filter(|(_, (now, then))| now != then);
        let (first, (now, then)) = differing.next().filter(|_| !tolerances.allow_any())?;
        let many = 1 + differing.count();
        format!(
            "{many} of {count} frames differ; the digest of the first of them, number {first}, is {now}, stored is {then}"
        )
    };
    Some(VerdictReason {
        code: ReasonCode::Frames,
        text,
    })
}

fn digest_reason(found: &CaseResult, golden: &Golden, too_small: bool) -> VerdictReason {
    let mut text = format!(
        "the digest is {}, stored is {}, and no tolerance allows a difference",
        found.digest, golden.digest
    );
    if too_small {
        let resolution = format_short(golden.positions.resolution());
        text +=
            &format!("; no vertex has moved by more than the resolution of the golden, {resolution} of the diagonal");
    }
    VerdictReason {
        code: ReasonCode::Digest,
        text,
    }
}

fn topology_reasons(found: &CaseResult, golden: &Golden) -> Vec<VerdictReason> {
    let now = TopologyDigests::from_triangles(found.positions.len(), &found.triangles);
    let stored = &golden.topology;
    let (code, text) = if (now.vertices, now.triangles) != (stored.vertices, stored.triangles) {
        let text = format!(
            "the topology differs: {} -> {} vertices, {} -> {} triangles",
            stored.vertices, now.vertices, stored.triangles, now.triangles
        );
        (ReasonCode::Topology, text)
    } else if now.digest == stored.digest {
        return Vec::new();
    } else if now.unwound == stored.unwound {
        let flips = golden
            .triangles
            .as_ref()
            .map(|t| t.iter().zip(&found.triangles).filter(|(a, b)| a != b).count());
        let many = flips.map_or("some".into(), |n| n.to_string());
        (
            ReasonCode::Winding,
            format!("the topology differs: {many} triangles are wound differently"),
        )
    } else {
        let text = format!(
            "the topology differs: {} vertices and {} triangles as stored, but joined differently",
            now.vertices, now.triangles
        );
        (ReasonCode::Topology, text)
    };
    vec![VerdictReason { code, text }]
}

fn measure_differences(
    found: &CaseResult,
    golden: &Golden,
    comparison: &GoldenComparison,
    tolerances: &Tolerances,
) -> Vec<MetricDifference> {
    let of = |metric: Metric| {
        let tolerance = tolerances.for_metric(metric);
        let applies = found.has_metric(metric);
        let (value, stored, difference) = match metric.kind() {
            MetricKind::Shape => {
                let value = comparison.numbers.get(&metric).copied();
                (value, None, value)
            }
            kind => {
                let (value, stored) = (
                    found.numbers.get(&metric).copied(),
                    golden.numbers.get(&metric).copied(),
                );
                // Goldens of before open surfaces were reported apart hold a volume that stands for none.
                let stored = stored.filter(|_| applies);
                let difference = value.zip(stored).map(|(now, stored)| match kind {
                    MetricKind::Growth => (now - stored).max(0.0),
                    _ => (now - stored).abs(),
                });
                (value, stored, difference)
            }
        };
        MetricDifference {
            metric,
            applies,
            value,
            stored,
            difference,
            allowed: tolerance.most,
            reason: tolerance.reason,
            place: comparison.places.get(&metric).cloned().unwrap_or_default(),
            holds: difference.is_none_or(|d| d <= tolerance.most),
        }
    };
    Metric::all().map(of).collect()
}

/// Lists what the job expects of the stored result and does not find. Lengths are model units there.
fn unmet_expectations(expect: Option<&pb::Expect>, comparison: &GoldenComparison, golden: &Golden) -> Vec<String> {
    let Some(expect) = expect else { return Vec::new() };
    let length = |metric: Metric| {
        comparison
            .numbers
            .get(&metric)
            .map(|share| share * golden.positions.diagonal())
    };
    let angle = length(Metric::MaxDisplacement).map(|_| comparison.largest_angle);
    let bounds = [
        ("maxDistance", length(Metric::MaxDisplacement), expect.max_distance),
        ("meanDistance", length(Metric::MeanDisplacement), expect.mean_distance),
        ("normalDegrees", angle, expect.normal_degrees),
    ];
    let over = bounds
        .into_iter()
        .filter_map(|(name, value, most)| Some((name, value?, most?)));
    over.filter(|(_, value, most)| value > most)
        .map(|(name, value, most)| {
            format!(
                "{name} is {}, at most {} expected",
                format_short(value),
                format_short(most)
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::engine::digest;
    use glam::DVec3;

    fn inputs() -> InputHashes {
        InputHashes {
            model: "m".into(),
            job: "j".into(),
        }
    }

    fn found() -> CaseResult {
        let (positions, triangles) = shapes::icosphere(1.0, 3);
        CaseResult {
            digest: digest(&positions),
            before: (positions.clone(), triangles.clone()),
            positions,
            triangles,
            numbers: [(Metric::Cycles, 5.0), (Metric::VolumeChange, -0.01)].into(),
            ..Default::default()
        }
    }

    fn moved(by: f64) -> CaseResult {
        let mut found = found();
        found.positions[7] += DVec3::X * by;
        found.digest = digest(&found.positions);
        found
    }

    fn tolerances(text: &str) -> Tolerances {
        let list: Vec<crate::check::metric::ToleranceEntry> = serde_json::from_str(text).expect("a list");
        Tolerances::from_entries(&list).expect("nothing is wrong")
    }

    fn judged(now: &CaseResult, tolerances: &Tolerances, expect: Option<&pb::Expect>) -> CaseVerdict {
        let golden = Golden::from_result(&found(), inputs());
        let pool = Pool::new(1).expect("a thread");
        judge_result(now, Some(Ok(golden)), &inputs(), tolerances, expect, &pool).0
    }

    fn codes(verdict: &CaseVerdict) -> Vec<&str> {
        verdict.reasons.iter().map(|r| r.code.name()).collect()
    }

    #[test]
    fn the_same_bits_pass_whatever_else_is_counted() {
        let verdict = judged(&found(), &Tolerances::default(), None);
        assert!(
            verdict.identical && verdict.status == CaseStatus::Passed && largest_share(&verdict.measures).is_none()
        );
        let mut slower = found();
        slower.numbers.insert(Metric::Cycles, 9.0);
        assert_eq!(judged(&slower, &Tolerances::default(), None).status, CaseStatus::Passed);
    }

    #[test]
    fn without_a_tolerance_the_smallest_difference_fails() {
        let tiny = judged(&moved(1e-13), &Tolerances::default(), None);
        assert_eq!(codes(&tiny), ["digest"]);
        assert!(
            tiny.reasons[0].text.contains("more than the resolution of the golden"),
            "{}",
            tiny.reasons[0].text
        );
        let small = judged(&moved(1e-3), &Tolerances::default(), None);
        assert_eq!(codes(&small)[..2], ["digest", "metric"]);
        assert!(
            small
                .reasons
                .iter()
                .any(|r| r.text.contains("maxDisplacement") && r.text.contains("vertex 7"))
        );
        assert_eq!(
            largest_share(&small.measures).map(|m| m.metric),
            Some(Metric::MaxDisplacement)
        );
    }

    #[test]
    fn only_what_is_over_its_own_bound_fails() {
        let most = |metrics: &str, most: f64| {
            tolerances(&format!(
                r#"[{{"metrics": [{metrics}], "most": {most}, "reason": "a test"}}]"#
            ))
        };
        let shape = r#""maxDisplacement", "normalDegrees", "edgeStretch""#;
        assert_eq!(judged(&moved(1e-3), &most(shape, 0.1), None).status, CaseStatus::Passed);
        let tight = judged(&moved(1e-3), &most(shape, 1e-5), None);
        assert!(codes(&tight).iter().all(|c| *c == "metric") && tight.status == CaseStatus::Failed);
        // More cycles are worse, fewer are not; volume counts either way.
        let mut other = moved(1e-13);
        other
            .numbers
            .extend([(Metric::Cycles, 4.0), (Metric::VolumeChange, -0.01)]);
        assert_eq!(judged(&other, &most(shape, 1e-5), None).status, CaseStatus::Passed);
        other.numbers.insert(Metric::Cycles, 6.0);
        let more = judged(&other, &most(shape, 1e-5), None);
        assert!(more.reasons.len() == 1 && more.reasons[0].text.starts_with("cycles 1, limit 0 (5 -> 6)"));
        other
            .numbers
            .extend([(Metric::Cycles, 5.0), (Metric::VolumeChange, -0.02)]);
        assert!(
            judged(&other, &most(shape, 1e-5), None).reasons[0]
                .text
                .starts_with("volumeChange")
        );
    }

    #[test]
    fn what_is_basic_is_reported_before_what_is_measured() {
        let pool = Pool::new(1).expect("a thread");
        let golden = || Some(Ok(Golden::from_result(&found(), inputs())));
        let code = |found: &CaseResult, golden, inputs: &InputHashes| {
            let verdict = judge_result(found, golden, inputs, &Tolerances::default(), None, &pool).0;
            assert_eq!(verdict.status, CaseStatus::Failed);
            verdict.reasons[0].code.name()
        };
        let mut broken = moved(0.5);
        broken.positions[0].y = f64::NAN;
        assert_eq!(code(&broken, None, &inputs()), "not-finite");
        assert_eq!(code(&found(), None, &inputs()), "missing-golden");
        assert_eq!(code(&found(), Some(Err("cut off".into())), &inputs()), "broken-golden");
        let other = InputHashes {
            job: "k".into(),
            ..inputs()
        };
        assert_eq!(code(&moved(0.5), golden(), &other), "stale-golden");
        let mut wound = moved(0.5);
        wound.triangles[3].swap(0, 1);
        assert_eq!(code(&wound, golden(), &inputs()), "winding");
        wound.triangles.pop();
        assert_eq!(code(&wound, golden(), &inputs()), "topology");
    }

    #[test]
    fn a_job_can_expect_more_than_its_tolerances() {
        let loose = tolerances(
            r#"[{"metrics": ["maxDisplacement", "normalDegrees", "edgeStretch"], "most": 10, "reason": "a test"}]"#,
        );
        let expect = |text: &str| crate::wire::json::from_json::<pb::Expect>(text.as_bytes()).expect("an expectation");
        let passes = |text: &str| judged(&moved(1e-3), &loose, Some(&expect(text))).status == CaseStatus::Passed;
        assert!(passes(
            r#"{"maxDistance": 2e-3, "meanDistance": 1e-4, "normalDegrees": 5}"#
        ));
        for text in [
            r#"{"maxDistance": 5e-4}"#,
            r#"{"meanDistance": 1e-8}"#,
            r#"{"normalDegrees": 1e-3}"#,
        ] {
            let verdict = judged(&moved(1e-3), &loose, Some(&expect(text)));
            assert_eq!(codes(&verdict), ["expectation"], "{text}");
        }
    }
}
