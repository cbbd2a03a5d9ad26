//! What becomes of handles across an edit, and what edits say: refusals with field and reason, warnings of what was lost.

use super::*;
use crate::support::messages::DeformerMessages;
use pb::edit_request::{self as wire, merge};
use pliant::exec::Exec;
use serde_json::json;

#[test]
fn handles_hold_what_lies_in_their_regions_after_an_edit() {
    let mut bench = held();
    let counts = |bench: &Deformer| -> Vec<u32> { bench.facts_message().handles.iter().map(|h| h.vertices).collect() };
    let before = counts(&bench);
    edited(&mut bench, &midpoint(Some(half_space([0.0, 0.0, 1.0], 1.4))));
    let after = counts(&bench);
    assert_eq!(before[0], after[0], "the base was not touched");
    assert!(
        after[1] > 3 * before[1],
        "what lies between held vertices is held: {before:?} {after:?}"
    );
    let above_plane = bench.rest().iter().filter(|p| p.z >= 1.5).count();
    assert_eq!(after[1] as usize, above_plane, "all that the plane leaves above it");
    let region = bench.handles_message().handles[1].region.clone();
    assert_eq!(region, Some(above(1.5)), "the region stays as it was given");
}

#[test]
fn a_region_that_a_pose_has_moved_is_the_list_of_its_vertices() {
    let mut bench = held();
    let before = bench.facts_message().handles[1].vertices;
    let shape = solve(&mut bench, &[("top", turn(DVec3::X * 1.2, DVec3::ZERO))], 1e-5);
    edit(&mut bench, &midpoint(Some(half_space([0.0, 0.0, -1.0], 1.4))), &shape).expect("an edit");
    assert_eq!(
        bench.facts_message().handles[1].vertices,
        before,
        "the top was not touched"
    );
    let region = bench.handles_message().handles[1].region.clone().and_then(|r| r.region);
    let Some(pb::region::Region::Vertices(list)) = region else {
        panic!("its vertices have left their places, so that they are listed")
    };
    assert!(list.ranges.iter().map(|r| r.count).sum::<u32>() >= before);
}

#[test]
fn a_handle_that_loses_everything_is_gone_and_said_to_be() {
    let mut bench = bench(&bar());
    let middle = block([-1.0, -1.0, -0.2], [1.0, 1.0, 0.2]);
    let handles = [("base", below(-1.5)), ("middle", middle), ("top", above(1.5))];
    set(&mut bench, handles.map(|(id, region)| handle(id, region)).to_vec());
    let outcome = edited(&mut bench, &cut_at(0.9, cut::Keep::Above, true));
    assert_eq!(outcome.result.handles_kept, ["top"]);
    let lost: Vec<&str> = outcome
        .result
        .warnings
        .iter()
        .filter(|w| w.code == "handle-lost")
        .map(|w| w.r#where.as_str())
        .collect();
    assert_eq!(lost, ["handles[0]", "handles[1]"]);
    assert_eq!(bench.facts_message().handles.len(), 1);
}

#[test]
fn weights_are_blended_and_stay_between_0_and_1() {
    let mut bench = bench(&bar());
    let values: Vec<f32> = bench.rest().iter().map(|p| ((p.z + 2.0) / 4.0) as f32).collect();
    let weights = region(pb::region::Region::Weights(pb::region::Weights { values }));
    set(
        &mut bench,
        vec![handle("base", below(-1.9)), soft("soft", weights, 2.0)],
    );
    edited(&mut bench, &midpoint(None));
    let region = bench.handles_message().handles[1].region.clone().and_then(|r| r.region);
    let Some(pb::region::Region::Weights(weights)) = region else {
        panic!("still weights")
    };
    assert_eq!(weights.values.len(), bench.rest().len());
    for (p, w) in bench.rest().iter().zip(weights.values) {
        assert!((f64::from(w) - (p.z + 2.0) / 4.0).abs() < 1e-6);
    }
}

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
    let reported = edit(bench, request, shape).expect_err("it is refused").to_string();
    assert_eq!(
        (digest(bench.rest()), bench.facts_message().solver),
        before,
        "nothing has changed"
    );
    reported
}

#[test]
fn a_merge_says_what_is_wrong_with_the_other_model() {
    let mut bench = held();
    let rest = bench.rest_shape();
    for (request, reason) in [
        (merged(b"AAAA".to_vec()), "merge.model: cannot be taken: "),
        (asked(json!({"merge": {}})), "merge: names no other model"),
        (merged(other(1e9)), "merge.transform: makes both together"),
        (merged(other(1e-9)), "merge.transform: makes both together"),
    ] {
        let reported = refusal(&mut bench, &request, &rest);
        assert!(reported.starts_with(reason), "{reported}");
    }
    edit(&mut bench, &merged(other(1e3)), &rest).expect("large, but both can be told apart");
}

#[test]
fn a_curve_without_a_length_is_refused() {
    let mut bench = held();
    let rest = bench.rest_shape();
    let line = [0.5, 0.0, 0.1, 0.5, 0.0, 0.1];
    let inserted = |points| request(Operation::InsertCurve(wire::InsertCurve { points, closed: false }));
    let curves = [
        asked(json!({"cut": {"polyline": line}})),
        asked(json!({"cut": {"path": [3, 3]}})),
        inserted(line.to_vec()),
    ];
    for request in curves {
        let reported = refusal(&mut bench, &request, &rest);
        assert!(reported.contains("all points lie at one place"), "{reported}");
    }
    let points = vec![0.5, 0.0, 0.1, 0.5, f64::NAN, 0.3];
    let reported = refusal(&mut bench, &inserted(points), &rest);
    assert!(reported.starts_with("insertCurve.points[4]: "), "{reported}");
    let points = vec![0.25; 3 * 5000];
    let reported = refusal(&mut bench, &inserted(points), &rest);
    assert!(reported.contains("2 to 4096 points"), "{reported}");
}

#[test]
fn an_empty_region_says_which_shape_it_was_taken_in() {
    let mut bench = held();
    let up = shift(DVec3::new(0.0, 0.0, 5.0));
    let bent = solved(&mut bench, &[("top", up)]);
    let nowhere = delete(above(50.0), false);
    let reported = refusal(&mut bench, &nowhere, &bent);
    assert!(reported.contains("taken in the current shape"), "{reported}");
    let on = pb::edit_request::On::Rest.into();
    let reported = refusal(&mut bench, &pb::EditRequest { on, ..nowhere }, &bent);
    assert!(reported.contains("taken in the rest pose"), "{reported}");
}

#[test]
fn a_region_of_interest_that_is_gone_is_reported() {
    let mut bench = bench(&bar());
    let handles = pb::SetHandlesRequest {
        handles: ends(),
        region_of_interest: Some(above(1.2)),
        ..Default::default()
    };
    set_all(&mut bench, &handles);
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
    let reported = error.to_string();
    assert!(
        reported.starts_with("steps[1].pose") && reported.contains("steps[0]: handle-lost: handle \"top\""),
        "{reported}"
    );
}

#[test]
fn a_pose_that_the_first_edit_of_a_job_would_drop_is_refused() {
    let run = |on: &str, edit: &str| {
        let job = format!(
            r#"{{"handles": [
                {{"id": "base", "region": {{"halfSpace": {{"normal": [0, 0, -1], "offset": 1.5}}}}}},
                {{"id": "top", "region": {{"halfSpace": {{"normal": [0, 0, 1], "offset": 1.5}}}}, "pose": {{"translation": [0, 0, 1]}}}}],
              "steps": [{{"edit": {{{edit}, "on": "{on}"}}}}]}}"#
        );
        let job: pb::Job = pliant::wire::json::from_json(job.as_bytes()).expect("a job");
        let limits = pliant::engine::DeformerLimits::default();
        pliant::batch::run(obj(&bar()), &job, None, &limits, &Exec::new(&pool(2), &Silent), &|| 0.0)
    };
    let refused = run("CURRENT", r#""subdivide": {}"#).err().map(|e| e.to_string());
    assert!(
        refused
            .as_deref()
            .is_some_and(|e| e.starts_with("handles[1].pose: is given, but the first step is an edit")),
        "{refused:?}"
    );
    run("REST", r#""subdivide": {}"#).expect("an edit of the rest pose keeps poses");
    run("CURRENT", r#""subdivide": {"auto": true}"#).expect("it looks at the poses");
}
