//! Cuts, holes and curves: what is cut in two stays watertight, and nothing is lost.

use super::edit_support;
use edit_support::*;
use glam::DVec3;
use pliant::edit::{CutPlane, KeptSide, SurfaceCurve};
use proptest::prelude::*;

fn plane_at(normal: DVec3, offset: f64) -> CutPlane {
    CutPlane { normal, offset }
}

/// Cuts a model three ways and checks everything that a cut promises of a closed manifold surface.
fn check_cut(whole: &Model, plane: &CutPlane) -> Result<(), String> {
    let before = topology(whole);
    let both = whole
        .cut(plane, &cut_options(KeptSide::Both, true, &[true]))
        .map_err(|e| e.to_string())?;
    let moved = volume(&only_moved(whole, &both));
    let original = volume(whole);
    assert!(
        (moved - original).abs() <= 1e-5 * original.abs(),
        "snapping moved {moved} from {original}"
    );
    let parted = after(whole, &both);
    let t = topology(&parted);
    let mut sum = 0.0;
    let unit = plane.normal.normalize();
    for (keep, sign) in [(KeptSide::Above, 1.0), (KeptSide::Below, -1.0)] {
        let patch = whole
            .cut(plane, &cut_options(keep, true, &[true]))
            .expect("cuts as the other way");
        let half = after(whole, &patch);
        sum += volume(&half);
        let side = topology(&half);
        if before.is_closed() {
            assert!(side.is_closed(), "{keep:?} {side:?}");
        }
        let extent = half.positions.iter().map(|p| p.length()).fold(0.0, f64::max);
        for (v, p) in half
            .positions
            .iter()
            .enumerate()
            .filter(|(v, _)| half.point_of[*v] != u32::MAX)
        {
            let height = sign * (unit.dot(*p) - plane.offset / plane.normal.length());
            assert!(
                height >= -1e-12 * (1.0 + extent),
                "vertex {v} is {height} beyond the plane"
            );
        }
    }
    if !before.is_closed() {
        assert!(t.is_manifold() || !before.is_manifold(), "{t:?}");
        return Ok(());
    }
    assert!(t.is_closed(), "{t:?}");
    assert!(
        (sum - moved).abs() <= 1e-9 * original.abs(),
        "halves {sum}, whole {moved}"
    );
    assert!((volume(&parted) - moved).abs() <= 1e-9 * original.abs());
    Ok(())
}

#[test]
fn a_torus_cut_along_its_ring_gets_caps_with_holes() {
    let whole = Model::of(torus(48, 24, 2.0, 0.7));
    let plane = plane_at(DVec3::new(0.0, 0.01, 1.0), 0.1);
    check_cut(&whole, &plane).expect("cuts");
    let patch = whole
        .cut(&plane, &cut_options(KeptSide::Both, true, &[true]))
        .expect("cuts");
    let t = topology(&after(&whole, &patch));
    // Each half of a ring cut so is a ring again.
    assert!(t.is_closed() && t.components == 2 && t.euler == 0, "{t:?}");
}

#[test]
fn without_fill_the_sides_have_rims_at_the_same_places() {
    let whole = Model::of(sphere(4, 1.0));
    let plane = plane_at(DVec3::Z * 3.0, 0.9);
    let patch = whole
        .cut(&plane, &cut_options(KeptSide::Both, false, &[]))
        .expect("cuts");
    let parted = after(&whole, &patch);
    let t = topology(&parted);
    assert!(t.is_manifold() && t.components == 2 && t.euler == 2, "two discs: {t:?}");
    let same = (volume(&parted) - volume(&whole)).abs();
    assert!(same < 1e-4, "{same}");
    let normal = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| parted.positions[v as usize]);
        (b - a).cross(c - a).dot(a + b + c)
    };
    assert!(
        parted.triangles.iter().all(|t| normal(t) > 0.0),
        "every face looks outwards"
    );
}

#[test]
fn a_plane_through_points_and_edges_of_a_cube_cuts_it_clean() {
    let whole = Model::of(cube(3));
    for normal in [
        DVec3::Z,
        DVec3::new(1.0, 1.0, 0.0),
        DVec3::new(1.0, 1.0, 1.0),
        DVec3::new(1.0, -1.0, 1e-5),
    ] {
        for offset in [0.0, 0.5, -0.25, 0.5 + 1e-4, 0.999] {
            check_cut(&whole, &CutPlane { normal, offset }).expect("cuts");
        }
    }
}

#[test]
fn a_terrace_in_the_plane_stays_with_the_part_below() {
    // A small cube on a large one, one surface: cut exactly at the step.
    let (mut positions, _) = cube(1);
    positions.extend(
        positions
            .clone()
            .iter()
            .map(|p| DVec3::new(p.x * 0.5, p.y * 0.5, p.z + 2.0)),
    );
    let faces = {
        let (_, low) = cube(1);
        let top = [4u32, 5, 7, 6];
        let walls = |f: &[u32; 3], side: [u32; 4]| !f.iter().all(|v| side.contains(v));
        let mut all: Vec<[u32; 3]> = low.iter().copied().filter(|f| walls(f, top)).collect();
        all.extend(low.iter().filter(|f| walls(f, [0, 2, 3, 1])).map(|f| f.map(|v| v + 8)));
        for k in 0..4 {
            let (a, b) = (top[k], top[(k + 1) % 4]);
            all.extend([[a, b, b + 4], [a, b + 4, a + 4]]);
        }
        all
    };
    let whole = Model::of((positions, faces));
    assert!(topology(&whole).is_closed());
    let above = plane_at(DVec3::Z, 1.0);
    check_cut(&whole, &above).expect("cuts");
    let patch = whole
        .cut(&above, &cut_options(KeptSide::Below, true, &[]))
        .expect("cuts");
    assert!((volume(&after(&whole, &patch)) - 8.0).abs() < 1e-12);
}

#[test]
fn refusals_say_what_would_work() {
    let whole = Model::of(cube(2));
    let cut = |normal, offset| {
        let refused = whole.cut(&plane_at(normal, offset), &cut_options(KeptSide::Above, false, &[]));
        refused.expect_err("refused").to_string()
    };
    for (normal, offset, reason) in [
        (DVec3::Z, 2.0, "between -1 and 1"),
        (DVec3::Z, 1.0, "nothing of the surface on its upper side"),
        (DVec3::ZERO, 0.0, "longer than 0"),
        (DVec3::NAN, 0.0, "finite"),
    ] {
        let refused = cut(normal, offset);
        assert!(refused.contains(reason), "{reason}: {refused}");
    }
    let all: Vec<u32> = (0..whole.triangles.len() as u32).collect();
    for faces in [&all[..], &[]] {
        assert!(whole.delete(faces, true).is_err());
    }
    let none = whole.fill(None).expect_err("a cube has no hole");
    assert!(none.to_string().contains("no hole"), "{none}");
}

#[test]
fn a_hole_in_a_sphere_is_filled_to_a_sphere_again() {
    let whole = Model::of(sphere(4, 1.0));
    let center = |t: &[u32; 3]| t.iter().map(|&v| whole.positions[v as usize]).sum::<DVec3>() / 3.0;
    let cap = whole.triangles_where(|t| center(t).dot(DVec3::new(0.6, 0.0, 0.8)) > 0.9);
    let open = after(&whole, &whole.delete(&cap, false).expect("deletes"));
    let t = topology(&open);
    assert!(t.is_manifold() && t.rim_edges > 8 && t.euler == 1, "{t:?}");
    let by_delete = after(&whole, &whole.delete(&cap, true).expect("deletes"));
    let by_fill = after(&open, &open.fill(None).expect("fills"));
    let some: Vec<u32> = vec![
        open.triangles
            .iter()
            .position(|t| center_in(&open, t))
            .expect("near the rim") as u32,
    ];
    let by_region = after(&open, &open.fill(Some(&some)).expect("fills"));
    for closed in [by_delete, by_fill, by_region] {
        let t = topology(&closed);
        assert!(t.is_closed() && t.euler == 2, "{t:?}");
        let added = closed.triangles.len() - open.triangles.len();
        assert!(
            added * 2 > cap.len() && added < cap.len() * 2,
            "{added} for {}",
            cap.len()
        );
        let off = closed
            .positions
            .iter()
            .map(|p| (p.length() - 1.0).abs())
            .fold(0.0, f64::max);
        assert!(off < 0.02, "the filling is off the sphere by {off}");
    }
}

/// Points on a circle around the z axis.
fn circle(count: u32, radius: f64, height: f64) -> Vec<DVec3> {
    let angle = |k: u32| f64::from(k) / f64::from(count) * std::f64::consts::TAU;
    (0..count)
        .map(|k| DVec3::new(radius * libm::cos(angle(k)), radius * libm::sin(angle(k)), height))
        .collect()
}

/// Inserts a curve and checks that it is a path of edges and that the surface is the same one. Answers its places.
fn check_curve(whole: &Model, drawn: &[DVec3], closed: bool) -> Vec<DVec3> {
    let patch = whole.insert(drawn, closed).expect("inserts");
    let points = &patch.curve;
    let with = after(whole, &patch);
    let (before, now) = (topology(whole), topology(&with));
    assert_eq!(
        (now.euler, now.components, now.is_manifold()),
        (before.euler, before.components, before.is_manifold())
    );
    let area = |m: &Model| pliant::mesh::surface_area(&m.positions, &m.triangles);
    assert!((area(&with) - area(whole)).abs() <= 1e-9 * area(whole));
    let mut edges = std::collections::BTreeSet::new();
    for t in &with.triangles {
        let p = t.map(|v| with.point_of[v as usize]);
        for k in 0..3 {
            edges.extend([(p[k], p[(k + 1) % 3]), (p[(k + 1) % 3], p[k])]);
        }
    }
    let mut place = vec![DVec3::NAN; with.points as usize];
    for (&p, &x) in with.point_of.iter().zip(&with.positions) {
        if p != u32::MAX {
            place[p as usize] = x;
        }
    }
    let next = points.iter().skip(1).chain(closed.then(|| &points[0]));
    for (a, b) in points.iter().zip(next) {
        assert!(edges.contains(&(*a, *b)), "{a} – {b} of the curve is not an edge");
    }
    points.iter().map(|&p| place[p as usize]).collect()
}

#[test]
fn a_curve_on_a_sphere_becomes_edges_where_it_was_drawn() {
    let whole = Model::of(sphere(4, 1.0));
    let ring = check_curve(&whole, &circle(9, 1.3, 0.4), true);
    let length: f64 = (0..ring.len())
        .map(|k| ring[k].distance(ring[(k + 1) % ring.len()]))
        .sum();
    let lifted = circle(9, 1.3, 0.4).iter().map(|p| p.normalize()).collect::<Vec<_>>();
    // Stretches are arcs of great circles between the lifted points.
    let arc = 9.0 * libm::acos(lifted[0].dot(lifted[1]));
    assert!((length / arc - 1.0).abs() < 0.02, "{length} for {arc}");
    let open = check_curve(&whole, &[DVec3::X, DVec3::Y, DVec3::new(0.1, 0.2, 1.0)], false);
    let far = |x: DVec3, y: DVec3| x.distance(y);
    assert!(far(open[0], DVec3::X) < 0.02 && far(open[open.len() - 1], DVec3::new(0.1, 0.2, 1.0).normalize()) < 0.02);
    // One that crosses itself.
    check_curve(
        &whole,
        &[
            DVec3::new(1.0, 0.3, 0.3),
            DVec3::new(1.0, -0.3, -0.3),
            DVec3::new(1.0, -0.3, 0.3),
            DVec3::new(1.0, 0.3, -0.3),
        ],
        false,
    );
}

#[test]
fn a_closed_curve_parts_a_sphere_and_an_open_one_opens_a_slit() {
    let whole = Model::of(sphere(4, 1.0));
    let drawn = circle(12, 1.0, 0.3);
    let cut = |keep, fill| {
        whole
            .cut_along(&SurfaceCurve::Drawn(&drawn), true, &cut_options(keep, fill, &[true]))
            .expect("cuts")
    };
    let both = after(&whole, &cut(KeptSide::Both, true));
    let t = topology(&both);
    assert!(t.is_closed() && t.components == 2, "{t:?}");
    let (above, below) = (
        after(&whole, &cut(KeptSide::Above, true)),
        after(&whole, &cut(KeptSide::Below, true)),
    );
    // The circle runs anticlockwise seen from the pole: left of it is the pole.
    let top = |m: &Model| m.positions.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
    assert!(
        top(&above) == 1.0 && top(&below) < 0.5,
        "{} {}",
        top(&above),
        top(&below)
    );
    let sum = volume(&above) + volume(&below);
    assert!((sum - volume(&whole)).abs() < 1e-9, "{sum}");

    let line = [
        DVec3::new(1.0, -0.4, 0.1),
        DVec3::new(1.0, 0.0, 0.0),
        DVec3::new(1.0, 0.5, 0.2),
    ];
    let slit = whole
        .cut_along(
            &SurfaceCurve::Drawn(&line),
            false,
            &cut_options(KeptSide::Both, false, &[]),
        )
        .expect("cuts");
    let t = topology(&after(&whole, &slit));
    assert!(
        t.is_manifold() && t.euler == 1 && t.components == 1 && t.rim_edges > 8,
        "{t:?}"
    );
    for (keep, fill) in [(KeptSide::Above, false), (KeptSide::Both, true)] {
        let refused = whole.cut_along(&SurfaceCurve::Drawn(&line), false, &cut_options(keep, fill, &[]));
        assert!(
            refused
                .expect_err("no sides")
                .to_string()
                .contains("does not part the surface")
        );
    }
}

#[test]
fn a_sheet_is_cut_from_rim_to_rim() {
    let whole = Model::of(sheet(8, 6));
    let line = [
        DVec3::new(-1.0, 2.3, 0.4),
        DVec3::new(4.2, 3.6, -0.3),
        DVec3::new(9.0, 2.7, 0.0),
    ];
    let area = |keep| {
        let patch = whole
            .cut_along(&SurfaceCurve::Drawn(&line), false, &cut_options(keep, false, &[]))
            .expect("cuts");
        let half = after(&whole, &patch);
        let t = topology(&half);
        assert!(t.is_manifold() && t.euler == t.components as i64, "{t:?}");
        let double = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| half.positions[v as usize]);
            (b - a).cross(c - a).z
        };
        assert!(half.triangles.iter().all(|t| double(t) > 0.0));
        half.triangles.iter().map(double).sum::<f64>() / 2.0
    };
    let (above, below) = (area(KeptSide::Above), area(KeptSide::Below));
    let exact = 8.0 * 6.0 - (4.2 * (2.3 + 3.6) / 2.0 + 3.8 * (3.6 + 2.7) / 2.0);
    assert!(
        (above + below - 48.0).abs() < 1e-9 && (above - exact).abs() < 0.2,
        "{above} {exact} {below}"
    );
    assert!((area(KeptSide::Both) - 48.0).abs() < 1e-9);
}

#[test]
fn a_path_of_points_is_cut_along_its_edges() {
    let whole = Model::of(sphere(3, 1.0));
    let find = |x: DVec3| {
        whole
            .positions
            .iter()
            .position(|p| p.distance(x) < 1e-12)
            .expect("a corner")
    };
    let points: Vec<u32> = [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y]
        .map(|x| whole.point_of[find(x)])
        .to_vec();
    let patch = whole
        .cut_along(
            &SurfaceCurve::Along(&points),
            true,
            &cut_options(KeptSide::Both, false, &[]),
        )
        .expect("cuts");
    let halves = after(&whole, &patch);
    let t = topology(&halves);
    assert_eq!((t.components, t.euler, t.rim_edges), (2, 2, 2 * 32));
    assert_eq!(halves.triangles.len(), whole.triangles.len());
    let lost = whole.cut_along(
        &SurfaceCurve::Along(&[0, 9999]),
        false,
        &cut_options(KeptSide::Both, false, &[]),
    );
    assert!(lost.expect_err("no such point").to_string().contains("9999"));
}

#[test]
fn curves_between_parts_are_refused() {
    let apart = Model::of(both(sphere(2, 1.0), moved(sphere(2, 1.0), |p| p + DVec3::X * 5.0)));
    let line = [DVec3::Z, DVec3::new(5.0, 0.0, 1.0)];
    let refused = apart.insert(&line, false).expect_err("two parts");
    assert!(refused.to_string().contains("different parts"), "{refused}");
    let few = apart.insert(&line[..1], false).expect_err("one point");
    assert_eq!(
        few.to_string(),
        "insertCurve.points: 1 points; between 2 and 4096 are allowed"
    );
}

fn center_in(open: &Model, t: &[u32; 3]) -> bool {
    let near = |v: &u32| open.positions[*v as usize].dot(DVec3::new(0.6, 0.0, 0.8)) > 0.87;
    t.iter().any(near)
}

#[test]
fn data_meshes_are_cut_watertight() {
    let mut seen = 0;
    for name in [
        "arap_cactus_small.off",
        "3holes.off",
        "bunny.off",
        "arap_dino.off",
        "cow.off",
        "cheburashka.off",
        "spot.obj",
        "homer.obj",
        "elephant.obj",
        "camelhead.off",
        "feline.off",
    ] {
        let Some(whole) = data(name) else {
            continue;
        };
        seen += 1;
        println!("{name}: {:?}", topology(&whole));
        let (low, high) = bounds(&whole.positions);
        let middle = (low + high) * 0.5;
        for normal in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(0.3, 0.5, -0.8)] {
            for shift in [0.0, 0.1] {
                let offset = normal.dot(middle + (high - low) * shift);
                if let Err(e) = check_cut(&whole, &CutPlane { normal, offset }) {
                    panic!("{name} {normal} {offset}: {e}");
                }
            }
        }
    }
    println!("{seen} meshes cut");
}

fn one_of_three(shape: i32) -> Model {
    Model::of(match shape {
        0 => sphere(3, 1.0),
        1 => torus(31, 17, 1.0, 0.4),
        _ => cube(3),
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_curves_change_no_shape(
        points in prop::collection::vec((-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64), 3..9),
        closed: bool,
        shape in 0..3,
    ) {
        let drawn: Vec<DVec3> = points.iter().map(|&(x, y, z)| DVec3::new(x, y, z)).collect();
        let whole = one_of_three(shape);
        check_curve(&whole, &drawn, closed);
        let patch = whole.cut_along(&SurfaceCurve::Drawn(&drawn), closed, &cut_options(KeptSide::Both, false, &[]));
        let cut = after(&whole, &patch.expect("opens"));
        let t = topology(&cut);
        prop_assert!(t.is_manifold(), "{:?}", t);
    }

    #[test]
    fn random_cuts_lose_nothing(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64, offset in -0.28..0.28f64, shape in 0..3) {
        let normal = DVec3::new(x, y, z);
        prop_assume!(normal.length() > 0.1);
        let whole = one_of_three(shape);
        let plane = CutPlane { normal, offset: offset * normal.length() };
        check_cut(&whole, &plane).expect("passes through");
    }
}
