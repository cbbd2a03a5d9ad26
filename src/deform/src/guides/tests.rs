use super::*;
use glam::{DMat3, DQuat};
use pliant_asset::shapes::box_with_cells;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;

const EDGES: [DVec3; 3] = [
    DVec3::new(4.0, 0.0, 0.0),
    DVec3::new(0.0, 1.0, 0.0),
    DVec3::new(0.0, 0.2, 1.0),
];

/// A bar along x from 0 to 4, a little within a box of one more at each side.
fn bar() -> Vec<DVec3> {
    let (positions, _) = box_with_cells(DVec3::new(4.0, 0.6, 0.6), [32, 3, 3]);
    let middle = positions.iter().sum::<DVec3>() / positions.len() as f64;
    positions.iter().map(|p| *p - middle + DVec3::X * 2.0).collect()
}

fn straight(count: usize, keeps_length: bool) -> Guide {
    let points = (0..count)
        .map(|k| DVec3::X * (4.0 * k as f64 / (count - 1) as f64))
        .collect();
    Guide::Curve { points, keeps_length }
}

fn lattice() -> Guide {
    Guide::Lattice {
        origin: DVec3::new(0.0, -0.7, -0.5),
        edges: EDGES,
        counts: [5, 3, 2],
    }
}

fn cage() -> Guide {
    let (positions, triangles) = box_with_cells(DVec3::new(5.0, 1.4, 1.4), [3, 1, 1]);
    let middle = positions.iter().sum::<DVec3>() / positions.len() as f64;
    // Welded: corners of a box stand once per face in the shape.
    let mesh = pliant_mesh::Mesh::build(&positions, &triangles, pliant_mesh::Weld::Exact).expect("a box");
    Guide::Cage {
        positions: mesh.positions.iter().map(|p| *p - middle + DVec3::X * 2.0).collect(),
        triangles: mesh.triangles.clone(),
    }
}

fn places(guide: &Guide, rest: &[DVec3], pose: &GuidePose) -> Vec<DVec3> {
    let led = |threads: usize| -> Vec<DVec3> {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        guide.check(rest.len()).expect("a guide");
        let bound = guide.bind(rest.to_vec(), &exec).expect("it is not cancelled");
        bound.check(pose).expect("a pose");
        bound
            .places(pose, &exec)
            .into_iter()
            .map(|p| p.expect("it is led"))
            .collect()
    };
    let found = led(1);
    assert_eq!(found, led(3), "any number of threads gives the same");
    found
}

fn controls(guide: &Guide) -> Vec<DVec3> {
    match guide {
        Guide::Curve { points, .. } => points.clone(),
        Guide::Cage { positions, .. } => positions.clone(),
        Guide::Lattice { origin, edges, counts } => {
            let share = |k: u32, axis: usize| f64::from(k) / f64::from(counts[axis] - 1);
            let place = |k, j, i| *origin + edges[0] * share(i, 0) + edges[1] * share(j, 1) + edges[2] * share(k, 2);
            let rows = (0..counts[2]).flat_map(|k| (0..counts[1]).map(move |j| (k, j)));
            rows.flat_map(|(k, j)| (0..counts[0]).map(move |i| place(k, j, i)))
                .collect()
        }
    }
}

fn moved(guide: &Guide, to: impl Fn(DVec3) -> DVec3) -> GuidePose {
    GuidePose {
        positions: controls(guide).into_iter().map(to).collect(),
        ..GuidePose::default()
    }
}

fn furthest(a: &[DVec3], b: impl Iterator<Item = DVec3>) -> f64 {
    a.iter().zip(b).fold(0.0, |most, (a, b)| most.max(a.distance(b)))
}

#[test]
fn a_guide_in_its_rest_shape_gives_the_rest_positions_to_the_bit() {
    for guide in [straight(5, false), straight(2, true), lattice(), cage()] {
        assert_eq!(places(&guide, &bar(), &moved(&guide, |p| p)), bar(), "{guide:?}");
    }
}

#[test]
fn lattices_and_cages_take_along_what_is_linear_and_curves_what_is_rigid() {
    let turn = DMat3::from_quat(DQuat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize());
    let shear = turn * DMat3::from_cols_array(&[1.3, 0.1, 0.0, -0.2, 0.8, 0.3, 0.0, 0.1, 1.1]);
    let to = |p: DVec3| shear * p + DVec3::new(3.0, -2.0, 1.0);
    for (guide, allowed) in [(lattice(), 1e-13), (cage(), 2e-6)] {
        let found = places(&guide, &bar(), &moved(&guide, to));
        let error = furthest(&found, bar().into_iter().map(to));
        assert!(error < allowed, "{error} with {guide:?}");
    }
    // About an axis across the curve; its points do not define how far it is turned about itself.
    let across = DMat3::from_quat(DQuat::from_xyzw(0.0, 0.3, -0.2, 0.9).normalize());
    let to = |p: DVec3| across * p + DVec3::new(3.0, -2.0, 1.0);
    let found = places(&straight(5, false), &bar(), &moved(&straight(5, false), to));
    assert!(furthest(&found, bar().into_iter().map(to)) < 1e-13);
}

#[test]
fn a_bar_along_an_arc_keeps_its_sections_and_its_length() {
    let radius = 4.0 / std::f64::consts::PI;
    let arc = |p: DVec3| {
        let (sin, cos) = libm::sincos(p.x / radius);
        DVec3::new(0.0, -radius, 0.0) + DVec3::new(sin, cos, 0.0) * (radius + p.y) + DVec3::Z * p.z
    };
    for keeps_length in [false, true] {
        let guide = straight(17, keeps_length);
        let found = places(&guide, &bar(), &moved(&guide, arc));
        let error = furthest(&found, bar().into_iter().map(arc));
        assert!(error < 4e-3, "half a circle: {error}");
    }
}

#[test]
fn a_frame_neither_flips_nor_turns_about_the_curve() {
    // Through a loop with a vertical tangent, where frames from a fixed "up" turn over.
    let guide = straight(41, false);
    let loop_of = |p: DVec3| {
        let (sin, cos) = libm::sincos(p.x * 1.57);
        DVec3::new(p.x + 1.5 * sin, 1.5 - 1.5 * cos, 0.2 * p.x)
    };
    let rest: Vec<DVec3> = (0..=400).map(|k| DVec3::new(0.01 * f64::from(k), 0.3, 0.0)).collect();
    let found = places(&guide, &rest, &moved(&guide, loop_of));
    let step = found
        .windows(2)
        .fold(0.0f64, |most, pair| most.max(pair[0].distance(pair[1])));
    assert!(step < 0.06, "neighbours stay beside each other: {step}");
    let middle = places(
        &guide,
        &rest.iter().map(|p| p.with_y(0.0)).collect::<Vec<_>>(),
        &moved(&guide, loop_of),
    );
    assert!(
        found
            .iter()
            .zip(&middle)
            .all(|(a, b)| (a.distance(*b) - 0.3).abs() < 1e-12)
    );
}

#[test]
fn twist_and_scale_are_linear_between_points() {
    let guide = straight(3, false);
    let pose = GuidePose {
        twists: vec![0.0, 0.0, std::f64::consts::FRAC_PI_2],
        scales: vec![1.0, 2.0, 2.0],
        ..moved(&guide, |p| p)
    };
    let rest = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0].map(|x| DVec3::new(x, 0.0, 0.1));
    let found = places(&guide, &rest, &pose);
    for (k, (turn, scale)) in [(0.0, 1.0), (0.0, 1.5), (0.0, 2.0), (0.5, 2.0), (1.0, 2.0), (1.0, 2.0)]
        .iter()
        .enumerate()
    {
        let angle = libm::atan2(found[k].z, found[k].y) - std::f64::consts::FRAC_PI_2;
        assert!((found[k].x - rest[k].x).abs() < 1e-12);
        assert!(
            (angle - turn * std::f64::consts::FRAC_PI_2).abs() < 1e-9,
            "{k}: {angle}"
        );
        assert!((found[k].with_x(0.0).length() - 0.1 * scale).abs() < 1e-12, "{k}");
    }
}

#[test]
fn a_curve_that_keeps_its_length_goes_straight_on_beyond_its_end() {
    let guide = straight(2, true);
    let pose = GuidePose {
        positions: vec![DVec3::ZERO, DVec3::Y],
        ..GuidePose::default()
    };
    let found = places(
        &guide,
        &[DVec3::X, DVec3::X * 3.0, DVec3::X * 5.0, DVec3::X * -1.0],
        &pose,
    );
    let expected = [1.0, 3.0, 5.0, -1.0].map(|y| DVec3::Y * y);
    assert!(furthest(&found, expected.into_iter()) < 1e-12, "{found:?}");
}

#[test]
fn one_control_point_pulls_near_it_alone_and_outside_of_a_lattice_nothing_is_led() {
    let guide = lattice();
    let mut pose = moved(&guide, |p| p);
    pose.positions[0] += DVec3::Y;
    let found = places(&guide, &bar(), &pose);
    let moved_at = |x: f64| bar().iter().zip(&found).any(|(a, b)| (a.x - x).abs() < 0.1 && a != b);
    assert!(moved_at(0.0) && moved_at(1.5) && !moved_at(2.5));

    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let bound = guide
        .bind(vec![DVec3::X, DVec3::X * 5.0], &exec)
        .expect("not cancelled");
    assert!(matches!(bound.places(&pose, &exec)[..], [Some(_), None]));
}

#[test]
fn a_cage_leads_what_lies_on_it_and_its_corners() {
    let guide = cage();
    let corner = controls(&guide)[0];
    let Guide::Cage { triangles, .. } = &guide else {
        unreachable!()
    };
    let on_face = triangles[0].map(|v| controls(&guide)[v as usize]).iter().sum::<DVec3>() / 3.0;
    let to = |p: DVec3| p * DVec3::new(1.0, 2.0, 0.5) + DVec3::Z * p.x;
    let found = places(&guide, &[corner, on_face], &moved(&guide, to));
    assert!(furthest(&found, [to(corner), to(on_face)].into_iter()) < 1e-6);
}

#[test]
fn guides_and_poses_that_cannot_be_are_refused_by_name() {
    let refused = |guide: Guide, field: &str| assert_eq!(guide.check(10).expect_err("it is wrong").field, field);
    let curve = |points: Vec<DVec3>| Guide::Curve {
        points,
        keeps_length: false,
    };
    refused(curve(vec![DVec3::X]), "curve.points");
    refused(curve(vec![DVec3::X, DVec3::X]), "curve.points[1]");
    refused(curve(vec![DVec3::X, DVec3::NAN]), "curve.points[1]");
    let box_of = |counts, edges| Guide::Lattice {
        origin: DVec3::ZERO,
        edges,
        counts,
    };
    refused(box_of([2, 1, 2], EDGES), "lattice.counts[1]");
    refused(box_of([u32::MAX; 3], EDGES), "lattice.counts");
    refused(box_of([2; 3], [DVec3::X, DVec3::Y, DVec3::X]), "lattice.edges");
    let Guide::Cage {
        positions,
        mut triangles,
    } = cage()
    else {
        unreachable!()
    };
    let around = |triangles| Guide::Cage {
        positions: positions.clone(),
        triangles,
    };
    triangles[3][0] = 9999;
    refused(around(triangles.clone()), "cage.triangles[3]");
    triangles.remove(3);
    refused(around(triangles), "cage.triangles");
    let heavy = cage().check(1 << 30).expect_err("too many weights");
    assert_eq!(heavy.field, "cage.positions");

    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let wrong = |guide: &Guide, pose: GuidePose| {
        let bound = guide.bind(bar(), &exec).expect("not cancelled");
        bound.check(&pose).expect_err("it is wrong").field
    };
    let rest = moved(&straight(3, false), |p| p);
    let twisted = GuidePose {
        twists: vec![1.0],
        ..rest.clone()
    };
    assert_eq!(wrong(&straight(3, false), twisted), "twists");
    let flat = GuidePose {
        scales: vec![1.0, 0.0, 1.0],
        ..rest
    };
    assert_eq!(wrong(&straight(3, false), flat), "scales[1]");
    assert_eq!(wrong(&lattice(), GuidePose::default()), "positions");
    let scaled = GuidePose {
        scales: vec![1.0; 30],
        ..moved(&lattice(), |p| p)
    };
    assert_eq!(wrong(&lattice(), scaled), "scales");
}
