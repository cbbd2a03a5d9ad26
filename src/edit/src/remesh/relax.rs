//! Evening out triangles without another one: points slide along the surface as it is.
//!
//! The pass of a remesh that moves points, alone, over and over: the same lines are kept, and the same bound on the distance
//! between the surface before and after.

use super::passes::smooth_points;
use super::remesher::{RemeshPlan, Remesher};
use super::sizing::DEVIATION;
use crate::patch::{EditWarning, SurfacePatch};
use crate::region_mesh::RegionMesh;
use crate::smooth::SmoothOptions;
use crate::surface::SurfaceView;
use pliant_exec::progress::Progress;
use pliant_mesh::{BoundingBox, Error};

/// The most moves of a point, all iterations together: some minutes.
const MOST_MOVES: u64 = 1 << 25;

/// Relaxes the triangles `faces`, rising numbers: each point slides towards the middle of its neighbours, along the surface; points of
/// boundaries, seams, primitive borders and sharp edges along those. Corners of such lines and the rim of the region stay.
/// Attributes are those of the place where a point comes to lie. A patch that changes nothing comes with the warning
/// `smooth-nothing`.
///
/// # Errors
/// [`Error::Invalid`] for options out of range or no region; [`Error::TooLarge`] for more moves of points than some minutes
/// take; [`Error::Cancelled`].
pub fn relax_region(
    surface: &SurfaceView<'_>,
    faces: &[u32],
    options: &SmoothOptions,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let mesh = options.gather(surface, faces, MOST_MOVES)?;
    let plan = RemeshPlan {
        sizes: mean_lengths(&mesh),
        max_deviation: DEVIATION * BoundingBox::of(surface.positions).diagonal(),
        sharp_cosine: options.sharp_cosine(),
        unfair: Vec::new(),
    };
    let mut work = Remesher::new(mesh, plan, progress);
    for iteration in 0..options.iterations {
        progress.report("edit", iteration as f32 / options.iterations as f32);
        smooth_points(&mut work, options.strength, progress)?;
    }
    let deviation = work.measure_deviation(progress)?;
    let mut patch = work.mesh.into_moves(surface);
    patch.deviation = deviation;
    if patch.moved.is_empty() {
        let message = "the triangles of the region are even, or held by its rim or by lines";
        patch
            .warnings
            .push(EditWarning::new("smooth-nothing", message, "region"));
    }
    Ok(patch)
}

/// The mean length of the edges at each point.
fn mean_lengths(mesh: &RegionMesh) -> Vec<f64> {
    let mut sums = vec![(0.0, 0u32); mesh.points.len()];
    for (a, b) in mesh.edges() {
        for p in [a, b] {
            sums[p as usize].0 += mesh.edge_length(a, b);
            sums[p as usize].1 += 1;
        }
    }
    sums.iter().map(|&(sum, count)| sum / f64::from(count.max(1))).collect()
}
