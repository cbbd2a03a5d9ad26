//! Every operation as a user asks for it, on a closed bar with handles, with what must hold after any edit.

use super::*;
use crate::support::messages::{DeformerMessages, EditedByMessage, unreferenced};
use crate::support::shapes;
use pb::edit_request::{self as wire, merge};
use serde_json::json;

/// What holds after every edit: counts agree, every vertex is used and finite, the model is written and read back, and the
/// handles that are left can be moved.
fn sound(bench: &mut Deformer, outcome: &EditedByMessage) {
    let after = outcome.result.after.expect("counts");
    assert_eq!(after.vertices as usize, bench.rest().len());
    assert_eq!(after.faces as usize, bench.geometry().triangles.len());
    assert!(bench.rest().iter().all(|p| p.is_finite()));
    assert_eq!(unreferenced(bench), 0, "no vertex is left over");
    let triangles = bench.geometry().triangles.clone();
    for format in [Format::GLB, Format::PLY] {
        let back = read_back(bench, format);
        assert_eq!(back.triangles.len(), triangles.len(), "{format}");
    }
    let up = shift(DVec3::new(0.1, 0.0, 0.2));
    let moved = solved(bench, &[("top", up)]);
    assert!(moved.positions.iter().all(|p| p.is_finite()));
    assert!(moved.stats.residual <= 1e-8);
}

#[test]
fn loop_subdivision_rounds_a_region_and_midpoints_keep_the_shape() {
    for (scheme, change) in [(subdivide::Scheme::Midpoint, 1e-12), (subdivide::Scheme::Loop, 0.1)] {
        let mut bench = held();
        let region = Some(ball([0.5, 0.5, 0.0], 0.6));
        let outcome = edited(&mut bench, &super::subdivide(region, scheme));
        sound(&mut bench, &outcome);
        assert!(bench.report().closed);
        let off = (bench.report().volume - 4.0).abs();
        assert!(off <= change, "{off}");
        assert_eq!(scheme == subdivide::Scheme::Loop, off > 1e-9);
    }
}

#[test]
fn remeshing_makes_edges_of_the_length_asked_for() {
    let mut bench = held();
    let outcome = edited(&mut bench, &asked(json!({"remesh": {"edgeLength": 0.1}})));
    sound(&mut bench, &outcome);
    assert!(bench.report().closed);
    assert!(
        (bench.report().volume - 4.0).abs() < 1e-6,
        "flat sides and edges stay: {}",
        bench.report().volume
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
    let auto = asked(json!({"remesh": {"auto": true}}));
    let outcome = edit(&mut bench, &auto, &stretched).expect("stretched");
    let [before, after] = [outcome.result.before, outcome.result.after].map(|c| c.expect("counts").faces);
    assert!(after > before * 3 / 2, "{before} -> {after}");
    sound(&mut bench, &outcome);
    assert!(bench.report().closed);
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
    let outcome = edited(&mut bench, &asked(json!({"decimate": {"ratio": ratio}})));
    let [before, after] = [outcome.result.before, outcome.result.after].map(|c| f64::from(c.expect("counts").faces));
    assert!((after / before - ratio).abs() < 0.05, "{before} -> {after}");
    sound(&mut bench, &outcome);
    assert!(bench.report().closed);

    // Two boxes a hair apart.
    let above_it = shapes::moved(bar(), |p| p + DVec3::new(0.0, 0.0, 4.0 + 1e-4));
    let mut bench = bench::bench(&shapes::both(bar(), above_it));
    set(&mut bench, vec![handle("base", below(-1.5)), handle("top", above(5.5))]);
    let outcome = edited(&mut bench, &asked(json!({"weld": {"tolerance": 1e-3}})));
    assert!(outcome.shape.len() <= 2 * bar().0.len());
    sound(&mut bench, &outcome);
}

#[test]
fn holes_are_made_and_closed() {
    let mut bench = held();
    let hole = ball([0.5, 0.0, 0.0], 0.35);
    let opened = edited(&mut bench, &delete(hole.clone(), false));
    assert!(!bench.report().closed);
    sound(&mut bench, &opened);
    let fill = asked(json!({"fill": {}}));
    let filled = edited(&mut bench, &fill);
    assert!(bench.report().closed);
    sound(&mut bench, &filled);
    assert!((bench.report().volume - 4.0).abs() < 0.05, "{}", bench.report().volume);
    let rest = bench.rest_shape();
    let nothing = edit(&mut bench, &fill, &rest);
    assert!(
        matches!(nothing, Err(Error::Precondition(_))),
        "no hole is left: {nothing:?}"
    );
}

#[test]
fn a_drawn_line_becomes_edges_that_can_be_held() {
    let mut bench = held();
    let points = [0.5, -0.3, -0.5, 0.5, 0.1, 0.0, 0.5, 0.3, 0.6];
    let outcome = edited(&mut bench, &asked(json!({"insertCurve": {"points": points}})));
    sound(&mut bench, &outcome);
    assert!(bench.report().closed && (bench.report().volume - 4.0).abs() < 1e-9);
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
    let line = region(pb::region::Region::Vertices(line));
    set(&mut bench, vec![handle("base", below(-1.5)), handle("line", line)]);
    let out = shift(DVec3::new(0.2, 0.0, 0.0));
    let moved = solved(&mut bench, &[("line", out)]);
    let first = curve[0] as usize;
    assert!((moved.positions[first] - bench.rest()[first] - DVec3::new(0.2, 0.0, 0.0)).length() < 1e-9);
}

#[test]
fn a_closed_line_around_cuts_off_what_is_left_of_it() {
    for (keep, volume) in [("ABOVE", 2.5), ("BELOW", 1.5)] {
        let mut bench = held();
        // Around the bar at z = −0.5, seen from above counter-clockwise: up is left.
        let polyline = [0.5, -0.5, -0.5, 0.5, 0.5, -0.5, -0.5, 0.5, -0.5, -0.5, -0.5, -0.5];
        let cut = json!({"cut": {"polyline": polyline, "closed": true, "keep": keep, "fill": true}});
        let outcome = edited(&mut bench, &asked(cut));
        assert!(bench.report().closed);
        assert!(
            (bench.report().volume - volume).abs() < 0.02,
            "{}",
            bench.report().volume
        );
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
        assert!(!bench.report().closed);
        let merge = request(Operation::Merge(wire::Merge {
            source: Some(merge::Source::Model(upper.clone().into())),
            format: "obj".into(),
            transform: vec![1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., gap, 1.],
            how: how.into(),
            ..Default::default()
        }));
        let outcome = edited(&mut bench, &merge);
        sound(&mut bench, &outcome);
        assert!(bench.report().closed, "{how:?}");
        assert!(
            (bench.report().volume - (gap + 4.0)).abs() < 1e-6,
            "{how:?}: {}",
            bench.report().volume
        );
        assert_eq!(bench.facts_message().solver.map(|s| s.components), Some(1));
    }
}

#[test]
fn creases_keep_the_edges_of_a_bar_through_two_subdivisions() {
    let mut bench = bench::bench(&shapes::moved(shapes::cube(1), |p| p * DVec3::new(1.0, 1.0, 4.0)));
    set(&mut bench, vec![handle("base", below(-1.5)), handle("top", above(1.5))]);
    let outcome = edited(&mut bench, &asked(json!({"subdivide": {"creaseDegrees": 40}})));
    let creases = outcome.result.creases.clone();
    assert!(creases.len() >= 48 && creases.len().is_multiple_of(4));
    let outcome = edited(&mut bench, &asked(json!({"subdivide": {"creases": creases}})));
    sound(&mut bench, &outcome);
    assert_eq!(outcome.result.creases.len(), 2 * creases.len());
    let (low, high) = shapes::bounds(bench.rest());
    let size = high - low;
    let filled = bench.report().volume / (size.x * size.y * size.z);
    assert!((filled - 1.0).abs() < 1e-12, "still a bar: {filled}");
    let rest = bench.rest_shape();
    for (wrong, field) in [
        (json!({"subdivide": {"creases": [0, 1, 2]}}), "subdivide.creases"),
        (json!({"subdivide": {"creases": [0, 100_000]}}), "subdivide.creases[1]"),
        (json!({"subdivide": {"creaseDegrees": 200}}), "subdivide.creaseDegrees"),
        (
            json!({"subdivide": {"scheme": "MIDPOINT", "sharpness": 1}}),
            "subdivide.sharpness: says what stays sharp, but without LOOP",
        ),
    ] {
        let refused = edit(&mut bench, &asked(wrong), &rest).expect_err("no creases");
        assert!(refused.to_string().contains(field), "{refused}");
    }
    for (creases, at) in [
        (json!({"sharpness": 0.5}), "sharpness"),
        (json!({"creaseDegrees": 179}), "region"),
    ] {
        let outcome = edited(&mut bench, &asked(json!({"subdivide": creases})));
        let told = outcome
            .result
            .warnings
            .iter()
            .find(|w| w.code == "subdivide-no-creases");
        assert!(told.is_some_and(|w| w.r#where == at), "{told:?}");
    }
}

#[test]
fn smoothing_takes_noise_off_keeps_the_volume_and_can_be_gone_back_from() {
    let rough = shapes::moved(bar(), |p| {
        let wave = 0.01 * (libm::sin(71.0 * p.z) + libm::sin(53.0 * p.x) * libm::cos(67.0 * p.y));
        p * (1.0 + wave)
    });
    let mut bench = bench::bench(&rough);
    set(&mut bench, vec![handle("base", below(-1.5)), handle("top", above(1.5))]);
    let (before, bits) = (bench.report().volume, bench.rest().to_vec());
    let state = bench.topology_state();
    let middle = json!({"box": {"min": [-1, -1, -1.2], "max": [1, 1, 1.2]}});
    let smooth = asked(json!({"smooth": {"region": middle, "iterations": 20, "sharpDegrees": 50}}));
    let outcome = edited(&mut bench, &smooth);
    let digest = outcome.result.digest.clone();
    sound(&mut bench, &outcome);
    assert!((bench.report().volume / before - 1.0).abs() < 1e-6 && outcome.result.volume_change.abs() < 1e-6);
    assert_eq!(outcome.result.kept.len(), 1, "vertices keep their numbers");
    let moved = bench.rest().iter().zip(&bits).filter(|(now, was)| now != was);
    assert!(moved.clone().all(|(_, was)| was.z.abs() < 1.25) && moved.count() > 200);
    bench
        .restore_topology(&state, &Exec::new(&pool(2), &Silent))
        .expect("undone");
    assert_eq!(**bench.rest(), bits);
    set(&mut bench, vec![handle("base", below(-1.5)), handle("top", above(1.5))]);
    assert_eq!(edited(&mut bench, &smooth).result.digest, digest, "the same again");
    // What is asked for wrongly is refused by its field.
    let rest = bench.rest_shape();
    for (wrong, field) in [
        (json!({"smooth": {"iterations": 1001}}), "smooth.iterations"),
        (json!({"smooth": {"strength": 1.5}}), "smooth.strength"),
        (
            json!({"smooth": {"strength": -1}}),
            "smooth.strength: is -1, allowed is above 0 and up to 1",
        ),
        (
            json!({"smooth": {"kind": "RELAX", "sharpDegrees": 181}}),
            "smooth.sharpDegrees",
        ),
    ] {
        let refused = edit(&mut bench, &asked(wrong), &rest).expect_err("out of range");
        assert!(refused.to_string().contains(field), "{refused}");
    }
}

#[test]
fn flat_caps_have_a_material_and_coordinates_of_their_own_through_later_edits() {
    let mut bench = held();
    let state = bench.topology_state();
    let cut = json!({"cut": {"plane": {"normal": [0.1, 0, 1], "offset": 0.3}, "keep": "BELOW", "fill": true, "cap": "FLAT", "material": "marble"}});
    let outcome = edited(&mut bench, &asked(cut.clone()));
    let plain = json!({"cut": {"plane": {"normal": [0.1, 0, 1], "offset": 0.3}, "keep": "BELOW", "fill": true}});
    let mut other = held();
    let same = edited(&mut other, &asked(plain));
    assert_eq!(
        outcome.result.after.map(|c| c.faces),
        same.result.after.map(|c| c.faces)
    );
    assert_eq!(bench.report().volume, other.report().volume, "the same shape");
    set(&mut bench, vec![handle("base", below(-1.5)), handle("top", above(0.0))]);
    sound(&mut bench, &outcome);
    for step in [
        json!({"subdivide": {"scheme": "MIDPOINT"}}),
        json!({"remesh": {"edgeLength": 0.11}}),
    ] {
        edited(&mut bench, &asked(step));
    }
    assert!(bench.report().closed);
    let written = bench
        .write(bench.rest(), Format::OBJ, &Exec::new(&pool(2), &Silent))
        .expect("written");
    let text = String::from_utf8(written.main).expect("text");
    let (_, cap) = text.split_once("usemtl marble").expect("its material");
    let number = |word: &str| word.parse::<f64>().expect("a number");
    let rows = |name: &str| -> Vec<Vec<f64>> {
        let lines = text.lines().filter_map(|l| l.strip_prefix(name));
        lines.map(|l| l.split_whitespace().map(number).collect()).collect()
    };
    let (places, coordinates) = (rows("v "), rows("vt "));
    let mut corners: Vec<([f64; 2], DVec3)> = Vec::new();
    for corner in cap
        .lines()
        .filter_map(|l| l.strip_prefix("f "))
        .flat_map(str::split_whitespace)
    {
        let numbers: Vec<usize> = corner.split('/').map(|n| n.parse().unwrap_or(0)).collect();
        let (p, t) = (&places[numbers[0] - 1], &coordinates[numbers[1] - 1]);
        corners.push(([t[0], t[1]], DVec3::new(p[0], p[1], p[2])));
    }
    assert!(corners.len() > 30 && corners.iter().all(|(_, p)| (p.x * 0.1 + p.z - 0.3).abs() < 1e-9));
    assert!(
        corners
            .iter()
            .flat_map(|(uv, _)| uv)
            .all(|c| (-1e-6..=1.000_001).contains(c))
    );
    // Laid out to scale: distances there are those of the cap over one length.
    let far = |i: usize, j: usize| {
        (corners[i].1.distance(corners[j].1), {
            let [a, b] = [i, j].map(|k| corners[k].0);
            (a[0] - b[0]).hypot(a[1] - b[1])
        })
    };
    let scale = far(0, 7).1 / far(0, 7).0;
    for k in 1..corners.len() {
        let (there, here) = far(0, k);
        assert!((here - there * scale).abs() < 1e-5, "{here} {there} {scale}");
    }
    let glb = bench
        .write(bench.rest(), Format::GLB, &Exec::new(&pool(2), &Silent))
        .expect("written")
        .main;
    assert!(String::from_utf8_lossy(&glb).contains("\"marble\""));
    bench
        .restore_topology(&state, &Exec::new(&pool(2), &Silent))
        .expect("undone");
    set(&mut bench, ends());
    assert_eq!(
        edited(&mut bench, &asked(cut)).result.digest,
        outcome.result.digest,
        "the same again"
    );
}

#[test]
fn a_hollow_end_is_filled_flat_around_its_hole_and_a_bent_one_curved_with_a_warning() {
    // A tube with a wall: two boundary loops at its top, one inside the other.
    let mut bench = bench::bench(&shapes::torus(24, 4, 1.0, 0.3));
    let halved = json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 0}, "keep": "BELOW"}});
    edited(&mut bench, &asked(halved));
    assert!(!bench.report().closed);
    let before = bench.geometry().primitives.len();
    let filled = edited(&mut bench, &asked(json!({"fill": {"cap": "FLAT"}})));
    assert!(filled.result.warnings.is_empty() && bench.report().closed);
    assert_eq!(bench.geometry().primitives.len(), before + 1);
    let cap = bench.geometry().primitives[before].clone();
    let rest = bench.rest();
    let ring = cap.vertices().map(|v| rest[v]);
    assert!(
        ring.clone().all(|p| p.z.abs() < 1e-9 && p.truncate().length() > 0.6),
        "nothing spans the hole"
    );
    // The boundary of a hole over an edge is not flat.
    let mut bent = held();
    edited(&mut bent, &delete(ball([0.5, 0.5, 0.0], 0.35), false));
    let done = edited(&mut bent, &asked(json!({"fill": {"cap": "FLAT"}})));
    assert!(done.result.warnings.iter().any(|w| w.code == "cap-curved"));
    assert!(bent.report().closed && bent.geometry().primitives.len() == 2);
    let wrong = [
        (json!({"fill": {"material": "x"}}), "fill.material"),
        (
            json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 0}, "cap": "FLAT"}}),
            "cut.cap",
        ),
    ];
    let rest = bent.rest_shape();
    for (wrong, field) in wrong {
        let refused = edit(&mut bent, &asked(wrong), &rest).expect_err("no such cap");
        assert!(refused.to_string().contains(field), "{refused}");
    }
}
