//! The report as one JSON document.

use super::super::verdict::{CaseStatus, MetricDifference};
use super::suite_report::{CaseReport, SuiteReport};
use serde_json::{Map, Value, json};

/// Writes the document that `--json` prints.
pub fn json_report(report: &SuiteReport) -> Value {
    let count = |status| report.count_cases(status);
    json!({
        "suite": report.suite,
        "how": report.how,
        "passed": count(CaseStatus::Passed),
        "failed": count(CaseStatus::Failed),
        "skipped": count(CaseStatus::Skipped),
        "blessed": count(CaseStatus::Blessed),
        "cases": report.cases.iter().map(case_json).collect::<Vec<_>>(),
    })
}

fn case_json(case: &CaseReport) -> Value {
    let reasons = case.verdict.reasons.iter();
    let mut value = json!({
        "name": case.name,
        "title": case.title,
        "model": case.model,
        "status": case.verdict.status.name(),
        "identical": case.verdict.identical,
        "digest": case.digest,
        "storedDigest": case.stored_digest,
        "reasons": reasons.map(|r| json!({"code": r.code, "text": r.text})).collect::<Vec<_>>(),
        "metrics": case.verdict.measures.iter().map(difference_json).collect::<Vec<_>>(),
        "notes": case.notes,
    });
    if let (Some(inputs), Value::Object(fields)) = (&case.inputs, &mut value) {
        fields.insert("inputs".into(), json!({"model": inputs.model, "job": inputs.job}));
    }
    value
}

/// Writes one metric. Numbers that could not be told are absent.
fn difference_json(difference: &MetricDifference) -> Value {
    let mut fields = Map::new();
    fields.insert("name".into(), difference.metric.name().into());
    let numbers = [
        ("value", difference.value),
        ("stored", difference.stored),
        ("difference", difference.difference),
        ("allowed", Some(difference.allowed)),
    ];
    for (name, number) in numbers {
        if let Some(number) = number {
            fields.insert(name.into(), number.into());
        }
    }
    for (name, text) in [("reason", &difference.reason), ("place", &difference.place)] {
        if !text.is_empty() {
            fields.insert(name.into(), text.as_str().into());
        }
    }
    fields.insert("holds".into(), difference.is_within_bound().into());
    Value::Object(fields)
}

#[cfg(test)]
mod tests {
    use super::super::samples;

    #[test]
    fn the_document_says_what_was_found() {
        let value = super::json_report(&samples::sample_suite());
        assert_eq!(
            (&value["passed"], &value["failed"], &value["skipped"]),
            (&2.into(), &2.into(), &1.into())
        );
        let failed = &value["cases"][3];
        assert_eq!(failed["status"], "failed");
        assert_eq!(failed["metrics"][1]["name"], "flippedTriangles");
        assert_eq!(failed["metrics"][1]["difference"], 2.0);
        assert_eq!(failed["metrics"][1]["holds"], false);
        assert_eq!(value["cases"][4]["reasons"][0]["code"], "not-run");
        assert_eq!(value["cases"][0]["inputs"]["model"], "aa");
    }
}
