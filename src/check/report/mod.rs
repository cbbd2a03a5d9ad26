//! Reports of a suite: lines for people, JSON, JUnit XML, and a page with pictures.
//!
//! Reports depend only on the cases' results. They contain no thread count, and times only on request, so equal results
//! give equal reports. The JSON document holds everything; shards are joined from it.

mod html;
mod json;
mod junit;
mod merge;
#[cfg(test)]
mod samples;

use super::case::{CASE_SUFFIX, check_case_name};
use super::case_pictures::CasePicture;
use super::golden::{Golden, InputHashes};
use super::metric::{Metric, MetricKind};
use super::named::{self, Named as _};
use super::verdict::{CaseStatus, CaseVerdict, MetricDifference, ReasonCode, VerdictReason, farthest, largest_share};
pub use html::html_report;
pub use json::{json_report, read_report};
pub use junit::junit_report;
pub use merge::merge_reports;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// A case report is the outcome of a case, run or not. Its fields are those of the JSON document.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
pub struct CaseReport {
    /// Its name.
    #[serde(deserialize_with = "read_name")]
    pub name: String,
    /// What it shows; maybe empty.
    pub title: String,
    /// Its model, as the case names it.
    pub model: String,
    /// How it ended.
    #[serde(with = "named")]
    pub status: CaseStatus,
    /// Whether positions are bit-identical to the golden's.
    pub identical: bool,
    /// Digest of its positions; empty when it was not run.
    pub digest: String,
    /// Digest in its golden; empty without one.
    pub stored_digest: String,
    /// What is wrong, most basic first; for a skipped case, why.
    pub reasons: Vec<VerdictReason>,
    /// All numbers; empty when there was nothing to compare.
    #[serde(rename = "metrics")]
    pub measures: Vec<MetricDifference>,
    /// What someone should know beside, such as why there is no picture.
    pub notes: Vec<String>,
    /// What its result depends on; `None` when it was not read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<InputHashes>,
    /// How long it took, run beside others; `None` unless requested.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "read_time")]
    pub milliseconds: Option<f64>,
    /// Pictures, for the page.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pictures: Vec<CasePicture>,
}

fn read_name<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let name = String::deserialize(deserializer)?;
    check_case_name(&name).map_err(D::Error::custom)?;
    Ok(name)
}

fn read_time<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    let time = Option::<f64>::deserialize(deserializer)?;
    match time.filter(|t| !(t.is_finite() && *t >= 0.0)) {
        Some(time) => Err(D::Error::custom(format!("is {time}, a number of at least 0 is needed"))),
        None => Ok(time),
    }
}

impl CaseReport {
    /// Takes what a verdict says.
    pub fn take_verdict(&mut self, verdict: CaseVerdict) {
        self.status = verdict.status;
        self.identical = verdict.identical;
        self.reasons = verdict.reasons;
        self.measures = verdict.measures;
    }
}

/// A suite report is the outcome of a suite or of a shard of it.
#[derive(Debug, Clone, PartialEq)]
pub struct SuiteReport {
    /// The name of its folder.
    pub suite: String,
    /// How its cases were run: `in process` or `on` a server.
    pub how: String,
    /// What someone should know of the suite's folder.
    pub notes: Vec<String>,
    /// Of a shard, what it is a part of.
    pub shard: Option<ShardFacts>,
    /// In the order of their names.
    pub cases: Vec<CaseReport>,
}

/// Shard facts say what a shard is a part of, so that nothing is joined that does not belong together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardFacts {
    /// Its number, from 1 on.
    pub number: u32,
    /// How many shards there are.
    pub of: u32,
    /// How many cases the whole suite has.
    pub cases: usize,
    /// Digest of the suite: of its cases, jobs and goldens.
    pub suite: String,
    /// Digest of the split: of which case is in which shard.
    pub split: String,
    /// The build that ran it.
    pub build: String,
}

impl fmt::Display for ShardFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl SuiteReport {
    /// Puts cases into the order in which a suite is run, which is that of the names of their files.
    fn sort_cases(&mut self) {
        self.cases.sort_by_cached_key(|c| format!("{}{CASE_SUFFIX}", c.name));
    }

    /// Counts the cases that ended so.
    pub fn count_cases(&self, status: CaseStatus) -> usize {
        self.cases.iter().filter(|c| c.status == status).count()
    }

    /// Counts the cases by how they ended, without what none did.
    fn counts(&self) -> Vec<(usize, &'static str)> {
        let counted = CaseStatus::NAMES
            .iter()
            .map(|(status, name)| (self.count_cases(*status), *name));
        counted.filter(|(count, _)| *count > 0).collect()
    }
}

/// Rewrites a text without the characters that no XML document may hold, each replaced by U+FFFD.
fn printable(text: &str) -> String {
    let allowed = |c: char| {
        // Marks of direction would show a text as another one.
        let turns = matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        matches!(c, '\t' | '\n' | '\r')
            || (c >= ' ' && !turns && !matches!(c, '\u{7f}'..='\u{9f}' | '\u{fffe}' | '\u{ffff}'))
    };
    text.chars().map(|c| if allowed(c) { c } else { '\u{fffd}' }).collect()
}

/// The line of a case; `width` is that of the longest name.
pub fn case_line(case: &CaseReport, width: usize) -> String {
    let word = match case.status {
        CaseStatus::Failed => "FAILED",
        other => other.name(),
    };
    let text = printable(&verdict_line(case)).replace(['\n', '\r', '\t'], " ");
    format!("{word:<8} {:<width$}  {text}", case.name)
}

/// What matters most of a verdict: what is wrong, or the number that is nearest to its bound.
fn verdict_line(case: &CaseReport) -> String {
    let Some(first) = case.reasons.first() else {
        return match (case.status == CaseStatus::Blessed, case.identical) {
            (true, true) => "as it was".into(),
            (true, false) => "stored".into(),
            (false, true) => "identical".into(),
            (false, false) => match largest_share(&case.measures) {
                Some(worst) => format!("within tolerance: {}", worst.describe()),
                None => "within tolerance".into(),
            },
        };
    };
    let describe = |r: &VerdictReason| format!("{}: {}", r.code.name(), r.text);
    let mut parts = Vec::new();
    // What is more basic than numbers comes before them, as in the list of reasons.
    if !matches!(first.code, ReasonCode::Metric | ReasonCode::Expectation) {
        parts.push(describe(first));
    }
    let over: Vec<&MetricDifference> = case.measures.iter().filter(|m| !m.holds).collect();
    // Turned triangles are reported before any other number.
    let turned = |m: &&&MetricDifference| matches!(m.metric, Metric::FlippedTriangles | Metric::FoldedTriangles);
    let worst = over.iter().find(turned).copied();
    let worst = worst.or_else(|| farthest(over.iter().copied()));
    let has_metric = case.reasons.iter().any(|r| r.code == ReasonCode::Metric);
    if let Some(worst) = worst.filter(|_| has_metric) {
        parts.push(worst.describe());
        let more = over.iter().filter(|m| m.metric != worst.metric);
        let more: Vec<&str> = more.map(|m| m.metric.name()).collect();
        if !more.is_empty() {
            parts.push(format!("also {}", more.join(", ")));
        }
    }
    let expected = case.reasons.iter().find(|r| r.code == ReasonCode::Expectation);
    parts.extend(expected.map(describe));
    parts.join("; ")
}

/// The line of something that someone should know.
pub fn note_line(note: &str) -> String {
    format!("note: {}", printable(note).replace(['\n', '\r', '\t'], " "))
}

/// The last line: how many cases ended how.
pub fn summary_line(report: &SuiteReport) -> String {
    let counts = report.counts().into_iter();
    let counts: Vec<String> = counts.map(|(count, name)| format!("{count} {name}")).collect();
    let (reported, how) = (counts.join(", "), printable(&report.how));
    match &report.shard {
        None => format!("{} cases {how}: {reported}", report.cases.len()),
        Some(facts) if report.cases.is_empty() => {
            let of = facts.cases;
            format!("shard {facts} has no case: all {of} cases of the suite are in other shards")
        }
        Some(facts) => {
            let (here, of) = (report.cases.len(), facts.cases);
            format!("shard {facts}, {here} of {of} cases {how}: {reported}")
        }
    }
}

/// What a new golden changes, metric by metric; empty when it says the same. `measures` compare the new result with the
/// old golden.
pub fn describe_changes(old: Option<&Golden>, new: &Golden, measures: &[MetricDifference]) -> Vec<String> {
    let Some(old) = old else {
        let mut lines = vec![format!(
            "new: {} vertices, {} triangles, digest {}",
            new.topology.vertices, new.topology.triangles, new.digest
        )];
        lines.extend(
            new.numbers
                .iter()
                .map(|(m, x)| format!("{} {}", m.name(), m.format_value(*x))),
        );
        return lines;
    };
    let mut lines = Vec::new();
    let mut changed = |name: &str, old: &str, new: &str| {
        if old != new {
            lines.push(format!("{name} {old} -> {new}"));
        }
    };
    changed("model", &old.inputs.model, &new.inputs.model);
    changed("job", &old.inputs.job, &new.inputs.job);
    changed("digest", &old.digest, &new.digest);
    let count = |n: usize| n.to_string();
    changed("vertices", &count(old.topology.vertices), &count(new.topology.vertices));
    changed(
        "triangles",
        &count(old.topology.triangles),
        &count(new.topology.triangles),
    );
    changed("topology", &old.topology.digest, &new.topology.digest);
    for m in measures.iter().filter(|m| m.metric.kind() == MetricKind::Shape) {
        if m.difference.is_some_and(|d| d > 0.0) {
            lines.push(format!(
                "{} from the old golden {}",
                m.metric.name(),
                m.metric.format_value(m.difference.unwrap_or_default())
            ));
        }
    }
    for metric in Metric::all() {
        match (old.numbers.get(&metric), new.numbers.get(&metric)) {
            (a, b) if a == b => {}
            (a, b) => {
                let show = |x: Option<&f64>| x.map_or("n/a".into(), |x| metric.format_value(*x));
                lines.push(format!("{} {} -> {}", metric.name(), show(a), show(b)));
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::samples;
    use super::*;

    #[test]
    fn each_case_is_one_line_with_what_matters() {
        let suite = samples::sample_suite();
        let lines: Vec<String> = suite.cases.iter().map(|c| case_line(c, 10)).collect();
        assert_eq!(lines[0], "passed   a-passed    identical");
        assert!(
            lines[1].contains("within tolerance: maxDisplacement 5.00e-7, limit 1.00e-6"),
            "{}",
            lines[1]
        );
        assert!(lines[2].starts_with("skipped  c-skipped") && lines[2].contains("data:arm.off"));
        assert!(
            lines[3].starts_with("FAILED   d-failed    flippedTriangles 2, limit 0"),
            "{}",
            lines[3]
        );
        assert!(lines[3].ends_with("also maxDisplacement"));
        assert!(lines[4].contains("not-run: a <b> & \"c\" \u{fffd}"));
        assert!(lines.iter().all(|l| !l.contains('\n')));
        let mut other = suite.cases[3].clone();
        let text = "the digest is xxh3:1, stored is xxh3:2".into();
        other.reasons.insert(
            0,
            VerdictReason {
                code: ReasonCode::Digest,
                text,
            },
        );
        let text = "flippedTriangles is 2, at most 0 expected".into();
        other.reasons.push(VerdictReason {
            code: ReasonCode::Expectation,
            text,
        });
        let reported = case_line(&other, 10);
        assert!(
            reported.starts_with(
                "FAILED   d-failed    digest: the digest is xxh3:1, stored is xxh3:2; flippedTriangles 2, limit 0"
            ),
            "the first line has the first reason: {reported}"
        );
        assert!(reported.ends_with("; also maxDisplacement; expectation: flippedTriangles is 2, at most 0 expected"));
        other.reasons.retain(|r| r.code == ReasonCode::Expectation);
        assert_eq!(
            verdict_line(&other),
            "expectation: flippedTriangles is 2, at most 0 expected",
            "numbers that are not a reason are not reported"
        );
        assert_eq!(
            summary_line(&suite),
            "5 cases in process: 2 passed, 2 failed, 1 skipped"
        );
        let mut part = suite.clone();
        part.shard = Some(samples::sample_shard(2, 3));
        part.cases.truncate(3);
        assert_eq!(
            summary_line(&part),
            "shard 2/3, 3 of 5 cases in process: 2 passed, 1 skipped"
        );
        part.cases.clear();
        assert_eq!(
            summary_line(&part),
            "shard 2/3 has no case: all 5 cases of the suite are in other shards"
        );
    }
}
