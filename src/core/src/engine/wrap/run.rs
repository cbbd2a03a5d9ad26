//! A wrap from its first step to its last.

use super::fit::WrapFit;
use super::normals::smooth_normals;
use super::place::place_by_shapes;
use super::report::{Told, WrapReport};
use super::similarity::{PlacePair, Similarity};
use super::target::TargetSurface;
use super::task::{LandmarkPair, WrapTask};
use super::visible::seen_vertices;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::Mesh;
use glam::DVec3;

/// Bytes that a wrap takes for each vertex of both surfaces.
pub(in crate::engine) const WRAPPED_BYTES: u64 = 2048;

/// Wraps: answers where the template's vertices are then, and how well they lie.
///
/// # Errors
/// [`Error::Precondition`] where nothing of the target is seen, those of building a body, [`Error::Cancelled`].
pub(in crate::engine) fn wrap(
    task: &WrapTask<'_>,
    target: Mesh,
    exec: &Exec<'_>,
) -> Result<(Vec<DVec3>, WrapReport), Error> {
    exec.progress.report("place", 0.0);
    let template = task.template;
    let normals = smooth_normals(&template.positions, &template.triangles);
    let mut pulled = seen_vertices(&template.positions, &normals, &template.triangles, exec)?;
    pulled
        .iter_mut()
        .zip(task.masked)
        .for_each(|(pulled, masked)| *pulled &= !masked);
    if !pulled.contains(&true) {
        let problem = "nothing of the model that is wrapped is left to be pulled: all of it is hidden or masked";
        return Err(Error::Precondition(problem.into()));
    }
    let target = TargetSurface::of(target, exec)?;
    let pairs = task.landmarks.iter().map(|landmark| PlacePair {
        from: landmark.target,
        to: landmark.place(&template.positions),
        weight: 1.0,
    });
    let pairs: Vec<PlacePair> = pairs.collect();
    let placed = match Similarity::of_pairs(&pairs) {
        Some(placed) => placed,
        None => place_by_shapes(template, &target, &pairs, exec)?,
    };
    let target = target.moved(&placed);
    let landmarks: Vec<LandmarkPair> = (task.landmarks.iter())
        .map(|landmark| LandmarkPair {
            target: placed.apply(landmark.target),
            ..*landmark
        })
        .collect();
    let placed_task = WrapTask {
        landmarks: &landmarks,
        ..*task
    };
    let mut fit = WrapFit::new(&placed_task, &target, &pulled, exec)?;
    fit.run(exec)?;
    let mut now = std::mem::take(&mut fit.now);
    drop(fit);
    let told = Told {
        template,
        now: &now,
        pulled: &pulled,
        target: &target,
        landmarks: landmarks.iter().map(|l| l.place(&now).distance(l.target)).collect(),
    };
    let report = told.measure(exec)?;
    if !task.in_place {
        let back = placed.inverse();
        now.iter_mut().for_each(|p| *p = back.apply(*p));
    }
    Ok((now, report))
}
