//! Reports for the tests of this room.

use super::super::case_pictures::{CasePicture, PictureCaption};
use super::super::golden::InputHashes;
use super::super::metric::Metric;
use super::super::verdict::{CaseStatus, CaseVerdict, MetricDifference, ReasonCode, VerdictReason};
use super::{CaseReport, ShardFacts, SuiteReport};

fn sample_case(name: &str, title: &str, verdict: CaseVerdict) -> CaseReport {
    CaseReport {
        name: name.into(),
        title: title.into(),
        model: "models/bar.obj".into(),
        inputs: Some(InputHashes {
            model: "aa".into(),
            job: "bb".into(),
        }),
        status: verdict.status,
        identical: verdict.identical,
        digest: "xxh3:1".into(),
        stored_digest: "xxh3:2".into(),
        reasons: verdict.reasons,
        measures: verdict.measures,
        pictures: Vec::new(),
        notes: Vec::new(),
        milliseconds: None,
    }
}

fn sample_difference(metric: Metric, difference: f64, allowed: f64) -> MetricDifference {
    MetricDifference {
        metric,
        applies: true,
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
        holds: difference <= allowed,
    }
}

/// Makes a report with a case of each kind, with names and texts that try to break out.
pub(super) fn sample_suite() -> SuiteReport {
    let passed = CaseVerdict {
        status: CaseStatus::Passed,
        reasons: Vec::new(),
        identical: true,
        measures: vec![sample_difference(Metric::MaxDisplacement, 0.0, 0.0)],
    };
    let close = CaseVerdict {
        identical: false,
        measures: vec![sample_difference(Metric::MaxDisplacement, 5e-7, 1e-6)],
        ..passed.clone()
    };
    let measures = vec![
        sample_difference(Metric::MaxDisplacement, 3e-4, 0.0),
        sample_difference(Metric::FlippedTriangles, 2.0, 0.0),
        sample_difference(Metric::NormalDegrees, 0.0, 0.0),
    ];
    let failed = CaseVerdict {
        status: CaseStatus::Failed,
        reasons: measures[..2]
            .iter()
            .map(|m| VerdictReason {
                code: ReasonCode::Metric,
                text: m.describe(),
            })
            .collect(),
        identical: false,
        measures,
    };
    let skipped = CaseVerdict::without_result(CaseStatus::Skipped, ReasonCode::Skipped, "data:arm.off is absent");
    let broken = CaseVerdict::without_result(CaseStatus::Failed, ReasonCode::NotRun, "a <b> & \"c\" \u{1}]]>");
    let mut shown = sample_case("d-failed", "<script>alert('x')</script> & more", failed);
    shown.pictures.push(CasePicture {
        caption: PictureCaption::After,
        description: "a \"shape\" <b>".into(),
        size: [4, 3],
        png: vec![1, 2, 3],
    });
    shown.notes.push("a <note>".into());
    SuiteReport {
        suite: "su<i>te".into(),
        how: "in process".into(),
        notes: vec!["a <folder>".into()],
        shard: None,
        cases: vec![
            sample_case("a-passed", "", passed),
            sample_case("b-close", "", close),
            sample_case("c-skipped", "", skipped),
            shown,
            sample_case("e-broken", "", broken),
        ],
    }
}

/// Makes what the report of a shard says beside its cases; no split has its digest.
pub(super) fn sample_shard(number: u32, of: u32) -> ShardFacts {
    ShardFacts {
        number,
        of,
        cases: 5,
        suite: "sha256:suite".into(),
        split: "sha256:split".into(),
        build: "0.1.0".into(),
    }
}
