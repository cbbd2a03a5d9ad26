//! Nodes of a grid inside soups, where only the winding number shows what is inside.
//!
//! Space is searched as an octree over grid cells, coarse to fine. A block far from the surface is decided as a whole;
//! only blocks near the surface are split, so the work grows with the surface, not with the box around it.

use crate::graph::error::Error;
use crate::graph::parallel::map;
use crate::graph::volume::lattice_grid::{LatticeGrid, LatticeNodes, TooFine};
use crate::graph::volume::neighbours::{LatticeKey, key};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::winding::tree::WindingTree;
use crate::mesh::BoundingBox;
use crate::mesh::query::TriangleBvh;
use glam::DVec3;
use rayon::prelude::*;

/// A cube of 2^level cells a side.
#[derive(Debug, Clone, Copy)]
struct OctreeBlock {
    at: [u32; 3],
    level: u32,
    /// Known to be inside as a whole.
    inside: bool,
}

/// What is known of a block.
enum BlockVerdict {
    /// No node of it is both inside and deep enough.
    Drop,
    /// All nodes of it are inside; none is nearer to the surface than this.
    Keep(f64),
    /// Its halves must be asked; whether it is inside as a whole.
    Split(bool),
    /// One cell: the clearance of its nodes in A and B, where they are inside and deep enough.
    Cell([Option<f64>; 2]),
}

/// What is searched for.
struct OctreeSearch<'a> {
    surface: &'a TriangleBvh<'a>,
    soup: &'a WindingTree<'a>,
    /// The box around the soups; they enclose nothing beyond it.
    bounds: BoundingBox,
    grid: &'a LatticeGrid,
    depth: f64,
}

/// All nodes of `grid` that lie inside soups, deeper than `depth`. `Err(TooFine)` inside when there is too much to
/// look at, or when there are more than about `limit` nodes.
pub(in crate::graph) fn nodes(
    site: &VolumeSite,
    soup: &WindingTree,
    grid: &LatticeGrid,
    depth: f64,
    limit: usize,
) -> Result<Result<LatticeNodes, TooFine>, Error> {
    let corners = soup.bvh().triangles().iter().flatten();
    let points: Vec<DVec3> = corners.map(|&v| site.mesh.positions[v as usize]).collect();
    let search = OctreeSearch {
        surface: site.surface.tree().bvh(),
        soup,
        bounds: BoundingBox::of(&points),
        grid,
        depth,
    };
    // At an interval of one edge length about seven blocks a vertex lie at the surface.
    let budget = 16 * points.len() / 3 + limit / 8 + (1 << 16);
    let level = grid
        .cells
        .iter()
        .max()
        .map_or(0, |c| c.next_power_of_two().trailing_zeros());
    let mut front = vec![OctreeBlock {
        at: [1; 3],
        level,
        inside: false,
    }];
    let mut found: Vec<(LatticeKey, f64)> = Vec::new();
    while !front.is_empty() {
        let verdicts = map(&front, site.budget, |b| search.judge(b))?;
        // Count before anything is stored.
        let (mut splits, mut kept) = (0usize, found.len());
        for (block, verdict) in front.iter().zip(&verdicts) {
            match verdict {
                BlockVerdict::Drop => {}
                BlockVerdict::Keep(_) => kept = kept.saturating_add(count_in(grid, block)),
                BlockVerdict::Split(_) => splits += 1,
                BlockVerdict::Cell(two) => kept += two.iter().flatten().count(),
            }
        }
        if kept > limit {
            return Ok(Err(TooFine::by(libm::cbrt(kept as f64 / limit.max(1) as f64))));
        }
        if splits * 8 > budget {
            // Blocks at the surface grow fourfold with each level that is left.
            let finest = (splits * 8) as f64 * 4f64.powi(front[0].level as i32 - 1);
            return Ok(Err(TooFine::by((finest / budget as f64).sqrt())));
        }
        let mut next = Vec::with_capacity(splits * 8);
        for (block, verdict) in front.iter().zip(verdicts) {
            match verdict {
                BlockVerdict::Drop => {}
                BlockVerdict::Keep(clearance) => keep_all(grid, block, clearance, &mut found),
                BlockVerdict::Split(inside) => split(grid, block, inside, &mut next),
                BlockVerdict::Cell(two) => {
                    let both = [false, true].into_iter().zip(two);
                    found.extend(both.filter_map(|(in_b, node)| Some((key(block.at, in_b), node?))));
                }
            }
        }
        front = next;
    }
    site.exec.pool.install(|| found.par_sort_unstable_by_key(|c| c.0));
    let (keys, clearance) = found.into_iter().unzip();
    Ok(Ok(LatticeNodes {
        keys,
        clearance,
        ..LatticeNodes::default()
    }))
}

impl OctreeSearch<'_> {
    fn judge(&self, block: &OctreeBlock) -> BlockVerdict {
        let Self { grid, depth, .. } = self;
        let low = grid.position(key(block.at, false));
        // The nodes of n cells span n − ½ intervals.
        let span = (f64::from(1u32 << block.level) - 0.5) * grid.interval;
        let high = low + DVec3::splat(span);
        if low.cmpgt(self.bounds.max).any() || high.cmplt(self.bounds.min).any() {
            return BlockVerdict::Drop;
        }
        let clear = |p: DVec3, reach: f64| {
            let near = self.surface.closest_point_within(p, reach);
            near.map_or(reach, |near| near.distance)
        };
        if block.level == 0 {
            let reach = grid.interval.max(depth * 1.001);
            return BlockVerdict::Cell([0.0, 0.5].map(|shift| {
                let p = low + DVec3::splat(shift * grid.interval);
                let clearance = clear(p, reach);
                (clearance > *depth && (block.inside || self.soup.contains(p))).then_some(clearance)
            }));
        }
        let (center, radius) = (low + DVec3::splat(span * 0.5), span * 0.5 * 3f64.sqrt());
        let reach = (radius * 4.0 + depth.max(0.501 * grid.interval)) * 1.001;
        let clearance = clear(center, reach);
        if clearance + radius <= *depth {
            return BlockVerdict::Drop;
        }
        let mut inside = block.inside;
        if !inside && clearance > radius * 4.0 {
            let winding = self.soup.winding_number(center).abs();
            // A winding number is a harmonic function off the surface. Harnack's inequality bounds it in a ball of a
            // quarter of the clear radius by 0.45 to 2.23 times its value, and likewise its distance from 1.
            if !(0.22..=0.78).contains(&winding) {
                if winding > 0.5 {
                    inside = true;
                } else {
                    return BlockVerdict::Drop;
                }
            }
        }
        // Clear by half an interval, no edge of its nodes needs to be tested against triangles.
        if inside && clearance - radius > depth.max(0.501 * grid.interval) {
            BlockVerdict::Keep(clearance - radius)
        } else {
            BlockVerdict::Split(inside)
        }
    }
}

/// Cells of the block that belong to the grid, along each axis.
fn extent(grid: &LatticeGrid, block: &OctreeBlock) -> [u32; 3] {
    std::array::from_fn(|axis| (1u32 << block.level).min((grid.cells[axis] + 1).saturating_sub(block.at[axis])))
}

fn count_in(grid: &LatticeGrid, block: &OctreeBlock) -> usize {
    extent(grid, block)
        .iter()
        .fold(2usize, |n, &e| n.saturating_mul(e as usize))
}

fn keep_all(grid: &LatticeGrid, block: &OctreeBlock, clearance: f64, found: &mut Vec<(LatticeKey, f64)>) {
    let [nx, ny, nz] = extent(grid, block);
    let [x, y, z] = block.at;
    for k in z..z + nz {
        for j in y..y + ny {
            for i in x..x + nx {
                found.extend([false, true].map(|in_b| (key([i, j, k], in_b), clearance)));
            }
        }
    }
}

fn split(grid: &LatticeGrid, block: &OctreeBlock, inside: bool, next: &mut Vec<OctreeBlock>) {
    let side = 1u32 << (block.level - 1);
    for octant in 0..8u32 {
        let at: [u32; 3] = std::array::from_fn(|axis| block.at[axis] + (octant >> axis & 1) * side);
        if (0..3).all(|axis| at[axis] <= grid.cells[axis]) {
            next.push(OctreeBlock {
                at,
                level: block.level - 1,
                inside,
            });
        }
    }
}
