//! Edits of the topology as users meet them: on a bench, in jobs, and in sessions with undo and redo.

use crate::support::bench;
use crate::support::messages::{DeformerMessages, EditedByMessage, message};
mod following;
mod handles;
mod operations;

use bench::*;
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits as ModelLimits, Model, shapes};
use pliant::engine::{Deformer, ModelShape, digest};
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::wire::{Error, pb};
use std::sync::Arc;

use pb::edit_request::{Operation, cut, subdivide};

fn request(operation: Operation) -> pb::EditRequest {
    pb::EditRequest {
        operation: Some(operation),
        ..Default::default()
    }
}

/// An edit in the form of its JSON.
fn asked(operation: serde_json::Value) -> pb::EditRequest {
    message(&operation)
}

/// A cut by the plane z = `height`.
fn cut_at(height: f64, keep: cut::Keep, fill: bool) -> pb::EditRequest {
    let normal = vec![0.0, 0.0, 1.0];
    request(Operation::Cut(pb::edit_request::Cut {
        plane: Some(pb::Plane { normal, offset: height }),
        keep: keep.into(),
        fill,
        ..Default::default()
    }))
}

fn delete(region: pb::Region, fill: bool) -> pb::EditRequest {
    let region = Some(region);
    request(Operation::Delete(pb::edit_request::Delete { region, fill }))
}

fn subdivide(region: Option<pb::Region>, scheme: subdivide::Scheme) -> pb::EditRequest {
    request(Operation::Subdivide(pb::edit_request::Subdivide {
        region,
        scheme: scheme.into(),
        ..Default::default()
    }))
}

fn midpoint(region: Option<pb::Region>) -> pb::EditRequest {
    subdivide(region, subdivide::Scheme::Midpoint)
}

/// Edits the shape that `shape` is, with the handles' own poses in force.
fn edit(bench: &mut Deformer, request: &pb::EditRequest, shape: &ModelShape) -> Result<EditedByMessage, Error> {
    let poses = bench.initial_poses();
    bench.edit_message(request, shape, &poses, &Exec::new(&pool(2), &Silent))
}

fn edited(bench: &mut Deformer, request: &pb::EditRequest) -> EditedByMessage {
    let rest = bench.rest_shape();
    edit(bench, request, &rest).expect("the edit can be done")
}

fn read_back(bench: &Deformer, format: Format) -> Model {
    let written = bench
        .write(bench.rest(), format, &Exec::new(&pool(2), &Silent))
        .expect("written");
    let files = FileSet::single("back", written.main);
    Model::read(files, Some(format), &ModelLimits::default()).expect("read back")
}

fn volume(model: &Model) -> f64 {
    pliant::mesh::signed_volume(&model.positions, &model.triangles)
}

/// An upright bar, 1 by 1 by 4, about the origin.
fn bar() -> Shape {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [6, 6, 24]);
    let middle = DVec3::new(0.5, 0.5, 2.0);
    (positions.iter().map(|p| *p - middle).collect(), triangles)
}

fn ends() -> Vec<pb::Handle> {
    vec![handle("base", below(-1.5)), handle("top", above(1.5))]
}

fn held() -> Deformer {
    let mut bench = bench(&bar());
    set(&mut bench, ends());
    bench
}

fn solved(bench: &mut Deformer, entries: &[(&str, pb::HandlePose)]) -> ModelShape {
    solve(bench, entries, 1e-8)
}

#[test]
fn both_halves_of_a_filled_cut_add_up() {
    let mut total = 0.0;
    for (keep, height) in [(cut::Keep::Above, 2.6), (cut::Keep::Below, 1.4)] {
        let mut bench = bench(&bar());
        let outcome = edited(&mut bench, &cut_at(-0.6, keep, true));
        let half = read_back(&bench, Format::OBJ);
        assert_eq!(half.positions.len(), outcome.shape.len());
        let facts = bench.facts_message();
        assert!(
            facts.solver.is_some_and(|s| s.graph_vertices > s.solver_vertices),
            "it still has an inside"
        );
        assert!((volume(&half) - height).abs() < 1e-6, "{}", volume(&half));
        total += volume(&half);
    }
    assert!((total - 4.0).abs() < 1e-9);
}

#[test]
fn a_cut_that_keeps_both_sides_leaves_two_parts_that_move_apart() {
    let mut bench = held();
    let outcome = edited(&mut bench, &cut_at(0.1, cut::Keep::Both, true));
    assert_eq!(outcome.result.handles_kept, ["base", "top"]);
    assert_eq!(bench.facts_message().solver.map(|s| s.components), Some(2));
    let up = shift(DVec3::new(0.0, 0.0, 1.0));
    let moved = solved(&mut bench, &[("top", up)]);
    let rest = bench.rest();
    let (mut low, mut high) = (0, 0);
    for (p, q) in rest.iter().zip(moved.positions.iter()) {
        let by = (*q - *p).length();
        match by < 0.5 {
            true => low += usize::from(by < 1e-5),
            false => high += usize::from((by - 1.0).abs() < 1e-5),
        }
    }
    assert_eq!(low + high, rest.len(), "each half moves as one");
    assert!(low > 0 && high > 0);
}

#[test]
fn what_is_seen_becomes_the_rest_shape() {
    let mut bench = held();
    let bent = solved(&mut bench, &[("top", turn(DVec3::new(0.7, 0.0, 0.0), DVec3::ZERO))]);
    let outcome = edit(&mut bench, &midpoint(Some(above(1.2))), &bent).expect("subdivided");
    let before = bent.positions.len();
    assert!(outcome.shape.len() > before);
    for run in &outcome.result.kept {
        for k in 0..run.count as usize {
            let (was, now) = (run.was as usize + k, run.now as usize + k);
            assert_eq!(bent.positions[was], outcome.shape[now]);
            assert_eq!(outcome.shape[now], bench.rest()[now]);
        }
    }
    let held: u32 = outcome.result.kept.iter().map(|r| r.count).sum();
    assert_eq!(held as usize, before, "splitting takes no vertex away");
    assert_eq!(outcome.result.digest, digest(bench.rest()));
    let still = solved(&mut bench, &[]);
    assert_eq!(
        digest(&still.positions),
        outcome.result.digest,
        "nothing moves until a handle does"
    );
}

#[test]
fn on_the_rest_shape_poses_stay() {
    let mut bench = held();
    let turned = turn(DVec3::new(0.0, 0.0, 0.9), DVec3::ZERO);
    let poses = bench
        .change_poses_message(&bench.initial_poses(), &pose(&[("top", turned)]))
        .expect("a pose");
    let shape = bench.rest_shape();
    let request = pb::EditRequest {
        on: pb::edit_request::On::Rest.into(),
        ..midpoint(Some(half_space([1.0, 0.0, 0.0], 0.2)))
    };
    let outcome = bench
        .edit_message(&request, &shape, &poses, &Exec::new(&pool(2), &Silent))
        .expect("subdivided at rest");
    assert!(outcome.solved.is_some());
    for run in &outcome.result.kept {
        for k in 0..run.count as usize {
            let (was, now) = (shape[run.was as usize + k], bench.rest()[run.now as usize + k]);
            assert_eq!(was, now, "the rest shape stays");
        }
    }
    // The top is still turned by 0.9 about the axis.
    let turn = glam::DQuat::from_rotation_z(0.9);
    let mut seen = 0;
    for (p, q) in bench.rest().iter().zip(outcome.shape.iter()).filter(|(p, _)| p.z > 1.6) {
        assert!((turn * *p).distance(*q) < 1e-9);
        seen += 1;
    }
    assert!(seen > 10);
}

#[test]
fn what_cannot_be_done_is_refused_whole() {
    let mut bench = held();
    let (before, facts) = (digest(bench.rest()), bench.facts_message());
    let far = ball([9.0; 3], 0.1);
    let everywhere = half_space([0.0, 0.0, 1.0], -99.0);
    let merge = |transform: Vec<f64>| {
        request(Operation::Merge(pb::edit_request::Merge {
            source: Some(pb::edit_request::merge::Source::Model(b"v 0 0 0\n".to_vec().into())),
            transform,
            ..Default::default()
        }))
    };
    let cases: [(pb::EditRequest, &str); 9] = [
        (pb::EditRequest::default(), "operation"),
        (cut_at(9.0, cut::Keep::Both, false), "plane"),
        (cut_at(f64::NAN, cut::Keep::Both, false), "cut.plane.offset"),
        (request(Operation::Cut(Default::default())), "plane, polyline and path"),
        (delete(far, false), "delete.region"),
        (delete(everywhere, false), "delete.region"),
        (request(Operation::Delete(Default::default())), "delete.region"),
        (merge(vec![1.0; 15]), "merge.transform"),
        (merge(Vec::new()), "obj"),
    ];
    for (request, reason) in cases {
        let rest = bench.rest_shape();
        let error = edit(&mut bench, &request, &rest).expect_err(reason).to_string();
        assert!(error.contains(reason), "{error} should say {reason}");
        assert_eq!(digest(bench.rest()), before);
        assert_eq!(bench.facts_message(), facts);
    }
}

#[test]
fn the_same_edits_give_the_same_bits_on_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = pool(threads);
        let mut bench = bench_with(&bar(), &pb::CreateOptions::default(), &pool);
        set(&mut bench, ends());
        let mut shape = bench.rest_shape();
        let mut digests = Vec::new();
        for (k, request) in [
            cut_at(1.9, cut::Keep::Below, true),
            delete(half_space([1.0, 0.0, 0.0], 0.3), true),
            midpoint(Some(above(0.9))),
        ]
        .iter()
        .enumerate()
        {
            let poses = bench.initial_poses();
            let outcome = bench
                .edit_message(request, &shape, &poses, &Exec::new(&pool, &Silent))
                .expect("each can be done");
            digests.push(outcome.result.digest);
            let turned = turn(DVec3::new(0.2, 0.1 * k as f64, 0.0), DVec3::ZERO);
            let solved = solved(&mut bench, &[("top", turned)]);
            digests.push(digest(&solved.positions));
            shape = solved;
        }
        digests
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(3));
}
