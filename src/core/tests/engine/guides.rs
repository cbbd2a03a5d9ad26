//! Handles that a curve, a lattice or a cage leads.

use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};
use pliant_core::edit::SubdivisionScheme;
use pliant_core::engine::{
    Creases, Deformer, DeformerLimits, Edit, Error, Guide, GuidePose, Handle, HandlePose, OpenOptions, Region,
    SolveSettings, VertexRange, VertexTargets,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::sync::Arc;

/// A closed tube from z = -2 to 2, so many model units from the origin along x.
fn open(away: f64, exec: &Exec<'_>) -> Deformer {
    let (points, triangles) = shapes::cylinder(0.3, 4.0, 16, 48, true);
    let mut text = String::new();
    let middle = points.iter().sum::<DVec3>() / points.len() as f64;
    for p in points {
        let p = p - middle;
        text += &format!("v {} {} {}\n", p.x + away, p.y, p.z);
    }
    for [a, b, c] in triangles {
        text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
    }
    let model = FileSet::single("tube.obj", text);
    Deformer::open(model, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("a model")
}

/// A handle of all vertices that a guide leads.
fn led(deformer: &Deformer, guide: Guide) -> Handle {
    let count = deformer.rest().len() as u32;
    let all = Region::Vertices {
        indices: Vec::new(),
        ranges: vec![VertexRange { first: 0, count }],
    };
    Handle {
        guide: Some(Arc::new(guide)),
        ..Handle::with_targets("led", all, 1000.0)
    }
}

fn axis(away: f64) -> Guide {
    Guide::Curve {
        points: (0..9)
            .map(|k| DVec3::new(away, 0.0, f64::from(k) * 0.5 - 2.0))
            .collect(),
        keeps_length: true,
    }
}

/// A place on the tube bent to half a circle around (radius, 0), in the plane of x and z.
fn bent(p: DVec3, away: f64) -> DVec3 {
    let radius = 4.0 / std::f64::consts::PI;
    let (sin, cos) = libm::sincos(p.z / radius);
    DVec3::new(
        away + radius - (radius - (p.x - away)) * cos,
        p.y,
        (radius - (p.x - away)) * sin,
    )
}

fn half_circle(away: f64) -> HandlePose {
    let Guide::Curve { points, .. } = axis(away) else {
        unreachable!()
    };
    HandlePose::guide(GuidePose {
        positions: points.into_iter().map(|p| bent(p, away)).collect(),
        ..GuidePose::default()
    })
}

fn commit(deformer: &mut Deformer, pose: HandlePose, exec: &Exec<'_>) -> Vec<DVec3> {
    let shape = deformer
        .commit([("led", pose)], &SolveSettings::default(), exec)
        .expect("solved");
    shape.positions.to_vec()
}

fn farthest(a: &[DVec3], b: impl Iterator<Item = DVec3>) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(b)).fold(0.0, f64::max)
}

#[test]
fn a_tube_goes_along_a_curve_near_the_origin_and_far_from_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    for away in [0.0, 4.0e6] {
        let mut deformer = open(away, &exec);
        deformer
            .set_handles(vec![led(&deformer, axis(away))], &exec)
            .expect("a guide");
        let rest = commit(&mut deformer, HandlePose::default(), &exec);
        assert!(
            farthest(&rest, deformer.rest().iter().copied()) < 1e-9,
            "the rest shape of a guide moves nothing"
        );
        let found = commit(&mut deformer, half_circle(away), &exec);
        let off = farthest(&found, deformer.rest().iter().map(|p| bent(*p, away)));
        assert!(off < 0.03, "{off} of a tube of length 4, {away} from the origin");
    }
}

#[test]
fn a_lattice_leads_what_lies_in_it_and_the_rest_follows() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(0.0, &exec);
    let upper = Guide::Lattice {
        origin: DVec3::new(-0.5, -0.5, 1.0),
        edges: [DVec3::X, DVec3::Y, DVec3::Z],
        counts: [2, 2, 2],
    };
    let base = Handle::new("base", Region::half_space([0.0, 0.0, -1.0], 1.8));
    deformer
        .set_handles(vec![led(&deformer, upper), base], &exec)
        .expect("a guide");
    let corner = |k: usize| DVec3::new((k & 1) as f64 - 0.5, (k >> 1 & 1) as f64 - 0.5, 1.0 + (k >> 2) as f64);
    let pose = HandlePose::guide(GuidePose {
        positions: (0..8).map(|k| corner(k) + DVec3::X).collect(),
        ..GuidePose::default()
    });
    let found = commit(&mut deformer, pose, &exec);
    for (now, rest) in found.iter().zip(deformer.rest().iter()) {
        let way = *now - *rest;
        match rest.z {
            z if z > 1.05 => assert!(way.distance(DVec3::X) < 0.02, "{rest} in the lattice moves by {way}"),
            z if z < -1.85 => assert_eq!(way, DVec3::ZERO, "{rest} is held"),
            z if z.abs() < 0.5 => assert!(way.x > 0.02 && way.x < 0.98, "{rest} between moves by {way}"),
            _ => {}
        }
    }
}

#[test]
fn the_shape_of_a_guide_outlives_an_edit() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(0.0, &exec);
    let posed = led(&deformer, axis(0.0)).posed(half_circle(0.0));
    deformer.set_handles(vec![posed], &exec).expect("a guide");
    let before = deformer.rest().len();
    let subdivide = Edit::Subdivide {
        region: None,
        scheme: SubdivisionScheme::Midpoint,
        creases: Creases::default(),
    };
    deformer.edit_rest(&subdivide, &exec).expect("an edit");
    assert!(deformer.rest().len() > 2 * before);
    let settings = SolveSettings::default();
    let shape = deformer.commit([], &settings, &exec).expect("solved");
    let off = farthest(&shape.positions, deformer.rest().iter().map(|p| bent(*p, 0.0)));
    assert!(off < 0.03, "{off} of a tube of length 4");
}

#[test]
fn guides_and_shapes_in_the_wrong_place_are_refused_and_change_nothing() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(0.0, &exec);
    let refused = |deformer: &mut Deformer, handle: Handle, field: &str| {
        let error = deformer
            .set_handles(vec![handle], &exec)
            .map(|_| ())
            .expect_err("it is wrong");
        assert!(
            matches!(&error, Error::Invalid { field: named, .. } if named == field),
            "{error}"
        );
    };
    let untargeted = Handle {
        targets: None,
        ..led(&deformer, axis(0.0))
    };
    refused(&mut deformer, untargeted, "handles[0].guide");
    let short = led(
        &deformer,
        Guide::Curve {
            points: vec![DVec3::X],
            keeps_length: false,
        },
    );
    refused(&mut deformer, short, "handles[0].guide.curve.points");

    let plain = Handle {
        guide: None,
        ..led(&deformer, axis(0.0))
    };
    deformer.set_handles(vec![plain], &exec).expect("targets");
    let posed = |deformer: &mut Deformer, pose: HandlePose, field: &str| {
        let settings = SolveSettings::default();
        let error = deformer
            .commit([("led", pose)], &settings, &exec)
            .map(|_| ())
            .expect_err("it is wrong");
        assert!(
            matches!(&error, Error::Invalid { field: named, .. } if named == field),
            "{error}"
        );
    };
    posed(&mut deformer, half_circle(0.0), "pose.handles[0].pose.guide");
    deformer
        .set_handles(vec![led(&deformer, axis(0.0))], &exec)
        .expect("a guide");
    let places = deformer.rest().iter().map(|p| p.as_vec3().to_array());
    let both = HandlePose {
        targets: Some(Arc::new(VertexTargets::of(places))),
        ..half_circle(0.0)
    };
    posed(&mut deformer, both, "pose.handles[0].pose.targets.positions");
    posed(&mut deformer, HandlePose::translation(DVec3::X), "pose.handles[0].pose");
    let one = HandlePose::guide(GuidePose {
        positions: vec![DVec3::X],
        ..GuidePose::default()
    });
    posed(&mut deformer, one, "pose.handles[0].pose.guide.positions");
}
