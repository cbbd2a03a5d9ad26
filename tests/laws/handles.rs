//! What handles can say: softness, falloff, rigid regions, mirrors, regions of interest, parts, and what is refused.

use crate::support::bench;
use crate::support::messages::DeformerMessages;

use bench::*;
use glam::DVec3;
use pliant::asset::shapes;
use pliant::deform::exp_rotation;
use pliant::edit::SubdivisionScheme;
use pliant::engine::{Deformer, Edit, Region};
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::wire::{Error, pb};
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

/// A bar and, beside it, a ball that no handle holds.
fn bar_and_ball() -> (Shape, usize) {
    let (mut positions, mut triangles) = bar();
    let first = positions.len();
    let (ball, faces) = shapes::icosphere(0.3, 2);
    positions.extend(ball.iter().map(|p| *p + DVec3::new(1.2, 0.0, 3.9)));
    triangles.extend(faces.iter().map(|t| t.map(|v| v + first as u32)));
    ((positions, triangles), first)
}

#[test]
fn a_part_without_a_handle_follows_holds_or_is_refused() {
    use pb::create_options::Components;
    let (shape, first) = bar_and_ball();
    let bend = [("top", turn(DVec3::Y * 1.0, DVec3::new(0.0, 0.0, 2.0)))];
    let run = |policy: Components| {
        let create = pb::CreateOptions {
            components: policy as i32,
            ..Default::default()
        };
        let mut bench = bench_with(&shape, &create, &pool(2));
        // A box, so that the ball beside it stays loose.
        let top = handle("top", block([-1.0, -1.0, 3.75], [0.6, 1.0, 5.0]));
        try_set(&mut bench, vec![handle("base", below(0.25)), top])?;
        try_solve(&mut bench, &pose(&bend), 1e-5, 2)
    };
    let follow = run(Components::Follow).expect("solved").positions;
    let expected: Vec<_> = shape.0[first..]
        .iter()
        .map(|p| exp_rotation(DVec3::Y) * (*p - DVec3::new(0.0, 0.0, 2.0)) + DVec3::new(0.0, 0.0, 2.0))
        .collect();
    let error = largest_distance(&follow[first..], &expected);
    assert!(error < 0.05, "the ball moves with the bar's end, off by {error}");
    let size = |p: &[DVec3]| p[first].distance(p[first + 7]);
    assert!((size(&follow) - size(&shape.0)).abs() < 1e-9, "and rigidly");
    let hold = run(Components::Hold).expect("solved").positions;
    assert_eq!(hold[first..], shape.0[first..]);
    assert_eq!(hold[..first], follow[..first], "the policy changes nothing else");
    match run(Components::Free) {
        Err(Error::Precondition(text)) => assert!(text.contains("part 1"), "{text}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn outside_the_region_of_interest_no_bit_changes() {
    let shape = bar();
    let mut bench = bench(&shape);
    let request = pb::SetHandlesRequest {
        handles: vec![handle("top", above(3.75))],
        region_of_interest: Some(above(2.0)),
        ..Default::default()
    };
    set_all(&mut bench, &request);
    let solved = solve(&mut bench, &[("top", shift(DVec3::new(1.0, 0.0, 0.3)))], 1e-5);
    let mut moved = 0;
    for (now, rest) in solved.positions.iter().zip(&shape.0) {
        if rest.z < 2.0 {
            assert_eq!(now.to_array().map(f64::to_bits), rest.to_array().map(f64::to_bits));
        } else {
            moved += usize::from(now != rest);
        }
    }
    assert!(moved > 100);
}

#[test]
fn a_symmetry_plane_does_what_mirrored_handles_would() {
    let shape = shapes::torus(1.0, 0.3, 48, 16);
    let front = || handle("front", half_space([0.0, -1.0, 0.0], 1.1));
    let side = || handle("side", half_space([1.0, 0.0, 0.0], 1.1));
    let moved = pb::HandlePose {
        translation: vec![0.4, 0.1, 0.3],
        ..turn(DVec3::new(0.2, 0.5, 0.3), DVec3::X)
    };
    let image = pb::HandlePose {
        translation: vec![-0.4, 0.1, 0.3],
        ..turn(DVec3::new(0.2, -0.5, -0.3), -DVec3::X)
    };

    let mut by_plane = bench(&shape);
    let request = pb::SetHandlesRequest {
        handles: vec![front(), side()],
        symmetry_plane: Some(pb::Plane {
            normal: vec![2.0, 0.0, 0.0],
            offset: 0.0,
        }),
        ..Default::default()
    };
    set_all(&mut by_plane, &request);
    let mirrored = solve(&mut by_plane, &[("side", moved.clone())], 1e-8);

    let mut by_hand = bench(&shape);
    set(
        &mut by_hand,
        vec![front(), side(), handle("other", half_space([-1.0, 0.0, 0.0], 1.1))],
    );
    let explicit = solve(&mut by_hand, &[("side", moved), ("other", image)], 1e-8);
    let error = largest_distance(&mirrored.positions, &explicit.positions);
    assert!(error < 1e-6, "off by {error}");
    assert!(largest_distance(&mirrored.positions, &shape.0) > 0.3);
}

#[test]
fn soft_handles_give_way_and_stiffer_ones_less() {
    let missing = |stiffness: f64| {
        let mut bench = bench(&bar());
        set(
            &mut bench,
            vec![handle("base", below(0.25)), soft("top", above(3.75), stiffness)],
        );
        let by = DVec3::new(0.0, 0.0, 1.0);
        let solved = solve(&mut bench, &[("top", shift(by))], 1e-7);
        let rest = bar().0;
        let held = || rest.iter().zip(solved.positions.iter()).filter(|(p, _)| p.z >= 3.75);
        held().map(|(p, x)| x.distance(*p + by)).sum::<f64>() / held().count() as f64
    };
    let (soft, stiff, hard) = (missing(0.01), missing(1.0), missing(1000.0));
    assert!(
        soft > 2.0 * stiff && stiff > 10.0 * hard && hard < 1e-3,
        "{soft} {stiff} {hard}"
    );
}

#[test]
fn a_falloff_pulls_its_surroundings_and_fades() {
    let run = |falloff: Option<pb::Falloff>| {
        let mut bench = bench(&shapes::grid(2.0, 2.0, [40, 40]));
        let soft = pb::Handle {
            falloff,
            ..soft("pull", ball([1.0, 0.0, 1.0], 0.15), 5.0)
        };
        set(
            &mut bench,
            vec![handle("rim", half_space([0.0, 0.0, -1.0], -0.1)), soft],
        );
        let solved = solve(&mut bench, &[("pull", shift(DVec3::Y * 0.5))], 1e-7);
        let rest = bench.rest().clone();
        let ring = rest
            .iter()
            .zip(solved.positions.iter())
            .filter(|(p, _)| (0.3..0.4).contains(&p.distance(DVec3::new(1.0, 0.0, 1.0))));
        let (sum, count) = ring.fold((0.0, 0), |(s, n), (_, x)| (s + x.y, n + 1));
        sum / f64::from(count)
    };
    let smooth = pb::Falloff {
        radius: 0.6,
        kind: pb::falloff::Kind::Smooth as i32,
    };
    let (without, with) = (run(None), run(Some(smooth)));
    assert!(with > without + 0.05, "{with} with, {without} without");
}

#[test]
fn a_hard_handle_fades_inwards_and_shares_the_bend() {
    let shape = shapes::cylinder(0.5, 4.0, 24, 64, true);
    let bend = [("top", turn(DVec3::X * 1.4, DVec3::Z * 2.0))];
    let run = |radius: f64, kind: pb::falloff::Kind| {
        let mut bench = bench(&shape);
        let falloff = Some(pb::Falloff {
            radius,
            kind: kind as i32,
        });
        let top = pb::Handle {
            falloff,
            ..handle("top", above(2.24))
        };
        try_set(&mut bench, vec![handle("base", below(1.76)), top]).map(|()| solve(&mut bench, &bend, 1e-7).positions)
    };
    let hard = run(0.0, pb::falloff::Kind::None).expect("no falloff");
    for kind in [pb::falloff::Kind::Linear, pb::falloff::Kind::Smooth] {
        let faded = run(0.5, kind).expect("a falloff");
        let off = |k: usize| faded[k].distance(hard[k]);
        // Edges of the cylinder are shorter than 0.14, so that the core begins below this height at the latest.
        let (core, band): (Vec<usize>, Vec<usize>) = (0..shape.0.len())
            .filter(|&k| shape.0[k].z > 2.24)
            .partition(|&k| shape.0[k].z > 2.9);
        let moved = band.iter().map(|&k| off(k)).fold(0.0, f64::max);
        assert!(core.iter().all(|&k| off(k) < 1e-6), "the core stays hard");
        assert!(moved > 0.01, "the band gives way, by {moved}");
        // From the border inwards it gives way less and less.
        let mean_off = |from: f64| {
            let some = band.iter().filter(|&&k| (from..from + 0.125).contains(&shape.0[k].z));
            some.clone().map(|&k| off(k)).sum::<f64>() / some.count() as f64
        };
        assert!(
            mean_off(2.25) > 2.0 * mean_off(2.5),
            "{} {}",
            mean_off(2.25),
            mean_off(2.5)
        );
        let longest = |at: &[DVec3]| {
            let stretch = |a: u32, b: u32| {
                let length = |p: &[DVec3]| p[a as usize].distance(p[b as usize]);
                length(at) / length(&shape.0)
            };
            let edges = shape.1.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
            edges.map(|(a, b)| stretch(a, b)).fold(0.0, f64::max)
        };
        let (before, after) = (longest(&hard), longest(&faded));
        assert!(after < 0.9 * before, "the longest edge was {before}, is {after}");
    }
    match run(9.0, pb::falloff::Kind::Smooth) {
        Err(Error::Invalid { field, problem }) => {
            assert_eq!(field, "handles[1].falloff.radius");
            assert!(problem.contains("is 9,") && problem.contains("below 1.8"), "{problem}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_rigid_region_keeps_its_shape_when_others_move_it() {
    let mut bench = bench(&bar());
    let mut handles = ends();
    handles.push(pb::Handle {
        rigid: true,
        constrains: vec![pb::handle::Constrains::Rotation as i32],
        ..soft("middle", block([-1.0, -1.0, 1.6], [1.0, 1.0, 2.4]), 1e-6)
    });
    set(&mut bench, handles);
    let bend = turn(DVec3::new(0.0, 1.3, 0.8), DVec3::ZERO);
    let solved = solve(&mut bench, &[("top", bend)], 1e-6);
    let inside: Vec<usize> = (0..bench.rest().len())
        .filter(|k| (1.6..=2.4).contains(&bench.rest()[*k].z))
        .collect();
    let worst = inside
        .windows(9)
        .map(|w| {
            let at = |p: &[DVec3]| p[w[0]].distance(p[w[8]]);
            (at(&solved.positions) - at(bench.rest())).abs()
        })
        .fold(0.0, f64::max);
    assert!(worst < 1e-6, "distances inside change by {worst}");
}

#[test]
fn position_and_rotation_may_be_held_by_different_handles() {
    let mut bench = bench(&bar());
    let only = |id: &str, region, kind: pb::handle::Constrains| pb::Handle {
        constrains: vec![kind as i32],
        ..handle(id, region)
    };
    set(
        &mut bench,
        vec![
            handle("base", below(0.25)),
            only("place", above(3.9), pb::handle::Constrains::Position),
            only("turned", above(3.0), pb::handle::Constrains::Rotation),
        ],
    );
    let angle = 0.8;
    let solved = solve(&mut bench, &[("turned", turn(DVec3::Z * angle, DVec3::ZERO))], 1e-7);
    // Nothing moves the ends, yet the part between them is asked to turn.
    let rest = bench.rest();
    let middle = rest
        .iter()
        .zip(solved.positions.iter())
        .filter(|(p, _)| (3.1..3.5).contains(&p.z));
    let turned = middle
        .map(|(p, x)| p.truncate().angle_to(x.truncate()))
        .fold(0.0, f64::max);
    assert!(turned > 0.1 * angle, "turned by {turned}");
    let held = rest.iter().zip(solved.positions.iter()).filter(|(p, _)| p.z >= 3.9);
    assert!(held.into_iter().all(|(p, x)| p == x));
}

/// The bar, held below and in a sphere well inside of it.
fn held_inside() -> Deformer {
    let mut bench = bench(&bar());
    set(
        &mut bench,
        vec![handle("base", below(0.25)), handle("core", ball([0.0, 0.0, 3.5], 0.3))],
    );
    bench
}

/// The bar of 1 × 1 × 4, held below z = 0.25, with `others` beside.
fn pivots_of(others: Vec<pb::Handle>) -> Vec<DVec3> {
    let mut bench = bench(&bar());
    set(&mut bench, [vec![handle("base", below(0.25))], others].concat());
    bench.facts().handles.iter().map(|h| h.pivot).collect()
}

#[test]
fn a_handle_turns_about_the_joint_near_its_border() {
    let axis = |p: DVec3| p.truncate().length();
    let ends = pivots_of(vec![handle("top", above(3.75))]);
    assert!(axis(ends[1]) < 0.02 && (2.0..3.75).contains(&ends[1].z), "{ends:?}");
    // The bar is the same from both ends.
    let mirrored = DVec3::new(ends[1].x, ends[1].y, 4.0 - ends[1].z);
    assert!(ends[0].distance(mirrored) < 0.05, "{ends:?}");
    let elbow = pivots_of(vec![handle("top", above(2.5))]);
    assert!(axis(elbow[1]) < 0.02 && (1.375..2.5).contains(&elbow[1].z), "{elbow:?}");
    // A handle far from the joint moves it little.
    let far = pivots_of(vec![handle("middle", below(1.0)), handle("top", above(3.75))]);
    assert!(far[2].distance(ends[1]) < 0.1, "{far:?} {ends:?}");
    // Nothing is free where all is held, and nothing turns what constrains no rotation: these have the middle of their region.
    let all = pivots_of(vec![handle("all", above(-1.0))]);
    assert!(all[1].distance(DVec3::new(0.0, 0.0, 2.0)) < 1e-6, "{all:?}");
    let mut held = handle("top", above(3.75));
    held.constrains = vec![pb::handle::Constrains::Position as i32];
    let middle = pivots_of(vec![held])[1].z;
    assert!((3.75..=4.0).contains(&middle), "{middle}");
}

#[test]
fn a_bend_about_the_joint_stretches_less_than_one_about_the_middle_of_the_handle() {
    let mut bench = bench(&bar());
    set(&mut bench, ends());
    let mut largest_stretch = |pivot: Vec<f64>| {
        let quarter = pb::HandlePose {
            rotation_vector: vec![FRAC_PI_2, 0.0, 0.0],
            pivot,
            ..Default::default()
        };
        let solved = solve(&mut bench, &[("top", quarter)], 1e-6);
        let rest = Arc::clone(bench.rest());
        let triangles = &bench.geometry().triangles;
        let edges = triangles
            .iter()
            .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
        let stretch = edges.map(|(a, b)| {
            let length = |points: &[DVec3]| points[a as usize].distance(points[b as usize]);
            length(&solved.positions) / length(&rest)
        });
        stretch.fold(0.0, f64::max)
    };
    let middle_of_top = vec![0.0, 0.0, 3.875];
    let (joint, middle) = (largest_stretch(Vec::new()), largest_stretch(middle_of_top));
    assert!(
        joint - 1.0 < 0.8 * (middle - 1.0),
        "{joint} about the joint, {middle} about the middle"
    );
}

#[test]
fn a_handle_may_hold_nodes_inside_alone() {
    let mut bench = held_inside();
    let core = &bench.facts().handles[1];
    assert!(core.vertices == 0 && core.interior_nodes > 4, "{core:?}");
    assert!(core.centroid.distance(DVec3::new(0.0, 0.0, 3.5)) < 0.1, "{core:?}");
    assert!(bench.facts().warnings.is_empty(), "{:?}", bench.facts().warnings);
    let moved = solve(&mut bench, &[("core", shift(DVec3::new(0.5, 0.0, 0.0)))], 1e-6);
    let around = |z: f64| {
        let near = bench
            .rest()
            .iter()
            .zip(moved.positions.iter())
            .filter(|(p, _)| (p.z - z).abs() < 0.1);
        near.map(|(p, x)| x.x - p.x).fold(f64::MAX, f64::min)
    };
    assert!(
        around(3.5) > 0.4,
        "the surface around what is held follows, by {}",
        around(3.5)
    );
    assert!(
        around(0.2).abs() < 0.05,
        "and what is far away does not, {}",
        around(0.2)
    );

    let refused = try_set(&mut bench, vec![handle("nowhere", ball([9.0, 0.0, 0.0], 0.3))]);
    let reported = refused.expect_err("it holds nothing").to_string();
    assert!(reported.starts_with("handles[0].region: holds no vertex"), "{reported}");
    assert!(reported.contains("the model's box is from ["), "{reported}");
    assert_eq!(bench.facts().handles.len(), 2, "the handles in force stay");
}

#[test]
fn an_edit_carries_a_handle_that_holds_nodes_inside_alone() {
    let mut bench = held_inside();
    let before = bench.facts().handles[1].interior_nodes;
    let region = Some(Region::half_space([0.0, 0.0, 1.0], 3.0));
    let scheme = SubdivisionScheme::Midpoint;
    let creases = Default::default();
    let edit = Edit::Subdivide {
        region,
        scheme,
        creases,
    };
    let exec_pool = pool(2);
    let edited = bench.edit_rest(&edit, &Exec::new(&exec_pool, &Silent));
    let outcome = edited.expect("edited");
    assert!(outcome.report.warnings.is_empty(), "{:?}", outcome.report.warnings);
    let handles = bench.facts().handles;
    assert_eq!(handles.len(), 2, "{handles:?}");
    assert!(2 * handles[1].interior_nodes > before, "{handles:?}, {before} before");
}

#[test]
fn pulls_of_soft_handles_that_overlap_add_up() {
    let soft = |id: &str| soft(id, above(3.75), 0.05);
    let pulled = |ids: &[&str], by: f64| {
        let mut bench = bench(&bar());
        let mut handles = vec![handle("base", below(0.25))];
        handles.extend(ids.iter().map(|id| soft(id)));
        set(&mut bench, handles);
        assert!(bench.facts().warnings.is_empty(), "{:?}", bench.facts().warnings);
        assert!(bench.facts().handles.iter().all(|h| h.vertices > 0));
        let away = DVec3::new(by, 0.0, 0.0);
        let poses: Vec<_> = ids.iter().map(|&id| (id, shift(away))).collect();
        let solved = solve(&mut bench, &poses, 1e-8);
        let top = bench.rest().iter().position(|p| p.z > 3.99).expect("a top");
        solved.positions[top].x - bench.rest()[top].x
    };
    let (one, two) = (pulled(&["a"], 1.0), pulled(&["a", "b"], 1.0));
    assert!(two > 1.05 * one && two < 1.0, "one pulls by {one}, two by {two}");
    // Two pulls of opposite poses cancel: a sum, and no matter which came last.
    let mut bench = bench(&bar());
    set(&mut bench, vec![handle("base", below(0.25)), soft("a"), soft("b")]);
    let poses = [("a", shift(DVec3::X)), ("b", shift(-DVec3::X))];
    let solved = solve(&mut bench, &poses, 1e-8);
    assert!(largest_distance(&solved.positions, bench.rest()) < 1e-3);
}

#[test]
fn requests_that_make_no_sense_are_refused_with_their_place_and_change_nothing() {
    let mut bench = bent_bar();
    let vertices = |indices: Vec<u32>, ranges: Vec<pb::region::Range>| {
        region(pb::region::Region::Vertices(pb::region::Vertices { indices, ranges }))
    };
    let wide = pb::region::Range {
        first: u32::MAX,
        count: u32::MAX,
    };
    let nowhere = pb::Handle {
        id: "a".into(),
        ..Default::default()
    };
    let fading = pb::Handle {
        falloff: Some(pb::Falloff { radius: 1.0, kind: 1 }),
        ..handle("a", below(0.5))
    };
    let stiff_and_fading = pb::Handle {
        rigid: true,
        falloff: Some(pb::Falloff { radius: 0.3, kind: 1 }),
        ..handle("a", below(0.5))
    };
    for (handles, place) in [
        (vec![handle("", below(0.0))], "handles[0].id"),
        (vec![handle("a", below(0.5)), handle("a", above(3.0))], "handles[1].id"),
        (vec![handle("a", above(99.0))], "handles[0].region"),
        (vec![nowhere], "handles[0].region"),
        (
            vec![handle("a", half_space([0.0; 3], 1.0))],
            "handles[0].region.halfSpace.normal",
        ),
        (
            vec![handle("a", half_space([f64::NAN, 0.0, 1.0], 1.0))],
            "handles[0].region.halfSpace.normal[0]",
        ),
        (
            vec![handle("a", vertices(vec![1, 1 << 30], vec![]))],
            "handles[0].region.vertices.indices[1]",
        ),
        (
            vec![handle("a", vertices(vec![], vec![wide]))],
            "handles[0].region.vertices.ranges[0]",
        ),
        (vec![fading], "handles[0].falloff.radius"),
        (vec![stiff_and_fading], "handles[0].falloff"),
    ] {
        match try_set(&mut bench, handles) {
            Err(Error::Invalid { field, problem }) => assert_eq!(field, place, "{problem}"),
            other => panic!("{place}: {other:?}"),
        }
        assert_eq!(bench.handles_message().handles.len(), 2);
    }
    let only_turned = pb::Handle {
        constrains: vec![pb::handle::Constrains::Rotation as i32],
        ..handle("a", below(0.5))
    };
    let refused = try_set(&mut bench, vec![only_turned]);
    assert!(matches!(refused, Err(Error::Precondition(_))));
    let absent = pose(&[("nobody", pb::HandlePose::default())]);
    match bench.change_poses_message(&bench.initial_poses(), &absent) {
        Err(Error::Invalid { field, problem }) => {
            assert_eq!(field, "pose.handles[0].id");
            assert!(problem.contains("\"base\""), "{problem}");
        }
        other => panic!("{other:?}"),
    }
}
