//! What edits say: refusals with field and reason, warnings of what was lost.

use super::*;
use crate::support::messages::DeformerMessages;
use pb::edit_request::{self as wire, merge};
use pliant::exec::Exec;

/// A tetrahedron as a file, `size` long.
fn other(size: f64) -> Vec<u8> {
    format!("v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n").into_bytes()
}

fn merged(model: Vec<u8>) -> pb::EditRequest {
    request(Operation::Merge(wire::Merge {
        source: Some(merge::Source::Model(model.into())),
        how: merge::How::Loose.into(),
        ..Default::default()
    }))
}

fn refusal(bench: &mut Deformer, request: &pb::EditRequest, shape: &ModelShape) -> String {
    let before = (digest(bench.rest()), bench.facts_message().solver);
    let told = edit(bench, request, shape).expect_err("it is refused").to_string();
    assert_eq!(
        (digest(bench.rest()), bench.facts_message().solver),
        before,
        "nothing has changed"
    );
    told
}

#[test]
fn a_merge_says_what_is_wrong_with_the_other_model() {
    let mut bench = held();
    let rest = bench.rest_shape();
    let told = refusal(&mut bench, &merged(b"AAAA".to_vec()), &rest);
    assert!(told.starts_with("merge.model: cannot be taken: "), "{told}");
    let nothing = request(Operation::Merge(wire::Merge::default()));
    let told = refusal(&mut bench, &nothing, &rest);
    assert!(told.starts_with("merge: names no other model"), "{told}");
    for size in [1e9, 1e-9] {
        let told = refusal(&mut bench, &merged(other(size)), &rest);
        assert!(told.starts_with("merge.transform: makes both together"), "{told}");
    }
    edit(&mut bench, &merged(other(1e3)), &rest).expect("large, but both can be told apart");
}

#[test]
fn a_curve_without_a_length_is_refused() {
    let mut bench = held();
    let rest = bench.rest_shape();
    let point = [0.5, 0.0, 0.1];
    let line = [point, point].concat();
    let inserted = |points| request(Operation::InsertCurve(wire::InsertCurve { points, closed: false }));
    let cut = |polyline, path| {
        let along = wire::Cut {
            polyline,
            path,
            ..Default::default()
        };
        request(Operation::Cut(along))
    };
    let curves = [
        cut(line.clone(), Vec::new()),
        cut(Vec::new(), vec![3, 3]),
        inserted(line),
    ];
    for request in curves {
        let told = refusal(&mut bench, &request, &rest);
        assert!(told.contains("all points lie at one place"), "{told}");
    }
    let points = vec![0.5, 0.0, 0.1, 0.5, f64::NAN, 0.3];
    let told = refusal(&mut bench, &inserted(points), &rest);
    assert!(told.starts_with("insertCurve.points[4]: "), "{told}");
    let points = vec![0.25; 3 * 5000];
    let told = refusal(&mut bench, &inserted(points), &rest);
    assert!(told.contains("2 to 4096 points"), "{told}");
}

#[test]
fn an_empty_region_says_which_shape_it_was_taken_in() {
    let mut bench = held();
    let up = shift(DVec3::new(0.0, 0.0, 5.0));
    let bent = solved(&mut bench, &[("top", up)]).shape();
    let nowhere = delete(above(50.0), false);
    let told = refusal(&mut bench, &nowhere, &bent);
    assert!(told.contains("taken in the current shape"), "{told}");
    let on = pb::edit_request::On::Rest.into();
    let told = refusal(&mut bench, &pb::EditRequest { on, ..nowhere }, &bent);
    assert!(told.contains("taken in the rest pose"), "{told}");
}

#[test]
fn a_region_of_interest_that_is_gone_is_told() {
    let mut bench = bench(&bar());
    let handles = pb::SetHandlesRequest {
        handles: vec![handle("base", below(-1.5)), handle("top", above(1.5))],
        region_of_interest: Some(above(1.2)),
        ..Default::default()
    };
    bench
        .set_handles_message(&handles, &Exec::new(&pool(2), &Silent))
        .expect("the handles fit");
    // Without a cap, whose vertices might lie in the region.
    let outcome = edited(&mut bench, &delete(above(0.4), false));
    let codes: Vec<&str> = outcome.result.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["handle-lost", "region-of-interest-lost"]);
    assert!(outcome.handles.region_of_interest.is_none());
}

#[test]
fn a_step_that_fails_says_what_edits_before_it_warned_of() {
    let job = r#"{
      "handles": [
        {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": 1.5}}},
        {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 1.5}}}
      ],
      "steps": [
        {"edit": {"delete": {"region": {"halfSpace": {"normal": [0, 0, 1], "offset": 1}}, "fill": true}}},
        {"pose": {"handles": [{"id": "top", "pose": {"translation": [0, 0, 1]}}]}}
      ]
    }"#;
    let job: pb::Job = pliant::wire::json::from_json(job.as_bytes()).expect("a job");
    let limits = pliant::engine::DeformerLimits::default();
    let failed = pliant::batch::run(obj(&bar()), &job, None, &limits, &Exec::new(&pool(2), &Silent), &|| 0.0);
    let Err(error) = failed else {
        panic!("the handle is gone");
    };
    let told = error.to_string();
    assert!(
        told.starts_with("steps[1].pose") && told.contains("steps[0]: handle-lost: handle \"top\""),
        "{told}"
    );
}
