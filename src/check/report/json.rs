//! The report as one JSON document: what `--json` prints, and what `--merge` and `--costs` read.

use super::super::case::{SuiteError, from_json_object, suite_error};
use super::super::shard::Shard;
use super::super::verdict::CaseStatus;
use super::{CaseReport, ShardFacts, SuiteReport, printable};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A suite report with how many of its cases ended how.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReportFile {
    suite: String,
    how: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shard: Option<ShardFacts>,
    passed: usize,
    failed: usize,
    skipped: usize,
    blessed: usize,
    #[serde(default)]
    notes: Vec<String>,
    cases: Vec<CaseReport>,
}

/// Makes the document that `--json` prints, maybe with the pictures of its cases.
///
/// # Errors
/// In words; never for what is in memory.
pub fn json_report(report: &SuiteReport, with_pictures: bool) -> Result<Value, String> {
    let count = |status| report.count_cases(status);
    let mut file = ReportFile {
        suite: report.suite.clone(),
        how: report.how.clone(),
        shard: report.shard.clone(),
        passed: count(CaseStatus::Passed),
        failed: count(CaseStatus::Failed),
        skipped: count(CaseStatus::Skipped),
        blessed: count(CaseStatus::Blessed),
        notes: report.notes.clone(),
        cases: report.cases.clone(),
    };
    if !with_pictures {
        file.cases.iter_mut().for_each(|case| case.pictures.clear());
    }
    serde_json::to_value(file).map_err(|e| e.to_string())
}

/// Reads such a document. `file` names it in texts.
///
/// # Errors
/// What is wrong with it and where.
pub fn read_report(file: &str, text: &[u8]) -> Result<SuiteReport, SuiteError> {
    let mut read: ReportFile = from_json_object(file, text).map_err(|e| SuiteError {
        problem: printable(&e.problem),
        ..e
    })?;
    if let Some(facts) = &read.shard {
        Shard::new(facts.number, facts.of).map_err(|problem| suite_error(file, "shard", problem))?;
    }
    let measures = read.cases.iter_mut().flat_map(|case| &mut case.measures);
    measures.for_each(|measure| measure.judge());
    Ok(SuiteReport {
        suite: read.suite,
        how: read.how,
        notes: read.notes,
        shard: read.shard,
        cases: read.cases,
    })
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

    /// How every PNG file begins.
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

    fn refused(text: &str) -> String {
        read_report("r.json", text.as_bytes()).expect_err(text).to_string()
    }

    #[test]
    fn the_document_says_what_was_found() {
        let value = json_report(&samples::sample_suite(), false).expect("written");
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
        assert!(failed.get("pictures").is_none() && value.get("shard").is_none());
    }

    #[test]
    fn a_report_comes_back_as_it_was() {
        let mut report = samples::sample_suite();
        report.shard = Some(samples::sample_shard(2, 3));
        report.cases[3].pictures[0].png = [PNG, &[1, 2, 3]].concat();
        report.cases[0].milliseconds = Some(0.1 + 0.2);
        let measures = &mut report.cases[3].measures;
        measures[0].value = Some(0.1 + 0.2);
        measures[0].difference = Some(f64::INFINITY);
        measures[1].stored = Some(f64::NEG_INFINITY);
        measures[2].applies = false;
        measures[2].difference = None;
        let text = json_report(&report, true).expect("written").to_string();
        assert_eq!(read_report("r.json", text.as_bytes()), Ok(report.clone()));
        // Without pictures all else is there.
        let text = json_report(&report, false).expect("written").to_string();
        report.cases[3].pictures.clear();
        assert_eq!(read_report("r.json", text.as_bytes()), Ok(report));
    }

    #[test]
    fn what_is_wrong_with_a_report_is_reported_with_its_place() {
        let mut report = samples::sample_suite();
        report.shard = Some(samples::sample_shard(2, 3));
        report.cases[3].pictures[0].png = PNG.to_vec();
        report.cases[0].milliseconds = Some(1.5);
        let text = json_report(&report, true).expect("written").to_string();
        for (from, to, words) in [
            ("\"number\":2", "\"number\":4", "shard: there is no shard 4 of 3"),
            (
                "\"name\":\"a-passed\"",
                "\"name\":\"a passed\"",
                "cases[0].name: \"a passed\" is not the name of a case",
            ),
            (
                "\"status\":\"passed\"",
                "\"status\":\"fine\"",
                "cases[0].status: \"fine\"",
            ),
            (
                "\"code\":\"metric\"",
                "\"code\":\"<b>\"",
                "cases[3].reasons[0].code: \"<b>\"",
            ),
            (
                "\"name\":\"maxDisplacement\"",
                "\"name\":\"most\"",
                "cases[0].metrics[0].name: \"most\"",
            ),
            (
                "\"caption\":\"after\"",
                "\"caption\":\"<i>\"",
                "cases[3].pictures[0].caption: \"<i>\"",
            ),
            (
                "\"png\":\"iVBO",
                "\"png\":\"AAAA",
                "cases[3].pictures[0].png: is not a PNG file",
            ),
            (
                "\"png\":\"iVBO",
                "\"png\":\"####",
                "cases[3].pictures[0].png: is not base64",
            ),
            (
                "\"milliseconds\":1.5",
                "\"milliseconds\":-1.5",
                "cases[0].milliseconds: is -1.5",
            ),
            ("\"how\"", "\"where\"", "where"),
            ("\"suite\"", "\"suite\":3,\"x\"", "suite"),
        ] {
            let broken = text.replacen(from, to, 1);
            assert_ne!(broken, text, "{from}");
            let reported = refused(&broken);
            assert!(
                reported.starts_with("r.json: ") && reported.contains(words),
                "{reported}"
            );
        }
        assert!(refused("[]").contains("a JSON object"));
    }
}
