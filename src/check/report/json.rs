//! The report as one JSON document: what `--json` prints, and what `--merge` and `--costs` read.

use super::super::case::{SuiteError, check_case_name, from_json_object, suite_error};
use super::super::case_pictures::CasePicture;
use super::super::golden::InputHashes;
use super::super::metric::Metric;
use super::super::shard::Shard;
use super::super::verdict::{CaseStatus, CaseVerdict, MetricDifference, VerdictReason};
use super::{CaseReport, ShardFacts, SuiteReport, printable};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// How every PNG file begins.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReportFile {
    suite: String,
    how: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shard: Option<ShardEntry>,
    passed: usize,
    failed: usize,
    skipped: usize,
    blessed: usize,
    #[serde(default)]
    notes: Vec<String>,
    cases: Vec<CaseEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardEntry {
    number: u32,
    of: u32,
    cases: usize,
    suite: String,
    split: String,
    build: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "camelCase")]
struct CaseEntry {
    name: String,
    title: String,
    model: String,
    status: String,
    identical: bool,
    digest: String,
    stored_digest: String,
    reasons: Vec<ReasonEntry>,
    metrics: Vec<MetricEntry>,
    notes: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    inputs: Option<InputHashes>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    milliseconds: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<PictureEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReasonEntry {
    code: String,
    text: String,
}

/// One metric. Unknown numbers are absent.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MetricEntry {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    value: Option<Number>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stored: Option<Number>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    difference: Option<Number>,
    allowed: Number,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    reason: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    place: String,
    holds: bool,
    /// Absent when true.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    applies: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PictureEntry {
    caption: String,
    description: String,
    size: [u32; 2],
    png: String,
}

/// A number as JSON has it, or, where it has none, its name: a difference of finite numbers may be none.
#[derive(Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, or \"Infinity\", \"-Infinity\" or \"NaN\"")]
enum Number {
    Finite(f64),
    Named(NumberName),
}

#[derive(Serialize, Deserialize)]
enum NumberName {
    Infinity,
    #[serde(rename = "-Infinity")]
    NegativeInfinity,
    NaN,
}

fn yes() -> bool {
    true
}

fn is_yes(value: &bool) -> bool {
    *value
}

impl From<f64> for Number {
    fn from(value: f64) -> Self {
        match value {
            v if v.is_finite() => Self::Finite(v),
            v if v.is_nan() => Self::Named(NumberName::NaN),
            v if v > 0.0 => Self::Named(NumberName::Infinity),
            _ => Self::Named(NumberName::NegativeInfinity),
        }
    }
}

impl From<Number> for f64 {
    fn from(number: Number) -> Self {
        match number {
            Number::Finite(value) => value,
            Number::Named(NumberName::Infinity) => Self::INFINITY,
            Number::Named(NumberName::NegativeInfinity) => Self::NEG_INFINITY,
            Number::Named(NumberName::NaN) => Self::NAN,
        }
    }
}

/// Makes the document that `--json` prints, maybe with the pictures of its cases.
///
/// # Errors
/// In words; never for what is in memory.
pub fn json_report(report: &SuiteReport, with_pictures: bool) -> Result<Value, String> {
    let count = |status| report.count_cases(status);
    let shard = report.shard.as_ref().map(|facts| ShardEntry {
        number: facts.shard.number(),
        of: facts.shard.of(),
        cases: facts.cases,
        suite: facts.suite.clone(),
        split: facts.split.clone(),
        build: facts.build.clone(),
    });
    let file = ReportFile {
        suite: report.suite.clone(),
        how: report.how.clone(),
        shard,
        passed: count(CaseStatus::Passed),
        failed: count(CaseStatus::Failed),
        skipped: count(CaseStatus::Skipped),
        blessed: count(CaseStatus::Blessed),
        notes: report.notes.clone(),
        cases: report.cases.iter().map(|c| case_entry(c, with_pictures)).collect(),
    };
    serde_json::to_value(file).map_err(|e| e.to_string())
}

/// Reads such a document. `file` names it in texts.
///
/// # Errors
/// What is wrong with it and where.
pub fn read_report(file: &str, text: &[u8]) -> Result<SuiteReport, SuiteError> {
    let refuse = |(place, problem): (String, String)| suite_error(file, &place, printable(&problem));
    let read: ReportFile = from_json_object(file, text)?;
    let shard = read.shard.map(|entry| {
        let shard = Shard::new(entry.number, entry.of).map_err(|problem| refuse(("shard".into(), problem)))?;
        Ok::<_, SuiteError>(ShardFacts {
            shard,
            cases: entry.cases,
            suite: entry.suite,
            split: entry.split,
            build: entry.build,
        })
    });
    let case = |(k, entry): (usize, CaseEntry)| {
        read_case(entry).map_err(|(place, problem)| refuse((format!("cases[{k}].{place}"), problem)))
    };
    Ok(SuiteReport {
        suite: read.suite,
        how: read.how,
        notes: read.notes,
        shard: shard.transpose()?,
        cases: read_each(read.cases, case)?,
    })
}

fn case_entry(case: &CaseReport, with_pictures: bool) -> CaseEntry {
    let reasons = case.verdict.reasons.iter().map(|r| ReasonEntry {
        code: r.code.into(),
        text: r.text.clone(),
    });
    let pictures = case.pictures.iter().filter(|_| with_pictures).map(|p| PictureEntry {
        caption: p.caption.into(),
        description: p.description.clone(),
        size: p.size,
        png: STANDARD.encode(&p.png),
    });
    CaseEntry {
        name: case.name.clone(),
        title: case.title.clone(),
        model: case.model.clone(),
        status: case.verdict.status.name().into(),
        identical: case.verdict.identical,
        digest: case.digest.clone(),
        stored_digest: case.stored_digest.clone(),
        reasons: reasons.collect(),
        metrics: case.verdict.measures.iter().map(metric_entry).collect(),
        notes: case.notes.clone(),
        inputs: case.inputs.clone(),
        milliseconds: case.milliseconds,
        pictures: pictures.collect(),
    }
}

fn metric_entry(difference: &MetricDifference) -> MetricEntry {
    MetricEntry {
        name: difference.metric.name().into(),
        value: difference.value.map(Number::from),
        stored: difference.stored.map(Number::from),
        difference: difference.difference.map(Number::from),
        allowed: difference.allowed.into(),
        reason: difference.reason.clone(),
        place: difference.place.clone(),
        holds: difference.is_within_bound(),
        applies: difference.applies,
    }
}

fn read_each<T, U, E>(entries: Vec<T>, read: impl FnMut((usize, T)) -> Result<U, E>) -> Result<Vec<U>, E> {
    entries.into_iter().enumerate().map(read).collect()
}

/// Reads a case. Errors are (place in the case, what is wrong).
fn read_case(entry: CaseEntry) -> Result<CaseReport, (String, String)> {
    check_case_name(&entry.name).map_err(|problem| ("name".to_owned(), problem))?;
    let Some(status) = CaseStatus::from_name(&entry.status) else {
        let problem = format!("\"{}\" is not a status of a case", entry.status);
        return Err(("status".into(), problem));
    };
    if let Some(took) = entry.milliseconds.filter(|t| !(t.is_finite() && *t >= 0.0)) {
        let problem = format!("is {took}, a number of at least 0 is needed");
        return Err(("milliseconds".into(), problem));
    }
    let reason = |(k, entry): (usize, ReasonEntry)| match VerdictReason::known_code(&entry.code) {
        Some(code) => Ok(VerdictReason { code, text: entry.text }),
        None => Err((
            format!("reasons[{k}].code"),
            format!("\"{}\" is not a reason of this version", entry.code),
        )),
    };
    let metric = |(k, entry): (usize, MetricEntry)| match Metric::from_name(&entry.name) {
        Some(metric) => Ok(MetricDifference {
            metric,
            applies: entry.applies,
            value: entry.value.map(f64::from),
            stored: entry.stored.map(f64::from),
            difference: entry.difference.map(f64::from),
            allowed: entry.allowed.into(),
            reason: entry.reason,
            place: entry.place,
        }),
        None => Err((
            format!("metrics[{k}].name"),
            format!("\"{}\" is not a metric of this version", entry.name),
        )),
    };
    let picture = |(k, entry): (usize, PictureEntry)| {
        read_picture(entry).map_err(|(place, problem)| (format!("pictures[{k}].{place}"), problem))
    };
    Ok(CaseReport {
        name: entry.name,
        title: entry.title,
        model: entry.model,
        inputs: entry.inputs,
        digest: entry.digest,
        stored_digest: entry.stored_digest,
        verdict: CaseVerdict {
            status,
            reasons: read_each(entry.reasons, reason)?,
            identical: entry.identical,
            measures: read_each(entry.metrics, metric)?,
        },
        pictures: read_each(entry.pictures, picture)?,
        notes: entry.notes,
        milliseconds: entry.milliseconds,
    })
}

fn read_picture(entry: PictureEntry) -> Result<CasePicture, (&'static str, String)> {
    let caption = CasePicture::known_caption(&entry.caption).ok_or_else(|| {
        (
            "caption",
            format!("\"{}\" is not a caption of this version", entry.caption),
        )
    })?;
    let png = STANDARD
        .decode(&entry.png)
        .map_err(|e| ("png", format!("is not base64: {e}")))?;
    if !png.starts_with(PNG) {
        return Err(("png", "is not a PNG file".into()));
    }
    Ok(CasePicture {
        caption,
        description: entry.description,
        size: entry.size,
        png,
    })
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

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
        let measures = &mut report.cases[3].verdict.measures;
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
