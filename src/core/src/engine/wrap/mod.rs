//! A template wrapped onto a target: a model with its topology, texture coordinates, rig and morph targets takes the shape of another
//! surface, mostly a scan with noise and holes (non-rigid iterated closest points, after Amberg et al. 2007, with rotations fitted
//! at every vertex in place of affine maps).
//!
//! `place` puts the target over the template, by landmarks or by the shapes. `fit` solves for landmarks alone, and then for closest
//! points, pulled harder from level to level; `target` says which of them count, `visible` what can be seen, `two_way` what of
//! the target pulls the template. `told` measures.

mod command;
mod fit;
mod place;
mod queries;
mod surface;
mod target;
mod told;
mod two_way;
mod visible;

use crate::deform::BodyOptions;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::Mesh;
pub use command::{LandmarkPlace, WrapCommand, WrapLandmark};
use fit::WrapFit;
use glam::DVec3;
use place::{PlacePair, Similarity, smooth_normals};
pub(super) use surface::SurfaceWrapping;
use target::TargetSurface;
use told::Told;
pub use told::{WrapDistances, WrapReport};
use visible::seen_vertices;

/// A template and what it is to be wrapped onto.
pub(super) struct WrapTask<'a> {
    /// The template's surface, welded.
    pub template: &'a Mesh,
    /// By vertex, whether the caller leaves it out.
    pub masked: &'a [bool],
    pub landmarks: &'a [LandmarkPair],
    /// How bodies are built.
    pub body: &'a BodyOptions,
    /// Whether the result is in the place, and of the size, of the template, not of the target.
    pub in_place: bool,
}

/// A landmark of both surfaces.
#[derive(Debug, Clone, Copy)]
pub(super) struct LandmarkPair {
    /// Vertices of the template with weights.
    pub own: [(u32, f64); 3],
    /// Where it is on the target; while a fit runs, over the template.
    pub target: DVec3,
}

impl LandmarkPair {
    fn place(&self, positions: &[DVec3]) -> DVec3 {
        self.own.iter().map(|(v, w)| positions[*v as usize] * *w).sum()
    }
}

/// Wraps: answers where the template's vertices are then, and how well they lie.
///
/// # Errors
/// [`Error::Precondition`] where nothing of the target is seen, those of building a body, [`Error::Cancelled`].
pub(super) fn wrap(task: &WrapTask<'_>, target: Mesh, exec: &Exec<'_>) -> Result<(Vec<DVec3>, WrapReport), Error> {
    exec.progress.report("place", 0.0);
    let template = task.template;
    let normals = smooth_normals(&template.positions, &template.triangles);
    let mut pulled = seen_vertices(&template.positions, &normals, &template.triangles, exec)?;
    pulled
        .iter_mut()
        .zip(task.masked)
        .for_each(|(pulled, masked)| *pulled &= !masked);
    if !pulled.contains(&true) {
        let problem = "nothing of the template is left to be pulled: all of it is hidden or masked";
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
        None => Similarity::of_shapes(template, &target, &pairs, exec)?,
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
