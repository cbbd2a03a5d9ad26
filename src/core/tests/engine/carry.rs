//! Laws of carried points: what a deformed surface does to whatever lies on it, in it and around it.

use glam::{DQuat, DVec3};
use pliant_core::asset::{FileSet, shapes};
use pliant_core::edit::KeptSide;
use pliant_core::engine::{CutLine, Deformer, DeformerLimits, Edit, EditCommand, EditedShape, OpenOptions, Plane};
use pliant_core::exec::Exec;
use pliant_core::mesh::carry::{CarriedFrame, CarriedPoints, CarrySurface, SurfaceCarrier, SurfaceMotion};
use pliant_core::mesh::query::closest_point::blend_corners;
use pliant_core::mesh::rotation::exp_rotation;
use pliant_core::pool::Pool;
use pliant_core::progress::{CancelFlag, Cancelled, Silent};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

fn threads(count: usize) -> Pool {
    Pool::new(count).expect("threads")
}

/// A closed tube about the y axis, from y = 0.
fn standing_bar(radius: f64, length: f64, around: usize, along: usize) -> Shape {
    let (points, faces) = shapes::cylinder(radius, length, around, along, true);
    (points.iter().map(|p| DVec3::new(p.y, p.z, p.x)).collect(), faces)
}

/// A closed body, an open sheet, a body of parts, and one with triangles of very different size.
fn bodies() -> Vec<(&'static str, Shape)> {
    let limbs = |gap: f64| {
        let (mut points, mut faces) = standing_bar(0.2, 2.0, 24, 30);
        let (more, others) = (points.clone(), faces.clone());
        let count = points.len() as u32;
        points.extend(more.iter().map(|p| *p + DVec3::X * (0.4 + gap)));
        faces.extend(others.iter().map(|t| t.map(|v| v + count)));
        (points, faces)
    };
    let uneven = {
        let (mut points, faces) = shapes::box_with_cells(DVec3::new(1.0, 2.0, 1.0), [3, 12, 3]);
        points.iter_mut().for_each(|p| p.x += 0.3 * p.x * p.y);
        (points, faces)
    };
    vec![
        ("ball", shapes::icosphere(1.0, 3)),
        ("ring", shapes::torus(1.0, 0.3, 40, 20)),
        ("sheet", shapes::grid(2.0, 2.0, [12, 12])),
        ("two limbs", limbs(0.1)),
        ("uneven box", uneven),
    ]
}

/// Bends everything about the x axis: the farther up, the more.
fn bend(p: DVec3, angle: f64) -> DVec3 {
    let (sin, cos) = (angle * p.y).sin_cos();
    let reach = 1.0 / angle;
    DVec3::new(p.x, (reach - p.z) * sin, reach - (reach - p.z) * cos)
}

fn bent(rest: &[DVec3], angle: f64) -> Vec<DVec3> {
    rest.iter().map(|&p| bend(p, angle)).collect()
}

/// Points inside and outside of the box twice as large as the body.
fn places(rest: &[DVec3], count: usize) -> Vec<DVec3> {
    let (mut low, mut high) = (rest[0], rest[0]);
    for p in rest {
        (low, high) = (low.min(*p), high.max(*p));
    }
    let mut state = 7u64;
    let mut random = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as f64 / f64::from(1u32 << 31)
    };
    let middle = (low + high) * 0.5;
    let size = (high - low).max(DVec3::splat(0.5));
    let mut place = |_| middle + size * (DVec3::new(random(), random(), random()) * 2.0 - 1.0);
    (0..count).map(&mut place).collect()
}

fn carry(carrier: &SurfaceCarrier, points: &[DVec3], pool: &Pool) -> Vec<CarriedFrame> {
    carrier
        .carry_points(points, &Exec::new(pool, &Silent))
        .expect("not cancelled")
}

#[test]
fn what_nothing_moves_keeps_its_bits() {
    for (name, (rest, faces)) in bodies() {
        let carrier = SurfaceCarrier::new(&faces, &rest, &rest, &threads(1));
        let mut points = places(&rest, 200);
        points.push(DVec3::new(-0.0, 0.0, -0.0));
        for (point, frame) in points.iter().zip(carry(&carrier, &points, &threads(2))) {
            assert_eq!(frame, CarriedFrame::resting(*point), "{name}");
            let bits = |p: DVec3| p.to_array().map(f64::to_bits);
            assert_eq!(bits(frame.position), bits(*point), "{name}");
        }
    }
}

#[test]
fn what_lies_near_the_part_that_stayed_keeps_its_bits_too() {
    let (rest, faces) = standing_bar(0.2, 4.0, 24, 60);
    let top = rest.iter().map(|p| p.y).fold(f64::MIN, f64::max);
    let now: Vec<DVec3> = (rest.iter().map(|&p| if p.y > top - 1.0 { p + DVec3::X } else { p })).collect();
    let carrier = SurfaceCarrier::new(&faces, &rest, &now, &threads(1));
    for beside in [DVec3::ZERO, DVec3::X * 0.1, DVec3::X * 0.5] {
        let low = DVec3::Y * (top - 3.5) + beside;
        assert_eq!(carrier.carry_point(low), CarriedFrame::resting(low));
        let high = DVec3::Y * (top - 0.3) + beside;
        assert!(
            carrier.carry_point(high).position.distance(high + DVec3::X) < 0.1,
            "{beside}"
        );
    }
}

#[test]
fn a_point_on_the_surface_stays_at_its_place_of_the_surface() {
    for (name, (rest, faces)) in bodies() {
        let now = bent(&rest, 0.9);
        let carrier = SurfaceCarrier::new(&faces, &rest, &now, &threads(1));
        for (k, face) in faces.iter().enumerate() {
            let at = |points: &[DVec3], w: [f64; 3]| blend_corners(face.map(|v| points[v as usize]), w);
            let inside = 0.1 + 0.2 * (k % 4) as f64;
            for weights in [
                [1.0, 0.0, 0.0],
                [0.0, 0.4, 0.6],
                [inside, 0.3 - inside / 3.0, 0.7 - inside * 2.0 / 3.0],
            ] {
                let carried = carrier.carry_point(at(&rest, weights)).position;
                let off = carried.distance(at(&now, weights));
                assert!(
                    off < 1e-6,
                    "{name}: triangle {k} at {weights:?} is {off:e} beside its place"
                );
            }
        }
    }
}

#[test]
fn points_beside_the_surface_stay_beside_their_place_as_they_come_closer() {
    for (name, (rest, faces)) in bodies() {
        let now = bent(&rest, 0.9);
        let carrier = SurfaceCarrier::new(&faces, &rest, &now, &threads(1));
        for face in faces.iter().step_by(7) {
            let [a, b, c] = face.map(|v| rest[v as usize]);
            let weights = [0.2, 0.5, 0.3];
            let normal = (b - a).cross(c - a).normalize();
            let target = blend_corners(face.map(|v| now[v as usize]), weights);
            for step in [1e-2, 1e-3, 1e-4, -1e-2, -1e-3, -1e-4] {
                let point = blend_corners([a, b, c], weights) + normal * step;
                let away = carrier.carry_point(point).position.distance(target);
                assert!(
                    away < 4.0 * step.abs() + 1e-6,
                    "{name}: {step} away at rest, {away} now"
                );
            }
        }
    }
}

#[test]
fn threads_and_binding_change_no_bit() {
    let (rest, faces) = shapes::torus(1.0, 0.3, 60, 30);
    let now = bent(&rest, 1.2);
    let points = places(&rest, 1500);
    let expected = carry(
        &SurfaceCarrier::new(&faces, &rest, &now, &threads(1)),
        &points,
        &threads(1),
    );
    for count in [1, 2, 5] {
        let pool = threads(count);
        let surface = CarrySurface::build(&rest, &faces, &pool);
        let motion = SurfaceMotion::between(&surface, &now, &pool);
        let bound = CarriedPoints::bind(&surface, &points, &Exec::new(&pool, &Silent)).expect("it is not cancelled");
        assert_eq!(bound.carried_by(&motion, &pool), expected, "{count} threads");
        let carrier = SurfaceCarrier::new(&faces, &rest, &now, &pool);
        assert_eq!(carry(&carrier, &points, &pool), expected, "{count} threads");
    }
}

#[test]
fn binding_ends_when_it_is_cancelled() {
    let (rest, faces) = shapes::icosphere(1.0, 2);
    let pool = threads(2);
    let surface = CarrySurface::build(&rest, &faces, &pool);
    let flag = CancelFlag::default();
    flag.cancel();
    let bound = CarriedPoints::bind(&surface, &places(&rest, 5), &Exec::new(&pool, &flag));
    assert_eq!(bound.map(|points| points.len()), Err(Cancelled));
}

#[test]
fn a_small_step_at_rest_is_a_small_step_when_carried() {
    // A bend by 0.9 a unit stretches what lies outside of it; nothing here is farther than three units from its axis.
    const MOST: f64 = 30.0;
    for (name, (rest, faces)) in bodies() {
        let now = bent(&rest, 0.9);
        let carrier = SurfaceCarrier::new(&faces, &rest, &now, &threads(2));
        let points = places(&rest, 60);
        for ends in points.windows(2) {
            // Along the way from one to the next, through the body and out again.
            let steps = 400;
            let at = |k: usize| ends[0].lerp(ends[1], k as f64 / steps as f64);
            let way: Vec<DVec3> = (0..=steps).map(at).collect();
            let carried = carry(&carrier, &way, &threads(2));
            for (k, pair) in carried.windows(2).enumerate() {
                let growth = pair[0].position.distance(pair[1].position) / way[k].distance(way[k + 1]);
                assert!(growth < MOST, "{name}: {growth} times the step at {}", way[k]);
            }
        }
    }
}

#[test]
fn a_point_in_a_limb_goes_with_its_limb_and_not_with_its_neighbour() {
    // Two bars a twentieth of their thickness apart; the second one rises.
    let (one, faces) = standing_bar(0.5, 4.0, 32, 40);
    let count = one.len() as u32;
    let apart = DVec3::X * 1.05;
    let rest: Vec<DVec3> = one.iter().copied().chain(one.iter().map(|p| *p + apart)).collect();
    let faces: Vec<[u32; 3]> = faces
        .iter()
        .copied()
        .chain(faces.iter().map(|t| t.map(|v| v + count)))
        .collect();
    let up = DVec3::Y * 3.0;
    let now: Vec<DVec3> = rest
        .iter()
        .enumerate()
        .map(|(i, p)| if i < count as usize { *p } else { *p + up })
        .collect();
    let carrier = SurfaceCarrier::new(&faces, &rest, &now, &threads(1));
    let middle = rest[..count as usize].iter().sum::<DVec3>() / f64::from(count);
    // Beside the axis, half-way to the surface, and just below it, on the side of the neighbour.
    for depth in [0.0, 0.25, 0.45] {
        let stays = carrier.carry_point(middle + DVec3::X * depth).position - (middle + DVec3::X * depth);
        assert!(stays.length() < 0.06 * up.length(), "{depth}: moved by {stays}");
        let other = middle + apart - DVec3::X * depth;
        let rises = carrier.carry_point(other).position - other - up;
        assert!(rises.length() < 0.06 * up.length(), "{depth}: lags by {rises}");
    }
}

#[test]
fn a_bent_bar_turns_what_is_in_it_and_around_it() {
    let (rest, faces) = standing_bar(0.3, 3.0, 24, 60);
    let angle = FRAC_PI_2 / 3.0;
    let carrier = SurfaceCarrier::new(&faces, &rest, &bent(&rest, angle), &threads(1));
    for (height, beside) in [(0.5, 0.0), (1.5, 0.1), (2.5, 0.0), (1.5, 0.4), (2.0, 0.6)] {
        let point = DVec3::new(beside, height, 0.0);
        let frame = carrier.carry_point(point);
        let expected = exp_rotation(DVec3::X * (angle * height));
        assert!(
            frame.rotation.angle_between(expected) < 0.06,
            "{point}: {:?}",
            frame.rotation
        );
        assert!(
            frame.position.distance(bend(point, angle)) < 0.03,
            "{point}: {}",
            frame.position
        );
        assert!((frame.scale - 1.0).abs() < 0.05, "{point}: {}", frame.scale);
    }
}

#[test]
fn surfaces_of_nothing_but_slivers_and_single_points_carry_too() {
    let pool = threads(1);
    let none = SurfaceCarrier::new(&[], &[], &[], &pool);
    assert_eq!(none.carry_point(DVec3::ONE), CarriedFrame::resting(DVec3::ONE));
    let line = [DVec3::ZERO, DVec3::X, DVec3::X * 2.0];
    let moved = line.map(|p| p + DVec3::Y);
    for rest in [line, [DVec3::ZERO; 3]] {
        let now = if rest == line { moved } else { [DVec3::Y; 3] };
        let carrier = SurfaceCarrier::new(&[[0, 1, 2]], &rest, &now, &pool);
        for point in [DVec3::ZERO, DVec3::new(0.5, 3.0, 1.0), DVec3::splat(-1e6)] {
            let frame = carrier.carry_point(point);
            assert!(
                frame.position.distance(point + DVec3::Y) < 1e-6 * (1.0 + point.length()),
                "{frame:?}"
            );
        }
    }
    // Everything falls into one point: nothing is infinite.
    let (rest, faces) = shapes::icosphere(1.0, 2);
    let carrier = SurfaceCarrier::new(&faces, &rest, &vec![DVec3::X; rest.len()], &pool);
    for point in places(&rest, 50) {
        let frame = carrier.carry_point(point);
        assert!(
            frame.position.is_finite() && frame.rotation.is_normalized() && frame.scale > 0.0,
            "{frame:?}"
        );
    }
}

fn any_vector(size: f64) -> impl Strategy<Value = DVec3> {
    [-size..size, -size..size, -size..size].prop_map(DVec3::from_array)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn a_similarity_of_the_whole_carries_every_point_with_it(
        turn in any_vector(PI),
        shift in any_vector(10.0),
        scale in 0.05..20.0f64,
        which in 0..5usize,
        point in any_vector(5.0),
    ) {
        let (name, (rest, faces)) = bodies().swap_remove(which);
        let rotation = exp_rotation(turn);
        let to = |p: DVec3| rotation * p * scale + shift;
        let now: Vec<DVec3> = rest.iter().map(|&p| to(p)).collect();
        let frame = SurfaceCarrier::new(&faces, &rest, &now, &threads(1)).carry_point(point);
        prop_assert!(frame.position.distance(to(point)) < 1e-8 * scale * 10.0 + 1e-8, "{name}: {frame:?}");
        prop_assert!(same_rotation(frame.rotation, rotation), "{name}: {:?} for {rotation:?}", frame.rotation);
        prop_assert!((frame.scale / scale - 1.0).abs() < 1e-9, "{name}: {}", frame.scale);
    }

    /// Both shapes in another place and size: what is carried from beside the surface lies there too.
    #[test]
    fn it_does_not_matter_where_the_scene_stands(
        turn in any_vector(PI),
        shift in any_vector(3.0),
        scale in 0.1..10.0f64,
        which in 0..5usize,
        vertex in 0..200usize,
        beside in any_vector(0.15),
    ) {
        let (name, (rest, faces)) = bodies().swap_remove(which);
        let point = rest[vertex % rest.len()] + beside;
        let now = bent(&rest, 0.7);
        let rotation = exp_rotation(turn);
        let to = |p: DVec3| rotation * p * scale + shift;
        let all = |points: &[DVec3]| points.iter().map(|&p| to(p)).collect::<Vec<DVec3>>();
        let here = SurfaceCarrier::new(&faces, &rest, &now, &threads(1)).carry_point(point);
        let there = SurfaceCarrier::new(&faces, &all(&rest), &all(&now), &threads(1)).carry_point(to(point));
        // Clusters are boxes along the axes of the scene, so that what is not near is merged another way.
        let (low, high) = rest.iter().fold((rest[0], rest[0]), |b, p| (b.0.min(*p), b.1.max(*p)));
        let off = there.position.distance(to(here.position)) / scale / low.distance(high);
        prop_assert!(off < 0.02, "{name}: {off} of the diagonal off");
        prop_assert!((there.scale / here.scale - 1.0).abs() < 0.05, "{name}");
        let turned = rotation * here.rotation * rotation.inverse();
        prop_assert!(there.rotation.angle_between(turned) < 0.1, "{name}");
    }
}

fn same_rotation(a: DQuat, b: DQuat) -> bool {
    a.dot(b).abs() > 1.0 - 1e-12
}

#[test]
fn points_whose_surface_is_taken_are_named() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (points, faces) = standing_bar(0.3, 3.0, 20, 40);
    let top = points.iter().copied().max_by(|a, b| a.y.total_cmp(&b.y)).expect("some");
    let low = points.iter().copied().min_by(|a, b| a.y.total_cmp(&b.y)).expect("some");
    let vertices: String = points
        .iter()
        .chain([&top, &low])
        .map(|p| format!("v {} {} {}\n", p.x, p.y, p.z))
        .collect();
    let faces: String = faces
        .iter()
        .map(|f| f.map(|v| v + 1))
        .map(|[a, b, c]| format!("f {a} {b} {c}\n"))
        .collect();
    let plane = Plane::new([0.0, 1.0, 0.0], (top.y + low.y) / 2.0 + 0.01);
    let said = |edit: &Edit| -> Vec<String> {
        let files = FileSet::single("bar.obj", format!("{vertices}{faces}"));
        let mut deformer =
            Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).expect("opened");
        let shape = deformer.rest_shape();
        let poses = deformer.initial_poses();
        let command = EditCommand {
            edit,
            on: EditedShape::Current,
            shape: &shape,
            poses: &poses,
            settings: None,
        };
        let warnings = deformer.edit(&command, &exec).expect("edited").report.warnings;
        let stay = warnings.iter().filter(|w| w.code == "loose-vertices-stay");
        stay.map(|w| w.message.clone()).collect()
    };
    let cut = |keep| Edit::Cut {
        along: CutLine::Plane(plane),
        keep,
        fill: true,
        cap: None,
    };
    for side in [KeptSide::Below, KeptSide::Above] {
        let said = said(&cut(side));
        assert!(
            said.len() == 1 && said[0].starts_with("1 vertex") && said[0].ends_with("primitive 0"),
            "{said:?}"
        );
    }
    let thin = Edit::Decimate {
        region: None,
        ratio: 0.5,
    };
    assert_eq!((said(&cut(KeptSide::Both)), said(&thin)), (vec![], vec![]));
}
