//! Models wrapped onto other surfaces.

use crate::surface_files::{Surface, file_of};
use glam::{DMat4, DQuat, DVec3};
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{
    Deformer, DeformerLimits, Edit, EditOutcome, Error, LandmarkPlace, OpenOptions, OtherModel, Region, WrapCommand,
    WrapLandmark,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::query::TriangleBvh;
use pliant_core::pool::Pool;
use pliant_core::progress::{CancelFlag, Silent};

/// Long, wide and high by different amounts, with a nose and a pair of ears that say which way it looks.
fn creature(p: DVec3) -> DVec3 {
    let bump = |at: DVec3, height: f64| height * libm::exp(-p.distance_squared(at.normalize()) / 0.06);
    let ears = bump(DVec3::new(0.5, 0.7, 0.8), 0.3) + bump(DVec3::new(0.5, 0.7, -0.8), 0.3);
    p * DVec3::new(1.6, 1.0, 0.8) * (1.0 + bump(DVec3::new(1.0, 0.3, 0.0), 0.4) + ears)
}

/// The same one bent and thicker: what a scan shows.
fn posed(p: DVec3) -> DVec3 {
    let p = creature(p) * DVec3::new(1.1, 1.0, 1.2);
    p + DVec3::Y * (0.15 * p.x * p.x)
}

fn template() -> Surface {
    let (points, triangles) = shapes::icosphere(1.0, 4);
    (points.into_iter().map(creature).collect(), triangles)
}

/// Where the scan stands, and how large it is.
fn scanner() -> DMat4 {
    DMat4::from_scale_rotation_translation(
        DVec3::splat(40.0),
        DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-0.2),
        DVec3::new(300.0, -80.0, 20.0),
    )
}

/// Other triangles, a little noise, and a hole where the sphere was above a height.
fn scan() -> Surface {
    let (points, mut triangles) = shapes::icosphere(1.0, 5);
    let turn = DQuat::from_rotation_z(0.3);
    let round: Vec<DVec3> = points.iter().map(|p| turn * *p).collect();
    triangles.retain(|t| {
        t.iter()
            .all(|v| round[*v as usize].dot(DVec3::new(-0.3, -0.9, 0.3).normalize()) < 0.93)
    });
    let noise = |k: usize| 0.001 * (((k * 7919) % 1000) as f64 / 500.0 - 1.0);
    let place = |(k, p): (usize, &DVec3)| scanner().transform_point3(posed(*p * (1.0 + noise(k))));
    (round.iter().enumerate().map(place).collect(), triangles)
}

fn wrap_of(target: FileSet) -> WrapCommand {
    WrapCommand {
        target: OtherModel {
            files: target,
            ..OtherModel::default()
        },
        landmarks: Vec::new(),
        mask: None,
        in_place: false,
    }
}

fn open(exec: &Exec<'_>) -> Deformer {
    Deformer::open(
        file_of(&template()),
        &OpenOptions::default(),
        &DeformerLimits::default(),
        exec,
    )
    .expect("a model")
}

fn wrapped(deformer: &mut Deformer, command: WrapCommand, exec: &Exec<'_>) -> Result<EditOutcome, Error> {
    deformer.edit_rest(&Edit::Wrap(Box::new(command)), exec)
}

/// Landmarks of the template's vertices nearest to places of the sphere that it was made of.
fn landmarks(places: &[DVec3]) -> Vec<WrapLandmark> {
    let (round, _) = shapes::icosphere(1.0, 4);
    let nearest = |at: DVec3| {
        let by_distance = |a: &usize, b: &usize| round[*a].distance(at).total_cmp(&round[*b].distance(at));
        (0..round.len()).min_by(by_distance).expect("vertices")
    };
    let of = |vertex: usize| WrapLandmark {
        own: LandmarkPlace::Vertex(vertex as u32),
        target: LandmarkPlace::Point(scanner().transform_point3(posed(round[vertex]))),
    };
    places.iter().map(|at| of(nearest(at.normalize()))).collect()
}

/// How far the vertices are from where they are on the scanned body, as a share of its length: half and nearly all are nearer.
fn from_truth(outcome: &EditOutcome) -> [f64; 2] {
    let (round, _) = shapes::icosphere(1.0, 4);
    let off = |(p, now): (&DVec3, &DVec3)| scanner().transform_point3(posed(*p)).distance(*now) / (40.0 * 4.0);
    let mut off: Vec<f64> = round.iter().zip(outcome.shape.positions.iter()).map(off).collect();
    off.sort_by(f64::total_cmp);
    [off[off.len() / 2], off[off.len() * 98 / 100]]
}

#[test]
fn a_template_finds_a_scan_that_is_turned_larger_elsewhere_and_has_a_hole() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(&exec);
    let outcome = wrapped(&mut deformer, wrap_of(file_of(&scan())), &exec).expect("wrapped");
    let told = outcome.report.wrap.clone().expect("a report");
    assert!(told.to_target.p50 < 3e-4 && told.from_target.p95 < 2e-3, "{told:?}");
    assert_eq!(
        (told.flipped_triangles, told.crossings, told.unpulled_vertices),
        (0, 0, 0)
    );
    let [half, most] = from_truth(&outcome);
    assert!(half < 0.03 && most < 0.08, "{half} {most}");
    // Over the hole the template goes on as it was: near the body that was scanned, on neither side of the hole's plane alone.
    let (round, triangles) = shapes::icosphere(1.0, 5);
    let whole: Vec<DVec3> = round.iter().map(|p| scanner().transform_point3(posed(*p))).collect();
    let tree = TriangleBvh::build(&whole, &triangles, &pool);
    let farthest = outcome
        .shape
        .positions
        .iter()
        .map(|p| tree.closest_point(*p).expect("a surface").distance);
    let farthest = farthest.fold(0.0, f64::max) / (40.0 * 4.0);
    assert!(farthest < 0.02, "{farthest}");
    assert_eq!(deformer.geometry().triangles, template().1, "topology stays");
}

#[test]
fn landmarks_lead_and_the_result_stays_in_place_where_that_is_asked_for() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let command = WrapCommand {
        landmarks: landmarks(&[
            DVec3::new(1.0, 0.3, 0.0),
            DVec3::new(0.5, 0.7, 0.8),
            DVec3::new(0.5, 0.7, -0.8),
            DVec3::NEG_X,
            DVec3::new(0.0, 0.3, -1.0),
        ]),
        ..wrap_of(file_of(&scan()))
    };
    let outcome = wrapped(&mut open(&exec), command.clone(), &exec).expect("wrapped");
    let told = outcome.report.wrap.clone().expect("a report");
    assert!(told.landmarks.max < 2e-3, "{told:?}");
    let [half, most] = from_truth(&outcome);
    assert!(half < 0.02 && most < 0.06, "{half} {most}");
    let in_place = WrapCommand {
        in_place: true,
        ..command
    };
    let stayed = wrapped(&mut open(&exec), in_place, &exec).expect("wrapped");
    assert!(stayed.shape.positions.iter().all(|p| p.length() < 4.0));
    assert_eq!(stayed.report.wrap, outcome.report.wrap, "it is the same fit");
}

/// A limb along x, so thick, whose middle is so high.
fn limb(thickness: f64, height: f64) -> Surface {
    let (points, triangles) = shapes::icosphere(1.0, 4);
    let place = |p: DVec3| p * DVec3::new(1.0, thickness, thickness) + DVec3::Y * height;
    (points.into_iter().map(place).collect(), triangles)
}

#[test]
fn a_thin_limb_that_lies_near_one_side_of_a_thick_one_becomes_it_all_round() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let options = OpenOptions::default();
    let limits = DeformerLimits::default();
    let mut deformer = Deformer::open(file_of(&limb(0.08, 0.2)), &options, &limits, &exec).expect("a model");
    let end = |x: f64| WrapLandmark {
        own: LandmarkPlace::Point(DVec3::new(x, 0.2, 0.0)),
        target: LandmarkPlace::Point(DVec3::new(x, 0.0, 0.0)),
    };
    let top = WrapLandmark {
        own: LandmarkPlace::Point(DVec3::new(0.0, 0.3, 0.0)),
        target: LandmarkPlace::Point(DVec3::new(0.0, 0.3, 0.0)),
    };
    let command = WrapCommand {
        landmarks: vec![end(-1.0), end(1.0), top],
        ..wrap_of(file_of(&limb(0.3, 0.0)))
    };
    let outcome = wrapped(&mut deformer, command, &exec).expect("wrapped");
    let report = outcome.report.wrap.expect("it says how it lies");
    assert!(
        report.to_target.p95 < 2e-3 && report.from_target.p95 < 3e-3,
        "{report:?}"
    );
    assert_eq!(report.flipped_triangles, 0);
}

#[test]
fn the_bits_do_not_depend_on_threads_and_an_earlier_state_comes_back() {
    let run = |threads: usize| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let mut deformer = open(&exec);
        let before = (deformer.topology_state(), deformer.rest().clone());
        let outcome = wrapped(&mut deformer, wrap_of(file_of(&scan())), &exec).expect("wrapped");
        assert_eq!(*deformer.rest(), outcome.shape.positions, "it is the rest shape");
        let after = deformer.topology_state();
        deformer.restore_topology(&before.0, &exec).expect("undone");
        assert_eq!(*deformer.rest(), before.1);
        deformer.restore_topology(&after, &exec).expect("done again");
        assert_eq!(*deformer.rest(), outcome.shape.positions);
        outcome.report
    };
    let one = run(1);
    assert_eq!(one, run(3));
    assert_eq!(one, run(8));
}

#[test]
fn what_cannot_be_wrapped_is_refused_and_changes_nothing() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(&exec);
    let before = deformer.rest().clone();
    let mut refused = |command: WrapCommand, exec: &Exec<'_>| {
        let refused = wrapped(&mut deformer, command, exec).expect_err("refused");
        assert_eq!(*deformer.rest(), before);
        refused
    };
    let one = |own, target| WrapCommand {
        landmarks: vec![WrapLandmark { own, target }],
        ..wrap_of(file_of(&scan()))
    };
    let (far, near) = (LandmarkPlace::Vertex(1 << 30), LandmarkPlace::Vertex(0));
    for (command, named) in [
        (one(far, near), "wrap.landmarks[0].ownVertex"),
        (one(near, far), "wrap.landmarks[0].targetVertex"),
        (wrap_of(FileSet::single("odd.off", "OFF\n0 0 0\n")), "wrap.model"),
    ] {
        let error = refused(command, &exec);
        assert!(
            matches!(&error, Error::Invalid { field, .. } if field == named),
            "{error}"
        );
    }
    let masked = WrapCommand {
        mask: Some(Region::sphere(DVec3::ZERO, 10.0)),
        ..wrap_of(file_of(&scan()))
    };
    assert!(matches!(refused(masked, &exec), Error::Precondition(_)));
    let flag = CancelFlag::default();
    flag.cancel();
    let cancelled = refused(wrap_of(file_of(&scan())), &Exec::new(&pool, &flag));
    assert!(matches!(cancelled, Error::Cancelled), "{cancelled}");
}
