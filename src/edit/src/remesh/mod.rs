//! Isotropic remeshing of a region: triangles near to equilateral, edges near to a target length.
//!
//! After Botsch and Kobbelt, "A Remeshing Approach to Multiresolution Modeling" (2004). Every point knows where on the
//! original surface it lies, so shape and attributes come from there and nothing drifts. Boundaries, seams, primitive
//! borders and sharp edges are lines: their points slide along them, are added and taken away, but never leave them.
//! No step is taken that would bring the old and the new surface farther apart than is allowed (`deviation`), so thin limbs
//! stay what they are; target lengths are shorter where the surface is curved, so that few steps are refused.
//! The rim of the region and edges with more than two faces stay as they are, so what lies outside does not notice;
//! target lengths approach those of the rim towards it.

mod deviation;
mod feature_lines;
mod passes;
mod relax;
mod remesher;
mod sizing;

pub use relax::relax_region;
pub use sizing::{
    ASPECT, DEVIATION, LENGTH_DEVIATION, MENDED, MOST_TRIANGLES, RemeshOptions, RemeshTarget, SHARP_DEGREES, STRETCH,
};

use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::surface::{SurfaceView, check_region};
use super::triangle;
use pliant_exec::progress::Progress;
use pliant_mesh::{BoundingBox, Error};
use remesher::{RemeshPlan, Remesher};

/// Rounds of split, collapse, turn, smooth.
const ROUNDS: usize = 6;

/// Rounds end when no more than one in so many edges was changed.
const SETTLED: usize = 50;

/// Rounds of mending at the end.
const MENDING: usize = 6;

/// Remeshes the triangles `region`, rising numbers. With [`RemeshTarget::Auto`] fair triangles stay unless an unfair one is
/// beside them; a patch that changes nothing comes with the warning `remesh-nothing`. Faces that stay worse than [`MENDED`]
/// are counted in the warning `remesh-aspect`, those that stand against the surface beside them, because it is thinner
/// there than the target length, in `remesh-thin`.
///
/// # Errors
/// [`Error::Invalid`] for a length, distance or angle out of range, a rest shape of another size, or no region;
/// [`Error::TooLarge`] when the target is so short that more than [`MOST_TRIANGLES`] would come;
/// [`Error::Cancelled`].
pub fn remesh_region(
    surface: &SurfaceView,
    region: &[u32],
    options: &RemeshOptions,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let Some((mesh, plan)) = plan_remesh(surface, region, options)? else {
        return Ok(SurfacePatch {
            warnings: vec![nothing_to_remesh()],
            ..SurfacePatch::default()
        });
    };
    let expected = sizing::estimate_triangles(&mesh, &plan.sizes);
    if expected.is_nan() || expected > MOST_TRIANGLES as f64 {
        return Err(Error::TooLarge {
            what: "triangles in the remeshed region",
            seen: if expected < 1e18 { expected as u64 } else { u64::MAX },
            limit: MOST_TRIANGLES,
        });
    }
    let mut work = Remesher::new(mesh, plan, progress);
    run_passes(&mut work, expected, progress)?;
    let warnings = [
        warn_where(&work, "remesh-aspect", |work, f| {
            triangle::aspect(work.mesh.corner_positions(f)) > MENDED
        }),
        warn_where(&work, "remesh-thin", Remesher::stands_against),
    ];
    let deviation = work.measure_deviation(progress)?;
    let (mut patch, _) = work.mesh.into_patch(surface);
    patch.deviation = deviation;
    patch.warnings = warnings.into_iter().flatten().collect();
    if patch.removed.is_empty() && patch.triangles.is_empty() {
        patch.warnings.push(nothing_to_remesh());
    }
    Ok(patch)
}

/// About how many triangles [`remesh_region`] would make of the region, which now has `region.len()`, before anything is
/// remeshed. What comes in the end is within four times as many.
///
/// # Errors
/// [`Error::Invalid`] as of [`remesh_region`].
pub fn expected_triangles(surface: &SurfaceView, region: &[u32], options: &RemeshOptions) -> Result<f64, Error> {
    let planned = plan_remesh(surface, region, options)?;
    Ok(planned.map_or(0.0, |(mesh, plan)| sizing::estimate_triangles(&mesh, &plan.sizes)))
}

/// Checks the arguments and gathers what is to be remeshed with the target length at each point; `None` when no face of
/// the region is stretched.
fn plan_remesh(
    surface: &SurfaceView,
    region: &[u32],
    options: &RemeshOptions,
) -> Result<Option<(RegionMesh, RemeshPlan)>, Error> {
    check_region(surface, region)?;
    let positive = |value: f64, field: &str, what: &str| match value > 0.0 && value.is_finite() {
        true => Ok(value),
        false => Err(Error::invalid(
            field,
            format!("{value} is not a {what}, it must be finite and above 0"),
        )),
    };
    let (mesh, mut wanted, unfair, own) = match options.target {
        RemeshTarget::Length(length) => {
            positive(length, "remesh.edgeLength", "length")?;
            let mesh = RegionMesh::with_frozen_ring(surface, region)?;
            let wanted = vec![length; mesh.points.len()];
            (mesh, wanted, Vec::new(), LENGTH_DEVIATION * length)
        }
        RemeshTarget::Auto { rest } => {
            if rest.len() != surface.positions.len() {
                let (seen, needed) = (rest.len(), surface.positions.len());
                let problem = format!("the rest shape has {seen} vertices, the surface {needed}");
                return Err(Error::invalid("remesh.auto", problem));
            }
            let stretched = passes::find_stretched_faces(surface, region, rest);
            if stretched.is_empty() {
                return Ok(None);
            }
            let mesh = RegionMesh::with_frozen_ring(surface, &stretched)?;
            let wanted = passes::rest_lengths(&mesh, rest);
            let unfair = mesh.triangles.iter().map(|&t| passes::is_unfair(surface, t, rest));
            let unfair = unfair.collect();
            (mesh, wanted, unfair, 0.0)
        }
    };
    let max_deviation = match options.max_deviation {
        Some(given) => positive(given, "remesh.maxDeviation", "distance")?,
        None => own.max(DEVIATION * BoundingBox::of(surface.positions).diagonal()),
    };
    let sharp = options.sharp_degrees;
    if !(sharp > 0.0 && sharp <= 180.0) {
        let problem = format!("{sharp} is not an angle between two faces, it must be above 0 and at most 180 degrees");
        return Err(Error::invalid("remesh.sharpDegrees", problem));
    }
    let sharp_cosine = libm::cos(sharp.to_radians());
    sizing::shorten_for_curvature(&mesh, &mut wanted, max_deviation, sharp_cosine);
    let plan = RemeshPlan {
        sizes: sizing::grade_lengths(&mesh, &wanted),
        max_deviation,
        sharp_cosine,
        unfair,
    };
    Ok(Some((mesh, plan)))
}

/// Runs rounds of the passes until little changes, then mends what is still badly shaped. About `expected` triangles will
/// come.
fn run_passes(work: &mut Remesher<'_>, expected: f64, progress: &dyn Progress) -> Result<(), Error> {
    let start = work.mesh.faces.len();
    // Twice what equilateral triangles would be, and the faces that splits and collapses leave behind.
    let most = start + 4 * expected as usize + 4096;
    for round in 0..ROUNDS {
        progress.report("edit", round as f32 / ROUNDS as f32);
        let edges = 3 * work.mesh.living_faces().count() / 2;
        let split = passes::split_long_edges(work, start + (round + 1) * most, progress)?;
        let collapsed = passes::collapse_short_edges(work, progress)?;
        let turned = passes::even_valences(work, progress)?;
        if round > 0 && split + collapsed + turned == 0 {
            break;
        }
        passes::smooth_points(work, 1.0, progress)?;
        if round >= 2 && split + collapsed + turned < edges / SETTLED {
            break;
        }
    }
    for _ in 0..MENDING {
        if passes::mend_faces(work, MENDED, progress)? == 0 {
            break;
        }
        passes::even_valences(work, progress)?;
        passes::smooth_points(work, 1.0, progress)?;
    }
    work.refresh_sources(progress)
}

/// Warns of the faces for which `holds` is true: how many they are and where the first one is.
fn warn_where<'a>(work: &Remesher<'a>, code: &str, holds: impl Fn(&Remesher<'a>, u32) -> bool) -> Option<EditWarning> {
    let mut found = work.mesh.living_faces().filter(|&f| holds(work, f));
    let place = work.mesh.corner_positions(found.next()?)[0];
    let count = 1 + found.count();
    let message = if code == "remesh-thin" {
        format!("{count} triangles cut across parts of the surface that are thinner than the target length")
    } else {
        format!(
            "{count} triangles stay further than {MENDED} from equilateral: the rim of the region, seams, boundaries or sharp edges hold them"
        )
    };
    Some(EditWarning::new(code, message, format!("{place}")))
}

fn nothing_to_remesh() -> EditWarning {
    EditWarning::new("remesh-nothing", "no triangle of the region needs remeshing", "region")
}
