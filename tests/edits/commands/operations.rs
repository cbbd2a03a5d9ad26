//! Every operation as a user asks for it, on a closed bar with handles, with what must hold after any edit.

use super::*;
use crate::support::messages::{DeformerMessages, EditedByMessage};
use pb::edit_request::{self as wire, merge};

/// What holds after every edit: counts agree, every vertex is used and finite, the model is written and read back, and the
/// handles that are left can be moved.
fn sound(bench: &mut Deformer, outcome: &EditedByMessage) {
    let after = outcome.result.after.expect("counts");
    assert_eq!(after.vertices as usize, bench.rest().len());
    assert_eq!(after.faces as usize, bench.geometry().triangles.len());
    assert!(bench.rest().iter().all(|p| p.is_finite()));
    let mut used = vec![false; bench.rest().len()];
    let triangles = bench.geometry().triangles.clone();
    triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
    assert!(used.iter().all(|u| *u), "no vertex is left over");
    for format in [Format::GLB, Format::PLY] {
        let back = read_back(bench, format);
        assert_eq!(back.triangles.len(), triangles.len(), "{format}");
    }
    let up = shift(DVec3::new(0.1, 0.0, 0.2));
    let moved = solved(bench, &[("top", up)]);
    assert!(moved.positions.iter().all(|p| p.is_finite()));
    assert!(moved.stats.residual <= 1e-8);
}

fn closed(bench: &Deformer) -> bool {
    bench.report().closed
}

fn bar_volume(bench: &Deformer) -> f64 {
    bench.report().volume
}

#[test]
fn loop_subdivision_rounds_a_region_and_midpoints_keep_the_shape() {
    for (scheme, change) in [(subdivide::Scheme::Midpoint, 1e-12), (subdivide::Scheme::Loop, 0.1)] {
        let mut bench = held();
        let region = Some(ball([0.5, 0.5, 0.0], 0.6));
        let outcome = edited(
            &mut bench,
            &request(Operation::Subdivide(wire::Subdivide {
                region,
                scheme: scheme.into(),
                auto: false,
            })),
        );
        sound(&mut bench, &outcome);
        assert!(closed(&bench));
        let off = (bar_volume(&bench) - 4.0).abs();
        assert!(off <= change, "{off}");
        assert_eq!(scheme == subdivide::Scheme::Loop, off > 1e-9);
    }
}

#[test]
fn remeshing_makes_edges_of_the_length_asked_for() {
    let mut bench = held();
    let outcome = edited(
        &mut bench,
        &request(Operation::Remesh(wire::Remesh {
            edge_length: 0.1,
            ..Default::default()
        })),
    );
    sound(&mut bench, &outcome);
    assert!(closed(&bench));
    assert!(
        (bar_volume(&bench) - 4.0).abs() < 1e-6,
        "flat sides and edges stay: {}",
        bar_volume(&bench)
    );
    let (rest, mut sum, mut count) = (bench.rest(), 0.0, 0.0);
    for t in &bench.geometry().triangles {
        for k in 0..3 {
            sum += rest[t[k] as usize].distance(rest[t[(k + 1) % 3] as usize]);
            count += 1.0;
        }
    }
    let mean: f64 = sum / count;
    assert!((0.07..0.13).contains(&mean), "{mean}");
}

#[test]
fn automatic_remeshing_mends_what_was_stretched_and_only_that() {
    let mut bench = held();
    let far = shift(DVec3::new(0.0, 0.0, 6.0));
    let stretched = solved(&mut bench, &[("top", far)]);
    let auto = request(Operation::Remesh(wire::Remesh {
        auto: true,
        ..Default::default()
    }));
    let outcome = edit(&mut bench, &auto, &stretched).expect("stretched");
    let [before, after] = [outcome.result.before, outcome.result.after].map(|c| c.expect("counts").faces);
    assert!(after > before * 3 / 2, "{before} -> {after}");
    sound(&mut bench, &outcome);
    assert!(closed(&bench));
    // Where nothing is stretched any more there is nothing to do.
    let again = edited(&mut bench, &auto);
    assert!(
        again.result.warnings.iter().any(|w| w.code == "remesh-nothing"),
        "{:?}",
        again.result.warnings
    );
}

#[test]
fn decimating_thins_out_and_welding_joins() {
    let mut bench = held();
    let ratio = 0.5;
    let outcome = edited(
        &mut bench,
        &request(Operation::Decimate(wire::Decimate { region: None, ratio })),
    );
    let [before, after] = [outcome.result.before, outcome.result.after].map(|c| f64::from(c.expect("counts").faces));
    assert!((after / before - ratio).abs() < 0.05, "{before} -> {after}");
    sound(&mut bench, &outcome);
    assert!(closed(&bench));

    // Two boxes a hair apart.
    let (positions, triangles) = bar();
    let mut both = (positions.clone(), triangles.clone());
    both.0
        .extend(positions.iter().map(|p| *p + DVec3::new(0.0, 0.0, 4.0 + 1e-4)));
    both.1
        .extend(triangles.iter().map(|t| t.map(|v| v + positions.len() as u32)));
    let mut bench = bench_with(&both, &pb::CreateOptions::default(), &pool(2));
    set(&mut bench, vec![handle("base", below(-1.5)), handle("top", above(5.5))]);
    let outcome = edited(&mut bench, &request(Operation::Weld(wire::Weld { tolerance: 1e-3 })));
    assert!(outcome.shape.len() <= 2 * positions.len());
    sound(&mut bench, &outcome);
}

#[test]
fn holes_are_made_and_closed() {
    let mut bench = held();
    let hole = ball([0.5, 0.0, 0.0], 0.35);
    let opened = edited(&mut bench, &delete(hole.clone(), false));
    assert!(!closed(&bench));
    sound(&mut bench, &opened);
    let filled = edited(&mut bench, &request(Operation::Fill(wire::Fill { region: None })));
    assert!(closed(&bench));
    sound(&mut bench, &filled);
    assert!((bar_volume(&bench) - 4.0).abs() < 0.05, "{}", bar_volume(&bench));
    let rest = bench.rest_shape();
    let nothing = edit(
        &mut bench,
        &request(Operation::Fill(wire::Fill { region: None })),
        &rest,
    );
    assert!(
        matches!(nothing, Err(Error::Precondition(_))),
        "no hole is left: {nothing:?}"
    );
}

#[test]
fn a_drawn_line_becomes_edges_that_can_be_held() {
    let mut bench = held();
    let points = vec![0.5, -0.3, -0.5, 0.5, 0.1, 0.0, 0.5, 0.3, 0.6];
    let outcome = edited(
        &mut bench,
        &request(Operation::InsertCurve(wire::InsertCurve { points, closed: false })),
    );
    sound(&mut bench, &outcome);
    assert!(closed(&bench) && (bar_volume(&bench) - 4.0).abs() < 1e-9);
    let curve = &outcome.result.curve;
    assert!(curve.len() >= 3);
    assert!(curve.iter().all(|&v| (bench.rest()[v as usize].x - 0.5).abs() < 1e-9));
    for pair in curve.windows(2) {
        let joined = |t: &[u32; 3]| t.contains(&pair[0]) && t.contains(&pair[1]);
        assert!(
            bench.geometry().triangles.iter().any(joined),
            "each is joined to the next by an edge"
        );
    }
    let line = pb::region::Vertices {
        indices: curve.clone(),
        ranges: Vec::new(),
    };
    let line = pb::Region {
        region: Some(pb::region::Region::Vertices(line)),
    };
    set(&mut bench, vec![handle("base", below(-1.5)), handle("line", line)]);
    let out = shift(DVec3::new(0.2, 0.0, 0.0));
    let moved = solved(&mut bench, &[("line", out)]);
    let first = curve[0] as usize;
    assert!((moved.positions[first] - bench.rest()[first] - DVec3::new(0.2, 0.0, 0.0)).length() < 1e-9);
}

#[test]
fn a_closed_line_around_cuts_off_what_is_left_of_it() {
    for (keep, volume) in [(cut::Keep::Above, 2.5), (cut::Keep::Below, 1.5)] {
        let mut bench = held();
        // Around the bar at z = −0.5, seen from above counter-clockwise: up is left.
        let polyline = vec![0.5, -0.5, -0.5, 0.5, 0.5, -0.5, -0.5, 0.5, -0.5, -0.5, -0.5, -0.5];
        let outcome = edited(
            &mut bench,
            &request(Operation::Cut(wire::Cut {
                polyline,
                closed: true,
                keep: keep.into(),
                fill: true,
                ..Default::default()
            })),
        );
        assert!(closed(&bench));
        assert!((bar_volume(&bench) - volume).abs() < 0.02, "{}", bar_volume(&bench));
        assert_eq!(outcome.result.handles_kept.len(), 1);
    }
}

#[test]
fn another_model_is_welded_or_stitched_on() {
    // The same bar without its bottom, upon the first one without its top.
    let mut donor = held();
    edited(&mut donor, &delete(half_space([0.0, 0.0, -1.0], 2.0 - 1e-9), false));
    let upper = donor.write(donor.rest(), Format::OBJ, &Exec::new(&pool(2), &Silent));
    let upper = upper.expect("written").main;
    let lid = delete(half_space([0.0, 0.0, 1.0], 2.0 - 1e-9), false);
    for (how, gap) in [(merge::How::Weld, 4.0), (merge::How::Stitch, 4.3)] {
        let mut bench = held();
        edited(&mut bench, &lid);
        assert!(!closed(&bench));
        let outcome = edited(
            &mut bench,
            &request(Operation::Merge(wire::Merge {
                source: Some(merge::Source::Model(upper.clone().into())),
                format: "obj".into(),
                transform: vec![1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., gap, 1.],
                how: how.into(),
                ..Default::default()
            })),
        );
        sound(&mut bench, &outcome);
        assert!(closed(&bench), "{how:?}");
        assert!(
            (bar_volume(&bench) - (gap + 4.0)).abs() < 1e-6,
            "{how:?}: {}",
            bar_volume(&bench)
        );
        assert_eq!(bench.facts_message().solver.map(|s| s.components), Some(1));
    }
}
