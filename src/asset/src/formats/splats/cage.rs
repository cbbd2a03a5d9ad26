//! A closed surface around a cloud of splats: what a model of splats is posed by.
//!
//! The ellipsoids are marked in a grid, what they enclose is filled, and the faces between full and empty cells become the surface,
//! which is then smoothed (Taubin 1995). Cells are filled until no two of them touch along an edge or in a corner alone, so that
//! the surface is a manifold.

use super::cells::CellGrid;
use super::cloud::Splats;
use crate::Error;
use crate::files::ReadWatch;
use glam::{DMat3, DQuat, DVec3};

/// How many times the grid is made again to come near the wanted number of triangles.
const TRIALS: usize = 6;
/// The number of triangles may differ from the wanted one by this factor.
const NEAR: f64 = 1.2;
/// What is fainter than this opacity, before the logistic function, is not looked at (5 %).
const FAINT: f32 = -3.0;
/// A splat counts as far as so many standard deviations.
const SPLAT_END: f64 = 1.5;
/// A splat counts no farther than this share of the cloud's diagonal: those of a sky are larger than what stands before it.
const LARGEST_SHARE: f64 = 0.03;
/// No farther than so many cells either, which bounds the work.
const LARGEST_CELLS: f64 = 3.0;
/// The share of the splats at each end of an axis that may be strays.
const STRAYS: f64 = 0.002;
/// How far beside the others strays count, as a share of the extent of those.
const BESIDE: f64 = 0.25;
/// Of clouds so small that this share is none, so many splats at each end may be strays, and no more than this part of all,
const FEW_STRAYS: usize = 4;
const STRAYS_OF_FEW: usize = 8;
/// where they are so far off that the others would fill next to no cells.
const FAR_BESIDE: f64 = 4.0;
/// Quads for so many splats are enough: with more the surface has holes.
const SPLATS_PER_QUAD: usize = 2;
const LEAST_QUADS: usize = 400;
/// Steps of smoothing, each inward and outward.
const SMOOTHING: usize = 8;
const INWARD: f64 = 0.5;
const OUTWARD: f64 = -0.53;

/// A closed surface.
#[derive(Debug, Default)]
pub(super) struct Cage {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

/// A splat as the grid sees it.
struct GridSplat {
    center: DVec3,
    /// Columns are the axes, of length 1.
    axes: DMat3,
    /// How far it counts along them.
    ends: DVec3,
}

impl Cage {
    /// Builds the surface around `splats`, of about so many triangles; fewer where the splats are too few for it.
    ///
    /// # Errors
    /// [`Error::Cancelled`], and [`Error::TooLarge`] where the grid may not be held.
    pub fn around(splats: &Splats, triangles: u32, watch: &ReadWatch<'_>) -> Result<Self, Error> {
        let seen = visible(splats);
        let bounds = CloudBounds::of(&seen);
        let quads = (triangles as usize / 2).min((splats.len() / SPLATS_PER_QUAD).max(LEAST_QUADS)) as f64;
        let mut step = bounds.diagonal() / 40.0;
        let mut best: Option<(f64, CellGrid)> = None;
        for _ in 0..TRIALS {
            let mut grid = CellGrid::over(bounds.min, bounds.max, step, watch)?;
            step = grid.step;
            mark(&mut grid, &seen, bounds.diagonal(), watch)?;
            grid.make_solid(watch)?;
            let ratio = grid.faces() as f64 / quads;
            let off = ratio.max(1.0 / ratio);
            let tried = best.as_ref().is_some_and(|(_, other)| other.step == grid.step);
            if best.as_ref().is_none_or(|(other, _)| off < *other) {
                best = Some((off, grid));
            }
            if off < NEAR || tried {
                break;
            }
            step *= ratio.sqrt().clamp(0.25, 4.0);
        }
        let mut cage = Self::default();
        if let Some((_, grid)) = best {
            let (mut positions, quads) = grid.surface();
            smooth(&mut positions, &quads);
            cage.triangles = quads.iter().flat_map(|quad| halves(&positions, quad)).collect();
            cage.positions = positions;
            watch.check_triangles(cage.triangles.len() as u64)?;
        }
        Ok(cage)
    }
}

/// The splats that are seen; all of them where none is.
fn visible(splats: &Splats) -> Vec<GridSplat> {
    let one = |i: usize| {
        let shape = &splats.shapes[i];
        let (axes, ends) = match shape.is_sound() {
            true => {
                let turn = DQuat::from_array(shape.turn.map(f64::from));
                let end = shape.log_scale.map(|s| SPLAT_END * libm::exp(f64::from(s)));
                (DMat3::from_quat(turn), DVec3::from_array(end))
            }
            false => (DMat3::IDENTITY, DVec3::ZERO),
        };
        GridSplat {
            center: splats.centers[i],
            axes,
            ends,
        }
    };
    let is_seen = |i: &usize| splats.looks[*i].opacity > FAINT;
    let seen: Vec<GridSplat> = (0..splats.len()).filter(is_seen).map(one).collect();
    match seen.is_empty() {
        true => (0..splats.len()).map(one).collect(),
        false => seen,
    }
}

/// The box that the grid is laid over: around all centres but strays.
struct CloudBounds {
    min: DVec3,
    max: DVec3,
}

impl CloudBounds {
    fn of(seen: &[GridSplat]) -> Self {
        let (mut min, mut max) = (DVec3::ZERO, DVec3::ZERO);
        for axis in 0..3 {
            let mut places: Vec<f64> = seen.iter().map(|splat| splat.center[axis]).collect();
            places.sort_unstable_by(f64::total_cmp);
            let (Some(first), Some(last)) = (places.first(), places.last()) else {
                continue;
            };
            (min[axis], max[axis]) = (*first, *last);
            let share = (places.len() as f64 * STRAYS) as usize;
            let few = FEW_STRAYS.min((places.len() - 1) / STRAYS_OF_FEW);
            for (strays, beside) in [(share, BESIDE), (few, FAR_BESIDE)] {
                let (low, high) = (places[strays], places[places.len() - 1 - strays]);
                min[axis] = min[axis].max(low - beside * (high - low));
                max[axis] = max[axis].min(high + beside * (high - low));
            }
        }
        let mut ends: Vec<f64> = seen.iter().map(|splat| splat.ends.max_element()).collect();
        ends.sort_unstable_by(f64::total_cmp);
        let end = ends.get(ends.len() / 2).copied().filter(|end| *end > 0.0);
        let least = 1e-6 * min.abs().max(max.abs()).max_element();
        let extent = (max - min).length();
        let most = if extent > 0.0 { extent } else { f64::INFINITY };
        let beside = end.unwrap_or(least).min(most).max(least);
        let beside = DVec3::splat(if beside > 0.0 { beside } else { 1.0 });
        Self {
            min: min - beside,
            max: max + beside,
        }
    }

    fn diagonal(&self) -> f64 {
        (self.max - self.min).length()
    }
}

/// Marks the cells that splats reach: thin ones and small ones those around their middle.
fn mark(grid: &mut CellGrid, seen: &[GridSplat], diagonal: f64, watch: &ReadWatch<'_>) -> Result<(), Error> {
    let most = (LARGEST_SHARE * diagonal).min(LARGEST_CELLS * grid.step);
    for (k, splat) in seen.iter().enumerate() {
        watch.check_at(k)?;
        let Some(own) = grid.cell_at(splat.center) else {
            continue;
        };
        grid.fill(own);
        let ends = splat.ends.min(DVec3::splat(most)) + DVec3::splat(0.5 * grid.step);
        let squares = |row: usize| (splat.axes.row(row) * ends).length();
        let reach = DVec3::new(squares(0), squares(1), squares(2));
        let inward = DMat3::from_diagonal(ends.recip()) * splat.axes.transpose();
        grid.fill_within(splat.center, reach, |place| {
            (inward * (place - splat.center)).length_squared() <= 1.0
        });
    }
    Ok(())
}

/// Smooths a surface and keeps its volume, nearly.
fn smooth(positions: &mut [DVec3], quads: &[[u32; 4]]) {
    for step in 0..2 * SMOOTHING {
        let mut sums = vec![(DVec3::ZERO, 0u32); positions.len()];
        for quad in quads {
            for k in 0..4 {
                // Each edge is in two quads, once in each direction.
                let (from, to) = (quad[k] as usize, quad[(k + 1) % 4] as usize);
                sums[from].0 += positions[to];
                sums[from].1 += 1;
            }
        }
        let share = if step % 2 == 0 { INWARD } else { OUTWARD };
        for (position, (sum, count)) in positions.iter_mut().zip(sums) {
            if count > 0 {
                *position += (sum / f64::from(count) - *position) * share;
            }
        }
    }
}

/// A quad as two triangles, along the shorter diagonal.
fn halves(positions: &[DVec3], quad: &[u32; 4]) -> [[u32; 3]; 2] {
    let [a, b, c, d] = *quad;
    let length = |from: u32, to: u32| positions[from as usize].distance_squared(positions[to as usize]);
    match length(a, c) <= length(b, d) {
        true => [[a, b, c], [a, c, d]],
        false => [[a, b, d], [b, c, d]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quad_is_halved_along_its_shorter_diagonal() {
        let places = [DVec3::ZERO, DVec3::X, DVec3::new(2.0, 2.0, 0.0), DVec3::Y];
        assert_eq!(halves(&places, &[0, 1, 2, 3]), [[0, 1, 3], [1, 2, 3]]);
    }
}
