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
mod remesher;

use super::error::{EditSubject, Error};
use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::surface::{SurfaceView, check_region};
use super::triangle;
use crate::mesh::BoundingBox;
use crate::progress::Progress;
use glam::DVec3;
use remesher::{RemeshPlan, Remesher};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Rounds of split, collapse, turn, smooth.
const ROUNDS: usize = 6;

/// Rounds end when no more than one in so many edges was changed.
const SETTLED: usize = 50;

/// Rounds of mending at the end.
const MENDING: usize = 6;

/// A remeshed region.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RemeshedRegion {
    /// What changes.
    pub patch: SurfacePatch,
    /// The largest distance between the old and the new surface.
    pub deviation: f64,
}

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
) -> Result<RemeshedRegion, Error> {
    let Some((mesh, plan)) = plan_remesh(surface, region, options)? else {
        return Ok(RemeshedRegion {
            patch: SurfacePatch {
                warnings: vec![nothing_to_remesh()],
                ..SurfacePatch::default()
            },
            deviation: 0.0,
        });
    };
    let expected = estimate_triangles(&mesh, &plan.sizes);
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
    patch.warnings = warnings.into_iter().flatten().collect();
    if patch.removed.is_empty() && patch.triangles.is_empty() {
        patch.warnings.push(nothing_to_remesh());
    }
    Ok(RemeshedRegion { patch, deviation })
}

/// About how many triangles [`remesh_region`] would make of the region, which now has `region.len()`, before anything is
/// remeshed. What comes in the end is within four times as many.
///
/// # Errors
/// [`Error::Invalid`] as of [`remesh_region`].
pub fn expected_triangles(surface: &SurfaceView, region: &[u32], options: &RemeshOptions) -> Result<f64, Error> {
    let planned = plan_remesh(surface, region, options)?;
    Ok(planned.map_or(0.0, |(mesh, plan)| estimate_triangles(&mesh, &plan.sizes)))
}

/// Checks the arguments and gathers what is to be remeshed with the target length at each point; `None` when no face of
/// the region is stretched.
fn plan_remesh(
    surface: &SurfaceView,
    region: &[u32],
    options: &RemeshOptions,
) -> Result<Option<(RegionMesh, RemeshPlan)>, Error> {
    check_region(surface, region)?;
    let positive = |value: f64, subject: EditSubject, what: &str| match value > 0.0 && value.is_finite() {
        true => Ok(value),
        false => Err(Error::invalid(
            subject,
            format!("{value} is not a {what}, it must be finite and above 0"),
        )),
    };
    let (mesh, mut wanted, unfair, own) = match options.target {
        RemeshTarget::Length(length) => {
            positive(length, EditSubject::RemeshEdgeLength, "length")?;
            let mesh = RegionMesh::with_frozen_ring(surface, region)?;
            let wanted = vec![length; mesh.points.len()];
            (mesh, wanted, Vec::new(), LENGTH_DEVIATION * length)
        }
        RemeshTarget::Auto { rest } => {
            if rest.len() != surface.positions.len() {
                let (seen, needed) = (rest.len(), surface.positions.len());
                let problem = format!("the rest shape has {seen} vertices, the surface {needed}");
                return Err(Error::invalid(EditSubject::RemeshRestShape, problem));
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
        Some(given) => positive(given, EditSubject::RemeshDeviation, "distance")?,
        None => own.max(DEVIATION * BoundingBox::of(surface.positions).diagonal()),
    };
    let sharp = options.sharp_degrees;
    if !(sharp > 0.0 && sharp <= 180.0) {
        let problem = format!("{sharp} is not an angle between two faces, it must be above 0 and at most 180 degrees");
        return Err(Error::invalid(EditSubject::RemeshSharpAngle, problem));
    }
    let sharp_cosine = libm::cos(sharp.to_radians());
    shorten_for_curvature(&mesh, &mut wanted, max_deviation, sharp_cosine);
    let plan = RemeshPlan {
        sizes: grade_lengths(&mesh, &wanted),
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
        passes::smooth_points(work, progress)?;
        if round >= 2 && split + collapsed + turned < edges / SETTLED {
            break;
        }
    }
    for _ in 0..MENDING {
        if passes::mend_faces(work, MENDED, progress)? == 0 {
            break;
        }
        passes::even_valences(work, progress)?;
        passes::smooth_points(work, progress)?;
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

/// By how much the target length may change over a unit of distance.
const SLOPE: f64 = 0.5;

/// A chord of this length times the root of what is allowed over the curvature keeps within three quarters of it.
const CHORD: f64 = 6.0;

/// Shortens `wanted` lengths to chords that keep within `max_deviation` of a surface curved as `mesh` is, but not below
/// the shortest edges that are there: shorter ones would follow it no better. Edges with a smaller cosine than
/// `sharp_cosine` between their faces are no curvature.
///
/// The curvature at a point is what edges turn by, over the area around it and around its neighbours.
fn shorten_for_curvature(mesh: &RegionMesh, wanted: &mut [f64], max_deviation: f64, sharp_cosine: f64) {
    let edges = mesh.edges();
    let mut shortest = vec![(0.0, 0.0); mesh.points.len()];
    let mut around = vec![(0.0, 0.0); mesh.points.len()];
    for f in mesh.living_faces() {
        let [a, b, c] = mesh.points_of(f);
        let area = 0.5 * mesh.area_normal(f).length();
        let least = (mesh.edge_length(a, b))
            .min(mesh.edge_length(b, c))
            .min(mesh.edge_length(c, a));
        for p in [a, b, c] {
            shortest[p as usize].0 += least;
            shortest[p as usize].1 += 1.0;
            around[p as usize].1 += area / 3.0;
        }
    }
    for &(a, b) in &edges {
        let edge = mesh.edge_faces(a, b);
        if edge.faces().count() != 2 {
            continue;
        }
        let [n, m] = [edge.left, edge.right].map(|f| mesh.area_normal(f).normalize_or_zero());
        if n.dot(m) >= sharp_cosine {
            let turned = 0.5 * n.distance(m) * mesh.edge_length(a, b);
            around[a as usize].0 += turned;
            around[b as usize].0 += turned;
        }
    }
    let mut wider = around.clone();
    for &(a, b) in &edges {
        for (p, q) in [(a as usize, b as usize), (b as usize, a as usize)] {
            wider[p].0 += around[q].0;
            wider[p].1 += around[q].1;
        }
    }
    for ((length, (turned, area)), (sum, count)) in wanted.iter_mut().zip(wider).zip(shortest) {
        let chord = (CHORD * max_deviation * area / turned).sqrt();
        if chord.is_finite() && count > 0.0 {
            *length = length.min(chord.max(sum / count));
        }
    }
}

/// Target lengths at the points of a mesh: `wanted` where nothing stands against it; at points that hold edges which
/// cannot change, the length of those; in between no steeper than [`SLOPE`].
fn grade_lengths(mesh: &RegionMesh, wanted: &[f64]) -> Vec<f64> {
    let edges = mesh.edges();
    let mut held = vec![(0.0, 0u32); mesh.points.len()];
    let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); mesh.points.len()];
    for &(a, b) in &edges {
        let length = mesh.edge_length(a, b);
        rows[a as usize].push((b, length));
        rows[b as usize].push((a, length));
        if mesh.is_locked(mesh.edge_faces(a, b)) {
            for p in [a, b] {
                held[p as usize].0 += length;
                held[p as usize].1 += 1;
            }
        }
    }
    let pinned: Vec<Option<f64>> = held
        .iter()
        .map(|&(sum, count)| (count > 0).then(|| sum / f64::from(count)))
        .collect();
    // No smaller than what held edges of a larger length nearby ask for: its negative, rising from them.
    let floor = limit_slope(&rows, pinned.iter().map(|p| p.map(|l| -l)).collect());
    let start = wanted.iter().zip(&pinned).zip(&floor).map(|((&w, pin), floor)| {
        let least = floor.map_or(0.0, |f| -f);
        Some(pin.unwrap_or(w.max(least)))
    });
    let ceiling = limit_slope(&rows, start.collect());
    ceiling.iter().zip(wanted).map(|(c, &w)| c.unwrap_or(w)).collect()
}

/// The least of all `values` after each has risen by [`SLOPE`] with the distance along edges. `None`: without a value.
fn limit_slope(rows: &[Vec<(u32, f64)>], mut values: Vec<Option<f64>>) -> Vec<Option<f64>> {
    // Order numbers of either sign by their bits.
    let key = |x: f64| {
        let bits = x.to_bits() as i64;
        bits ^ (((bits >> 63) as u64) >> 1) as i64
    };
    let mut queue: BinaryHeap<Reverse<(i64, u32)>> = (values.iter().zip(0u32..))
        .filter_map(|(v, p)| Some(Reverse((key((*v)?), p))))
        .collect();
    while let Some(Reverse((order, p))) = queue.pop() {
        let Some(value) = values[p as usize].filter(|&v| key(v) == order) else {
            continue;
        };
        for &(q, length) in &rows[p as usize] {
            let risen = value + SLOPE * length;
            if values[q as usize].is_none_or(|v| risen < v) {
                values[q as usize] = Some(risen);
                queue.push(Reverse((key(risen), q)));
            }
        }
    }
    values
}

/// How many triangles the region would have with these target lengths, at least.
fn estimate_triangles(mesh: &RegionMesh, sizes: &[f64]) -> f64 {
    let equilateral = 3f64.sqrt() / 4.0;
    mesh.living_faces()
        .map(|f| {
            let area = 0.5 * mesh.area_normal(f).length();
            let size: f64 = mesh.points_of(f).iter().map(|&p| sizes[p as usize]).sum::<f64>() / 3.0;
            area / (equilateral * size * size)
        })
        .sum()
}

/// What a remesh aims for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RemeshTarget<'a> {
    /// Edges of this length everywhere.
    Length(f64),
    /// Only around faces with an edge longer than [`STRETCH`] times its rest length, or an aspect over [`ASPECT`]; there
    /// edges get their rest length.
    Auto {
        /// The rest shape: one position per render vertex.
        rest: &'a [DVec3],
    },
}

/// How a remesh goes about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemeshOptions<'a> {
    /// What it aims for.
    pub target: RemeshTarget<'a>,
    /// How far the old and the new surface may be from each other, model units. `None`: [`DEVIATION`] of the diagonal of
    /// the surface's bounding box, or [`LENGTH_DEVIATION`] of the length that is aimed for where that is more.
    pub max_deviation: Option<f64>,
    /// An edge stays an edge when the normals of its faces differ by more, degrees.
    pub sharp_degrees: f64,
}

impl<'a> From<RemeshTarget<'a>> for RemeshOptions<'a> {
    fn from(target: RemeshTarget<'a>) -> Self {
        Self {
            target,
            max_deviation: None,
            sharp_degrees: SHARP_DEGREES,
        }
    }
}

/// The part of the diagonal by which surfaces may differ where nothing else is asked for.
pub const DEVIATION: f64 = 1.5e-3;

/// The part of the length aimed for by which surfaces may differ where nothing else is asked for.
pub const LENGTH_DEVIATION: f64 = 0.2;

/// Edges sharper than this stay edges where nothing else is asked for, degrees.
pub const SHARP_DEGREES: f64 = 40.0;

/// [`RemeshTarget::Auto`] remeshes where an edge is longer than this times its rest length.
pub const STRETCH: f64 = 1.5;

/// [`RemeshTarget::Auto`] remeshes where a face is further from equilateral than this: longest side times perimeter over
/// 4·√3 times the area, 1 at best.
pub const ASPECT: f64 = 4.0;

/// Faces are mended until none is worse than this, as far as boundaries and lines allow.
pub const MENDED: f64 = 4.0;

/// Most triangles that a remesh makes.
pub const MOST_TRIANGLES: u64 = 8 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_rise_with_distance_from_the_least_source_of_either_sign() {
        let rows: Vec<Vec<(u32, f64)>> = vec![
            vec![(1, 2.0)],
            vec![(0, 2.0), (2, 2.0)],
            vec![(1, 2.0), (3, 4.0)],
            vec![(2, 4.0)],
            vec![],
        ];
        let grown = limit_slope(&rows, vec![Some(1.0), None, Some(9.0), Some(1.5), None]);
        assert_eq!(grown, [Some(1.0), Some(2.0), Some(3.0), Some(1.5), None]);
        let grown = limit_slope(&rows, vec![Some(-4.0), None, None, Some(-4.5), None]);
        assert_eq!(grown, [Some(-4.0), Some(-3.0), Some(-2.5), Some(-4.5), None]);
    }
}
