//! Graph and hierarchy follow an edit: at the price of the edit, and without a difference that a user would see.

use super::*;
use crate::support::messages::DeformerMessages;
use pliant::engine::{DeformerLimits, ModelShape, OpenOptions, SolveMode};
use pliant::exec::Exec;
use pliant::pool::Pool;

/// A bar of a few thousand vertices, so that a few of them are little.
fn fine_bar() -> bench::Shape {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [14, 14, 56]);
    (
        positions.iter().map(|p| *p - DVec3::new(0.5, 0.5, 0.0)).collect(),
        triangles,
    )
}

fn paper_held() -> Deformer {
    let mut bench = paper_bench(&fine_bar(), &pool(2));
    set(&mut bench, handles());
    bench
}

/// A graph of kind PAPER.
fn paper_bench(shape: &bench::Shape, pool: &Pool) -> Deformer {
    let create = message(&serde_json::json!({"volumeGraph": {"kind": "PAPER"}}));
    bench_with(shape, &create, pool)
}

fn handles() -> Vec<pb::Handle> {
    vec![handle("base", below(0.5)), handle("top", above(3.5))]
}

fn remesh(region: pb::Region, edge_length: f64) -> pb::EditRequest {
    request(Operation::Remesh(pb::edit_request::Remesh {
        region: Some(region),
        edge_length,
        ..Default::default()
    }))
}

/// The same model, just opened, with the same handles.
fn fresh(bench: &Deformer, open: impl Fn(&bench::Shape) -> Deformer) -> Deformer {
    let geometry = bench.geometry();
    let mut fresh = open(&(bench.rest().to_vec(), geometry.triangles.clone()));
    fresh
        .set_handles_message(&bench.handles_message(), &Exec::new(&pool(2), &Silent))
        .expect("the handles fit");
    fresh
}

fn bend() -> Vec<(&'static str, pb::HandlePose)> {
    vec![("top", turn(DVec3::new(0.5, 0.0, 0.2), DVec3::new(0.0, 0.0, 3.5)))]
}

/// Edits are followed, and the next pose is that of the edited model opened, as near as graphs that differ inside come.
fn are_followed(bench: &mut Deformer, edits: &[pb::EditRequest], open: impl Fn(&bench::Shape) -> Deformer) {
    for (k, request) in edits.iter().enumerate() {
        let outcome = edited(bench, request);
        assert!(outcome.result.repaired, "edit {k} is followed");
        let here = solve(bench, &bend(), 1e-6);
        let there = solve(&mut fresh(bench, &open), &bend(), 1e-6);
        let apart = largest_distance(&here.positions, &there.positions) / bench.diagonal();
        assert!(apart < 0.01, "edit {k}: {apart} of the diagonal apart");
        assert!(
            here.stats.cycles <= there.stats.cycles + 1,
            "edit {k}: {} cycles, {} rebuilt",
            here.stats.cycles,
            there.stats.cycles
        );
    }
}

#[test]
fn edits_are_followed_and_the_next_pose_is_that_of_a_freshly_opened_model() {
    let edits = [
        delete(ball([0.5, 0.0, 2.0], 0.2), true),
        midpoint(Some(ball([-0.5, 0.1, 1.5], 0.25))),
        remesh(ball([0.0, 0.5, 2.4], 0.3), 0.05),
        delete(ball([0.0, -0.5, 2.8], 0.2), true),
    ];
    are_followed(&mut paper_held(), &edits, |shape| paper_bench(shape, &pool(2)));
}

#[test]
fn an_interior_of_the_shape_stays_and_the_next_pose_is_about_that_of_the_edited_model_opened() {
    let mut bench = bench(&fine_bar());
    set(&mut bench, handles());
    let edits = [
        delete(ball([0.5, 0.0, 2.0], 0.2), true),
        midpoint(Some(ball([-0.5, 0.1, 1.5], 0.25))),
        remesh(ball([0.0, 0.5, 2.4], 0.3), 0.05),
    ];
    are_followed(&mut bench, &edits, super::bench::bench);
}

#[test]
fn in_sessions_from_before_an_interior_of_the_shape_is_that_of_the_edited_model_opened() {
    let open = |shape: &bench::Shape| {
        let mut options = OpenOptions::default();
        options.body.graph.follows_edits = false;
        let limits = DeformerLimits::default();
        Deformer::open(bench::obj(shape), &options, &limits, &Exec::new(&pool(2), &Silent)).expect("the shape opens")
    };
    let mut bench = open(&fine_bar());
    set(&mut bench, handles());
    for (k, request) in [
        delete(ball([0.5, 0.0, 2.0], 0.2), true),
        midpoint(Some(ball([-0.5, 0.1, 1.5], 0.25))),
    ]
    .iter()
    .enumerate()
    {
        assert!(!edited(&mut bench, request).result.repaired);
        let here = solve(&mut bench, &bend(), 1e-6);
        let there = solve(&mut fresh(&bench, open), &bend(), 1e-6);
        assert!(here.positions == there.positions, "edit {k}");
    }
}

#[test]
fn a_deformed_shape_is_followed_like_one_that_is_rebuilt() {
    let shaped = || {
        let mut bench = paper_held();
        let shape = solve(&mut bench, &bend(), 1e-6);
        (bench, shape)
    };
    let next = |bench: &mut Deformer, shape: &ModelShape| {
        let region = ball(shape[shape.len() / 2].to_array(), 0.2);
        let outcome = edit(bench, &delete(region, true), shape).expect("the edit can be done");
        (outcome.result.repaired, solve(bench, &bend(), 1e-6))
    };
    let (mut here, shape) = shaped();
    let followed = next(&mut here, &shape);
    let (mut there, shape) = shaped();
    let rebuilt = next(&mut there, &ModelShape::from_positions(Arc::new(shape.to_vec())));
    assert_eq!((followed.0, rebuilt.0), (true, false));
    let apart = largest_distance(&followed.1.positions, &rebuilt.1.positions) / here.diagonal();
    assert!(apart < 0.01, "{apart} of the diagonal apart");
    assert!(followed.1.stats.cycles <= rebuilt.1.stats.cycles + 1);
}

#[test]
fn fields_after_an_edit_are_those_of_handles_that_are_set_then() {
    let mut bench = paper_held();
    edited(&mut bench, &delete(ball([0.5, 0.0, 2.0], 0.2), true));
    let (body, rig) = (bench.body(), bench.handle_system().expect("handles"));
    let rebuilt =
        pliant::deform::HandleSystem::build(body, rig.setup().clone(), &Exec::new(&pool(2), &Silent)).expect("a rig");
    let bits = |rig: &pliant::deform::HandleSystem, k: usize| -> Vec<u32> {
        rig.rotation_fields().of(k).iter().map(|u| u.to_bits()).collect()
    };
    for k in 0..2 {
        assert_eq!(bits(rig, k), bits(&rebuilt, k), "handle {k}");
    }
}

#[test]
fn handles_hold_what_is_inside_of_them_after_an_edit() {
    let mut bench = paper_held();
    let inside = |bench: &Deformer| {
        let surface = bench.body().graph.surface as u32;
        let holds = &bench.handle_system().expect("handles").setup().handles;
        let count = |h: &pliant::deform::HandleConstraint| h.nodes.iter().filter(|n| **n >= surface).count();
        holds.iter().map(count).collect::<Vec<_>>()
    };
    let before = inside(&bench);
    edited(&mut bench, &midpoint(Some(ball([0.5, 0.0, 2.0], 0.2))));
    assert_eq!(inside(&bench), before);
    // Set again as the deformer returns them, they hold the same.
    let handles = bench.handles_message();
    bench
        .set_handles_message(&handles, &Exec::new(&pool(2), &Silent))
        .expect("the same handles");
    assert_eq!(inside(&bench), before);
}

#[test]
fn large_edits_and_shapes_of_unknown_origin_are_rebuilt() {
    let mut bench = paper_held();
    assert!(!edited(&mut bench, &midpoint(None)).result.repaired);
    let shape = ModelShape::from_positions(Arc::new(bench.rest().iter().map(|p| *p * 1.1).collect()));
    let request = delete(ball([0.55, 0.0, 2.2], 0.2), true);
    let outcome = edit(&mut bench, &request, &shape).expect("the edit can be done");
    assert!(!outcome.result.repaired);
}

/// Poses and edits in turn; what is answered after each edit and each pose.
fn story(bench: &mut Deformer, threads: usize) -> Vec<String> {
    let pool = pool(threads);
    let mut said = Vec::new();
    let mut shape = bench.rest_shape();
    for k in 0..6 {
        let poses = bench.initial_poses();
        let region = ball([0.5, 0.0, 1.2 + 0.3 * f64::from(k)], 0.18);
        let request = match k % 3 {
            0 => delete(region, true),
            1 => midpoint(Some(region)),
            _ => remesh(region, 0.06),
        };
        let outcome = bench
            .edit_message(&request, &shape, &poses, &Exec::new(&pool, &Silent))
            .expect("each can be done");
        said.push(format!("{} {}", outcome.result.repaired, outcome.result.digest));
        let turned = turn(DVec3::new(0.15, 0.05 * f64::from(k), 0.0), DVec3::new(0.0, 0.0, 3.0));
        let poses = bench
            .change_poses_message(&outcome.poses, &pose(&[("top", turned)]))
            .expect("a pose");
        let exec = Exec::new(&pool, &Silent);
        let solved = bench.solve(&poses, &settings(1e-5), SolveMode::Commit, &exec, &mut |_| true);
        let solved = solved.expect("solved");
        said.push(digest(&solved.positions));
        shape = solved;
    }
    said
}

#[test]
fn the_way_back_and_forth_gives_the_same_bits_however_far() {
    let mut bench = paper_held();
    let start = (bench.topology_state(), bench.handles_message());
    let mut states = vec![start];
    let mut digests = vec![bent(&mut bench)];
    let mut shape = bench.rest_shape();
    for k in 0..5 {
        let region = ball(shape[shape.len() / 3 + 211 * k].to_array(), 0.18);
        let outcome = edit(&mut bench, &delete(region, k % 2 == 0), &shape).expect("an edit");
        assert!(outcome.result.repaired, "edit {k}");
        states.push((bench.topology_state(), bench.handles_message()));
        digests.push(bent(&mut bench));
        shape = solve(&mut bench, &bend(), 1e-5);
    }
    // One step, then all the way, then there and back at random: near states are kept, far ones followed again.
    for at in [4, 5, 0, 3, 1, 5, 2, 0, 4] {
        let (trail, handles) = &states[at];
        bench
            .restore_topology(trail, &Exec::new(&pool(1), &Silent))
            .expect("the way is known");
        bench
            .set_handles_message(handles, &Exec::new(&pool(1), &Silent))
            .expect("the same handles");
        assert_eq!(bent(&mut bench), digests[at], "state {at}");
    }
}

fn bent(bench: &mut Deformer) -> String {
    digest(&solve(bench, &bend(), 1e-5).positions)
}

#[test]
fn edits_that_are_followed_give_the_same_bits_for_any_number_of_threads() {
    let run = |threads| {
        let mut bench = paper_bench(&fine_bar(), &pool(threads));
        set(&mut bench, handles());
        story(&mut bench, threads)
    };
    let one = run(1);
    assert!(one.iter().filter(|s| s.starts_with("true")).count() >= 4, "{one:?}");
    assert_eq!(one, run(2));
    assert_eq!(one, run(3));
}

#[test]
fn a_refused_edit_leaves_everything_as_it_was() {
    let mut bench = paper_held();
    edited(&mut bench, &delete(ball([0.5, 0.0, 2.0], 0.2), true));
    let (before, bytes) = (bent(&mut bench), bench.byte_size());
    let missed = cut_at(99.0, cut::Keep::Both, false);
    let rest = bench.rest_shape();
    edit(&mut bench, &missed, &rest).expect_err("the plane misses");
    assert_eq!((bent(&mut bench), bench.byte_size()), (before, bytes));
}
