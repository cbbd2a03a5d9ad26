//! One line a case, for people at a terminal.

use super::super::golden::Golden;
use super::super::metric::{Metric, MetricKind};
use super::super::verdict::{CaseStatus, CaseVerdict, MetricDifference, VerdictReason};
use super::suite_report::{CaseReport, SuiteReport, printable};

/// The line of a case; `width` is that of the longest name.
pub fn case_line(case: &CaseReport, width: usize) -> String {
    let word = match case.verdict.status {
        CaseStatus::Failed => "FAILED",
        other => other.name(),
    };
    let text = printable(&verdict_line(&case.verdict)).replace(['\n', '\r', '\t'], " ");
    format!("{word:<8} {:<width$}  {text}", case.name)
}

/// What matters most of a verdict: what is wrong, or the number that is nearest to its bound.
pub(super) fn verdict_line(verdict: &CaseVerdict) -> String {
    let reasons = &verdict.reasons;
    let Some(first) = reasons.first() else {
        return match verdict.largest_share() {
            _ if verdict.status == CaseStatus::Blessed && verdict.identical => "as it was".into(),
            _ if verdict.status == CaseStatus::Blessed => "stored".into(),
            _ if verdict.identical => "identical".into(),
            Some(worst) => format!("within tolerance: {}", worst.describe()),
            None => "within tolerance".into(),
        };
    };
    let has = |code: &str| reasons.iter().any(|r| r.code == code);
    let tell = |r: &VerdictReason| format!("{}: {}", r.code, r.text);
    let mut parts = Vec::new();
    // What is more basic than numbers comes before them, as in the list of reasons.
    if !matches!(first.code, "metric" | "expectation") {
        parts.push(tell(first));
    }
    let over: Vec<&MetricDifference> = verdict.measures.iter().filter(|m| !m.is_within_bound()).collect();
    if let Some(worst) = worst_difference(&over).filter(|_| has("metric")) {
        parts.push(worst.describe());
        let more = over.iter().filter(|m| m.metric != worst.metric);
        let more: Vec<&str> = more.map(|m| m.metric.name()).collect();
        if !more.is_empty() {
            parts.push(format!("also {}", more.join(", ")));
        }
    }
    parts.extend(reasons.iter().find(|r| r.code == "expectation").map(tell));
    parts.join("; ")
}

/// The number over its bound to report: turned triangles, else the largest share of its bound.
fn worst_difference<'a>(over: &[&'a MetricDifference]) -> Option<&'a MetricDifference> {
    let turned = |m: &&&MetricDifference| matches!(m.metric, Metric::FlippedTriangles | Metric::FoldedTriangles);
    if let Some(m) = over.iter().find(turned) {
        return Some(m);
    }
    let mut worst: Option<&MetricDifference> = None;
    for m in over {
        if worst.is_none_or(|w| m.share_of_bound() > w.share_of_bound()) {
            worst = Some(m);
        }
    }
    worst
}

/// The line of something that someone should know.
pub fn note_line(note: &str) -> String {
    format!("note: {}", printable(note).replace(['\n', '\r', '\t'], " "))
}

/// The last line: how many cases ended how.
pub fn summary_line(report: &SuiteReport) -> String {
    let counts: Vec<String> = [
        CaseStatus::Passed,
        CaseStatus::Failed,
        CaseStatus::Skipped,
        CaseStatus::Blessed,
    ]
    .into_iter()
    .map(|status| (report.count_cases(status), status.name()))
    .filter(|(n, _)| *n > 0)
    .map(|(n, name)| format!("{n} {name}"))
    .collect();
    let (told, how) = (counts.join(", "), printable(&report.how));
    match &report.shard {
        None => format!("{} cases {how}: {told}", report.cases.len()),
        Some(facts) if report.cases.is_empty() => {
            let (shard, of) = (facts.shard, facts.cases);
            format!("shard {shard} has no case: all {of} cases of the suite are in other shards")
        }
        Some(facts) => {
            let (shard, of) = (facts.shard, facts.cases);
            format!("shard {shard}, {} of {of} cases {how}: {told}", report.cases.len())
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
    for metric in Metric::ALL {
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
    use super::super::samples;
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
        other.verdict.reasons.insert(0, VerdictReason { code: "digest", text });
        let text = "flippedTriangles is 2, at most 0 expected".into();
        other.verdict.reasons.push(VerdictReason {
            code: "expectation",
            text,
        });
        let told = case_line(&other, 10);
        assert!(
            told.starts_with(
                "FAILED   d-failed    digest: the digest is xxh3:1, stored is xxh3:2; flippedTriangles 2, limit 0"
            ),
            "the first line has the first reason: {told}"
        );
        assert!(told.ends_with("; also maxDisplacement; expectation: flippedTriangles is 2, at most 0 expected"));
        other.verdict.reasons.retain(|r| r.code == "expectation");
        assert_eq!(
            verdict_line(&other.verdict),
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
