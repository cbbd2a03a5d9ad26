//! Triangles sorted into the cells of a uniform grid.
//!
//! Where triangles are of about one size, a query that reaches about as far as they are long finds all it needs in a few
//! cells: no tree is walked, and the cells of a row stand next to each other in memory.

use crate::mesh::query::box_grid::{BoxGrid, GridLimits};
use crate::mesh::query::closest_point::closest_point_on_triangle;
use crate::mesh::query::closest_surface_point::corner_near;
use crate::mesh::query::segment_hit::{SegmentHit, crossing};
use crate::pool::Pool;
use glam::DVec3;

/// Cells and entries for each triangle, at most.
const LIMITS: GridLimits = GridLimits {
    cells: 16.0,
    entries: 8.0,
};
/// Triangles that share a cell with one of them on average, at most: beyond this the triangles are of too many sizes.
const CROWD: u64 = 64;
/// Sides of cells that a piece of a segment is long, at most.
const STRIDE: f64 = 2.0;

/// Triangles sorted into the cells of a uniform grid, which answers queries of short reach.
///
/// It is built in linear time and holds at most about 130 bytes per triangle.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::mesh::query::TriangleCells;
/// use pliant_core::pool::Pool;
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let triangles = [[0, 1, 2]];
/// let cells = TriangleCells::sort(&positions, &triangles, 1.0, &Pool::new(1)?).expect("one triangle fits");
/// assert!(cells.has_triangle_within(DVec3::new(0.2, 0.2, 0.5), 0.6));
/// assert!(!cells.has_triangle_within(DVec3::new(0.2, 0.2, 0.5), 0.4));
/// assert!(cells.is_crossed(DVec3::new(0.2, 0.2, 0.5), DVec3::new(0.2, 0.2, -0.5), None));
/// # Ok::<(), pliant_core::pool::PoolError>(())
/// ```
#[derive(Debug)]
pub struct TriangleCells<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    grid: BoxGrid,
    /// Side of a cell.
    side: f64,
}

impl<'a> TriangleCells<'a> {
    /// Sorts `triangles` into cells of about the given `side`, which is to be about what queries reach. `None` where the
    /// triangles are of too many sizes for one size of cells, or too many; then a tree is the better choice.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn sort(positions: &'a [DVec3], triangles: &'a [[u32; 3]], side: f64, pool: &Pool) -> Option<Self> {
        if !side.is_finite() {
            return None;
        }
        let grid = BoxGrid::of_triangles(positions, triangles, DVec3::splat(side), LIMITS, pool)?;
        let side = grid.longest_side();
        (grid.crowd() <= CROWD).then_some(Self {
            positions,
            triangles,
            grid,
            side,
        })
    }

    /// Lists the corners of all triangles, each once, so that vertices next to each other in the list are close in space.
    pub fn vertices_in_space_order(&self) -> Vec<u32> {
        let mut seen = vec![false; self.positions.len()];
        let corners = self.grid.numbers_in_order().flat_map(|t| self.triangles[t as usize]);
        corners
            .filter(|&v| !std::mem::replace(&mut seen[v as usize], true))
            .collect()
    }

    /// What long queries have looked at.
    pub(crate) fn visits(&self) -> u64 {
        self.grid.visits.total()
    }

    /// Side of a cell.
    pub fn side(&self) -> f64 {
        self.side
    }

    /// Returns whether any triangle is nearer than `radius`. The work grows with the cells that the ball overlaps.
    pub fn has_triangle_within(&self, point: DVec3, radius: f64) -> bool {
        let reach = DVec3::splat(radius);
        let square = radius * radius;
        self.grid.find_overlapping(point - reach, point + reach, |triangle| {
            closest_point_on_triangle(point, self.corners_of(triangle)).distance_squared(point) < square
        })
    }

    /// Returns whether the segment crosses or touches any triangle, but for those with the corner `except`.
    pub fn is_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool {
        let direction = to - from;
        self.find_along(from, to, |triangle, _| {
            let left_out = except.is_some_and(|v| self.triangles[triangle as usize].contains(&v));
            !left_out && crossing(from, direction, self.corners_of(triangle)).is_some()
        })
    }

    /// Finds the first triangle that the segment crosses or touches.
    pub fn first_hit(&self, from: DVec3, to: DVec3) -> Option<SegmentHit> {
        let direction = to - from;
        let mut best: Option<(f64, u32)> = None;
        let mut piece = 0.0;
        self.find_along(from, to, |triangle, until| {
            // A hit on the pieces before is nearer than all that is found on this one.
            if until > piece && best.is_some_and(|b| b.0 <= piece) {
                return true;
            }
            piece = until;
            if let Some(along) = crossing(from, direction, self.corners_of(triangle))
                && best.is_none_or(|b| (along, triangle) < b)
            {
                best = Some((along, triangle));
            }
            false
        });
        best.map(|(along, triangle)| {
            let point = from + direction * along;
            SegmentHit {
                along,
                point,
                triangle,
                vertex: corner_near(self.positions, self.triangles[triangle as usize], point),
            }
        })
    }

    fn corners_of(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Shows `is_found` the triangles near a segment, piece after piece, with how far along the piece ends.
    #[inline]
    fn find_along(&self, from: DVec3, to: DVec3, mut is_found: impl FnMut(u32, f64) -> bool) -> bool {
        let way = to - from;
        let pieces = (way.abs().max_element() / (STRIDE * self.side)).ceil().clamp(1.0, 1e6);
        // Rounding must not hide a crossing on a face of the box.
        let margin = DVec3::splat(from.abs().max(to.abs()).max_element() * 1e-14);
        let mut a = from;
        for piece in 1..=pieces as u32 {
            let until = f64::from(piece) / pieces;
            let b = if until < 1.0 { from + way * until } else { to };
            let (least, most) = (a.min(b) - margin, a.max(b) + margin);
            if self
                .grid
                .find_overlapping(least, most, |triangle| is_found(triangle, until))
            {
                return true;
            }
            a = b;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::query::TriangleBvh;

    /// Triangles of about one size, in no order.
    fn confetti(count: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut state = 7u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        let mut points = Vec::new();
        for _ in 0..count {
            let middle = DVec3::new(next(), next() * 2.0, next() * 0.5);
            points.extend((0..3).map(|_| middle + 0.1 * DVec3::new(next(), next(), next())));
        }
        let faces = (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        (points, faces)
    }

    #[test]
    fn cells_answer_as_the_tree_does_whatever_their_size_and_the_number_of_threads() {
        let (points, faces) = confetti(600);
        let pool = Pool::new(3).expect("threads");
        let tree = TriangleBvh::build(&points, &faces, &pool);
        for side in [0.004, 0.05, 0.2, 0.35] {
            let cells = TriangleCells::sort(&points, &faces, side, &pool).expect("of one size");
            let alone = TriangleCells::sort(&points, &faces, side, &Pool::new(1).expect("a thread")).expect("as well");
            let mut order = cells.vertices_in_space_order();
            assert_eq!(order, alone.vertices_in_space_order());
            order.sort_unstable();
            assert!(order.into_iter().eq(0..points.len() as u32), "every vertex once");
            let mut seen = [0; 3];
            for k in 0..400 {
                let from = points[k * 37 % points.len()] * 1.2 - DVec3::splat(0.1);
                let to = from.lerp(points[k * 91 % points.len()], 0.3 * (k % 4) as f64);
                let radius = 0.01 * (k % 9) as f64;
                let within = tree.has_triangle_within(from, radius);
                assert_eq!(
                    cells.has_triangle_within(from, radius),
                    within,
                    "{radius} around {from}"
                );
                let first = tree.first_hit(from, to, None);
                assert_eq!(cells.first_hit(from, to), first, "from {from} to {to}");
                let except = first.map(|hit| hit.vertex);
                let crossed = tree.first_hit(from, to, except).is_some();
                assert_eq!(cells.is_crossed(from, to, except), crossed, "from {from} to {to}");
                [within, first.is_some(), crossed]
                    .iter()
                    .zip(&mut seen)
                    .for_each(|(&is, n)| *n += usize::from(is));
            }
            assert!(
                seen.iter().all(|n| (5..395).contains(n)),
                "answers of both kinds: {seen:?}"
            );
        }
    }

    #[test]
    fn triangles_of_too_many_sizes_are_left_to_a_tree() {
        let (mut points, mut faces) = confetti(3000);
        points.iter_mut().for_each(|p| *p *= 1e-4);
        faces.push([0, points.len() as u32, points.len() as u32 + 1]);
        points.extend([DVec3::X, DVec3::Y]);
        let pool = Pool::new(1).expect("a thread");
        assert!(TriangleCells::sort(&points, &faces, 0.01, &pool).is_none());
        assert!(TriangleCells::sort(&points, &faces, f64::NAN, &pool).is_none());
    }
}
