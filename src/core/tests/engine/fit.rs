//! Outfits of one body on another.

use crate::surface_files::{Surface, file_of};
use glam::DVec3;
use pliant_core::asset::{Limits, Model, shapes};
use pliant_core::engine::{
    Deformer, DeformerLimits, Error, OpenOptions, OtherModel, OutfitFit, TransferCommand, Transferred,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

/// How high a bump of the other body is.
const BUMP: f64 = 0.35;

/// A place of the unit sphere on the first body, `by` above its surface.
fn body(p: DVec3, by: f64) -> DVec3 {
    p * (1.0 + by) * DVec3::new(1.2, 1.0, 0.8)
}

/// The other body: larger, with a belly.
fn other(p: DVec3) -> DVec3 {
    let belly = BUMP * libm::exp(-p.distance_squared(DVec3::new(0.3, 0.2, 0.93)) / 0.05);
    20.0 * body(p, belly) + DVec3::new(50.0, -8.0, 4.0)
}

/// Whether a place is outside of the other body.
fn is_outside(at: DVec3) -> bool {
    let local = (at - DVec3::new(50.0, -8.0, 4.0)) / 20.0 / DVec3::new(1.2, 1.0, 0.8);
    let surface = other(local.normalize());
    let of_surface = (surface - DVec3::new(50.0, -8.0, 4.0)) / 20.0 / DVec3::new(1.2, 1.0, 0.8);
    // Triangles lie a little below the round surface.
    local.length() > of_surface.length() - 0.005
}

/// A band around the body.
fn vest() -> Surface {
    let (points, triangles) = shapes::icosphere(1.0, 4);
    let is_kept = |t: &[u32; 3]| t.iter().all(|v| points[*v as usize].y.abs() < 0.6);
    let kept: Vec<[u32; 3]> = triangles.iter().filter(|t| is_kept(t)).copied().collect();
    let mut used: Vec<u32> = kept.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let number = |v: u32| used.binary_search(&v).expect("a corner") as u32;
    (
        used.iter().map(|v| body(points[*v as usize], 0.02)).collect(),
        kept.iter().map(|t| t.map(number)).collect(),
    )
}

fn fitted(outfit: &Surface, bodies: [&Surface; 2], clearance: Option<f64>) -> Result<Transferred, Error> {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = Deformer::open(
        file_of(outfit),
        &OpenOptions::default(),
        &DeformerLimits::default(),
        &exec,
    )?;
    let of = |surface| OtherModel {
        files: file_of(surface),
        ..OtherModel::default()
    };
    let command = TransferCommand {
        source: of(bodies[0]),
        shape: Some(of(bodies[1])),
        fit: Some(OutfitFit { clearance }),
        landmarks: Vec::new(),
        format: None,
    };
    deformer.transfer(deformer.rest(), &command, &exec)
}

#[test]
fn a_vest_is_outside_of_another_body_of_other_triangles_as_far_as_of_the_first() {
    let round = |subdivisions| {
        let (points, triangles) = shapes::icosphere(1.0, subdivisions);
        // Turned, so that no vertex is where one of the vest is.
        let turn = glam::DQuat::from_rotation_y(0.37);
        (points.iter().map(|p| turn * *p).collect::<Vec<_>>(), triangles)
    };
    let (points, triangles) = round(4);
    let first: Surface = (points.iter().map(|p| body(*p, 0.0)).collect(), triangles);
    let (points, triangles) = round(5);
    let second: Surface = (points.iter().map(|p| other(*p)).collect(), triangles);
    let outfit = vest();
    let came = fitted(&outfit, [&first, &second], Some(0.2)).expect("a vest");
    let told = came.report.fit.expect("a report");
    assert_eq!(
        (told.vertices as usize, told.inside_at_rest),
        (outfit.0.len(), 0),
        "{told:?}"
    );
    assert_eq!((told.inside, told.crossings), (0, 0), "{told:?}");
    assert!(told.edge_distortion < 0.15, "{told:?}");
    assert!(came.report.wrap.is_some());
    let now = Model::read(came.files.into_files("vest.off"), None, &Limits::default()).expect("a model");
    assert_eq!(now.triangles, outfit.1);
    for (was, now) in outfit.0.iter().zip(&now.positions) {
        assert!(is_outside(*now), "{was} {now}");
    }
}

#[test]
fn a_clearance_pushes_a_vest_out_and_what_was_inside_may_stay() {
    let (points, triangles) = shapes::icosphere(1.0, 4);
    let first: Surface = (points.iter().map(|p| body(*p, 0.0)).collect(), triangles.clone());
    // On the same triangles nothing is wrapped; the belly swells through the vest where it grows least.
    let second: Surface = (points.iter().map(|p| other(*p)).collect(), triangles);
    let mut outfit = vest();
    let tucked = outfit.0.len() / 2;
    outfit.0[tucked] *= 0.95;
    let came = fitted(&outfit, [&first, &second], None).expect("a vest");
    let told = came.report.fit.expect("a report");
    assert!(came.report.wrap.is_none());
    assert_eq!(
        (told.inside_at_rest, told.inside, told.crossings),
        (1, 0, 0),
        "{told:?}"
    );

    let problem = fitted(&outfit, [&first, &(Vec::new(), Vec::new())], None).expect_err("no body");
    assert!(
        matches!(&problem, Error::Invalid { field, .. } if field == "shape"),
        "{problem}"
    );
}
