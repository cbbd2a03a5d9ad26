//! The lattice: nodes of a body-centred cubic grid that lie deep enough inside, and the edges between them.
//!
//! Space is searched as an octree over grid cells, coarse to fine. A block far from the surface is decided as a whole;
//! only blocks near the surface are split, so the work grows with the surface, not with the box around it.

use super::Error;
use super::neighbours::{Key, LAST, directions, key, pairs, place, toward};
use super::parallel::{map, map_along};
use super::shell::Site;
use super::winding::Nearest;
use crate::mesh::{Bounds, Components};
use glam::DVec3;
use rayon::prelude::*;

/// Two balls without triangles join when they overlap; balls that touch at the surface from both sides must not be
/// taken to overlap for a rounding error.
const CERTAIN: f64 = 1.0 - 1e-9;

/// A body-centred cubic grid around a box.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// Place of A's node (0, 0, 0); nodes are numbered from 1.
    origin: DVec3,
    /// Side of a cell.
    pub(super) interval: f64,
    /// Cells along each axis.
    cells: [u32; 3],
}

/// Nodes found inside, in rising order of their keys.
#[derive(Debug, Default)]
pub(super) struct Nodes {
    pub(super) keys: Vec<Key>,
    /// For each node a length: no triangle is nearer.
    pub(super) clearance: Vec<f64>,
}

/// More blocks or nodes than allowed; the interval must grow.
pub(super) struct TooFine {
    /// By at least about this factor.
    pub(super) factor: f64,
}

impl TooFine {
    fn by(factor: f64) -> Self {
        Self {
            factor: factor.max(1.05),
        }
    }
}

/// A cube of 2^level cells a side.
#[derive(Debug, Clone, Copy)]
struct Block {
    at: [u32; 3],
    level: u32,
    /// Known to be inside as a whole.
    inside: bool,
}

/// What is known of a block.
enum Verdict {
    /// No node of it is both inside and deep enough.
    Drop,
    /// All nodes of it are inside; none is nearer to the surface than this.
    Keep(f64),
    /// Its halves must be asked; whether it is inside as a whole.
    Split(bool),
    /// One cell: the clearance of its nodes in A and B, where deep enough, and whether they are known to be inside.
    Cell([Option<(f64, bool)>; 2]),
}

/// A node that is deep enough, and whether it is known to be inside.
#[derive(Clone, Copy)]
struct Candidate {
    key: Key,
    clearance: f64,
    inside: bool,
}

impl Grid {
    /// A grid with one of its nodes in the middle of `bounds`, so that a symmetric shape gets a symmetric lattice.
    /// `None` when it would have more cells along an axis than can be numbered.
    pub(super) fn around(bounds: &Bounds, interval: f64) -> Option<Self> {
        let half = (bounds.size() * 0.5 / interval).ceil();
        if !half.is_finite() || half.max_element() >= f64::from(LAST / 2 - 2) {
            return None;
        }
        let cells = half.to_array().map(|h| 2 * h as u32 + 1);
        let origin = bounds.center() - (half + DVec3::ONE) * interval;
        Some(Self {
            origin,
            interval,
            cells,
        })
    }

    pub(super) fn position(&self, key: Key) -> DVec3 {
        self.origin + place(key) * self.interval
    }
}

/// All nodes of `grid` that lie inside, deeper than `depth`. At most `limit` of them, else `Err(TooFine)` inside.
pub(super) fn nodes(site: &Site, grid: &Grid, depth: f64, limit: usize) -> Result<Result<Nodes, TooFine>, Error> {
    // At an interval of one edge length about seven blocks a vertex lie at the surface.
    let budget = 16 * site.mesh.positions.len() + limit / 8 + (1 << 16);
    let level = grid
        .cells
        .iter()
        .max()
        .map_or(0, |c| c.next_power_of_two().trailing_zeros());
    let mut front = vec![Block {
        at: [1; 3],
        level,
        inside: false,
    }];
    let mut found: Vec<Candidate> = Vec::new();
    while !front.is_empty() {
        let verdicts = map(&front, site.pool, site.progress, |b| judge(site, grid, depth, b))?;
        // Count before anything is stored.
        let (mut splits, mut sure, mut maybe) = (0usize, 0usize, 0usize);
        for (block, verdict) in front.iter().zip(&verdicts) {
            match verdict {
                Verdict::Drop => {}
                Verdict::Keep(_) => sure = sure.saturating_add(count_in(grid, block)),
                Verdict::Split(_) => splits += 1,
                Verdict::Cell(two) => maybe += two.iter().flatten().count(),
            }
        }
        let nodes = found.iter().filter(|c| c.inside).count().saturating_add(sure);
        if nodes > limit {
            return Ok(Err(TooFine::by(libm::cbrt(nodes as f64 / limit.max(1) as f64))));
        }
        if splits * 8 > budget || found.len() + maybe > budget.saturating_add(limit) {
            // Blocks at the surface grow fourfold with each level that is left.
            let finest = (splits * 8).max(found.len() + maybe) as f64 * 4f64.powi(front[0].level as i32 - 1);
            return Ok(Err(TooFine::by((finest / budget as f64).sqrt())));
        }
        let mut next = Vec::with_capacity(splits * 8);
        for (block, verdict) in front.iter().zip(verdicts) {
            match verdict {
                Verdict::Drop => {}
                Verdict::Keep(clearance) => keep_all(grid, block, clearance, &mut found),
                Verdict::Split(inside) => split(grid, block, inside, &mut next),
                Verdict::Cell(two) => {
                    for (in_b, node) in [false, true].into_iter().zip(two) {
                        if let Some((clearance, inside)) = node {
                            found.push(Candidate {
                                key: key(block.at, in_b),
                                clearance,
                                inside,
                            });
                        }
                    }
                }
            }
        }
        front = next;
    }
    site.pool.install(|| found.par_sort_unstable_by_key(|c| c.key));
    let nodes = only_inside(site, grid, found)?;
    if nodes.keys.len() > limit {
        let excess = nodes.keys.len() as f64 / limit.max(1) as f64;
        return Ok(Err(TooFine::by(libm::cbrt(excess))));
    }
    Ok(Ok(nodes))
}

fn judge(site: &Site, grid: &Grid, depth: f64, block: &Block) -> Verdict {
    let low = grid.position(key(block.at, false));
    if block.level == 0 {
        let reach = grid.interval.max(depth * 1.001);
        return Verdict::Cell([0.0, 0.5].map(|shift| {
            let p = low + DVec3::splat(shift * grid.interval);
            let clearance = site
                .surface
                .closest_within(p, reach)
                .map_or(reach, |near| near.distance);
            // On a balanced surface neighbours may know; otherwise each node asks for itself.
            let ask = !block.inside && !site.balanced;
            (clearance > depth && (!ask || site.solid.contains(p))).then_some((clearance, block.inside || ask))
        }));
    }
    // The nodes of n cells span n − ½ intervals.
    let half = (f64::from(1u32 << block.level) - 0.5) * 0.5 * grid.interval;
    let (center, radius) = (low + DVec3::splat(half), half * 3f64.sqrt());
    let share = if site.balanced { 1.0 } else { 4.0 };
    let reach = (radius * share + depth.max(0.501 * grid.interval)) * 1.001;
    let clearance = site
        .surface
        .closest_within(center, reach)
        .map_or(reach, |near| near.distance);
    if clearance + radius <= depth {
        return Verdict::Drop;
    }
    let mut inside = block.inside;
    if !inside && clearance > radius * share {
        let winding = site.solid.at(center).abs();
        // A winding number is a harmonic function off the surface. On a balanced surface it is constant in a ball
        // without triangles; otherwise Harnack's inequality bounds it in a ball of a quarter of the radius by 0.45
        // to 2.23 times its value, and likewise its distance from 1.
        if site.balanced || !(0.22..=0.78).contains(&winding) {
            if winding > 0.5 {
                inside = true;
            } else {
                return Verdict::Drop;
            }
        }
    }
    // Clear by half an interval, no edge of its nodes needs to be tested against triangles.
    if inside && clearance - radius > depth.max(0.501 * grid.interval) {
        Verdict::Keep(clearance - radius)
    } else {
        Verdict::Split(inside)
    }
}

/// Cells of the block that belong to the grid, along each axis.
fn extent(grid: &Grid, block: &Block) -> [u32; 3] {
    std::array::from_fn(|axis| (1u32 << block.level).min((grid.cells[axis] + 1).saturating_sub(block.at[axis])))
}

fn count_in(grid: &Grid, block: &Block) -> usize {
    extent(grid, block)
        .iter()
        .fold(2usize, |n, &e| n.saturating_mul(e as usize))
}

fn keep_all(grid: &Grid, block: &Block, clearance: f64, found: &mut Vec<Candidate>) {
    let [nx, ny, nz] = extent(grid, block);
    let [x, y, z] = block.at;
    for k in z..z + nz {
        for j in y..y + ny {
            for i in x..x + nx {
                for in_b in [false, true] {
                    found.push(Candidate {
                        key: key([i, j, k], in_b),
                        clearance,
                        inside: true,
                    });
                }
            }
        }
    }
}

fn split(grid: &Grid, block: &Block, inside: bool, next: &mut Vec<Block>) {
    let side = 1u32 << (block.level - 1);
    for octant in 0..8u32 {
        let at: [u32; 3] = std::array::from_fn(|axis| block.at[axis] + (octant >> axis & 1) * side);
        if (0..3).all(|axis| at[axis] <= grid.cells[axis]) {
            next.push(Block {
                at,
                level: block.level - 1,
                inside,
            });
        }
    }
}

/// Leaves out candidates that lie outside. Neighbours whose clear balls overlap lie on one side of a balanced surface,
/// so one member of each set of such neighbours is asked, and none where a member is known.
fn only_inside(site: &Site, grid: &Grid, found: Vec<Candidate>) -> Result<Nodes, Error> {
    let mut inside: Vec<bool> = found.iter().map(|c| c.inside).collect();
    if inside.contains(&false) {
        let keys: Vec<Key> = found.iter().map(|c| c.key).collect();
        let (near, _) = pairs(&keys, 14);
        let overlap = |[a, b]: [u32; 2]| {
            let (a, b) = (&found[a as usize], &found[b as usize]);
            place(a.key).distance(place(b.key)) * grid.interval < (a.clearance + b.clearance) * CERTAIN
        };
        let sets = Components::of_edges(
            found.len(),
            near.into_iter().filter(|&p| overlap(p)).map(|[a, b]| (a, b)),
        );
        let mut known = vec![false; sets.count];
        sets.of_vertex
            .iter()
            .zip(&inside)
            .for_each(|(&s, &i)| known[s as usize] |= i);
        let asked: Vec<(u32, bool)> = sets.first_vertices().into_iter().zip(known).collect();
        let answers = map(&asked, site.pool, site.progress, |&(first, known)| {
            known || site.solid.contains(grid.position(keys[first as usize]))
        })?;
        inside = sets.of_vertex.iter().map(|&s| answers[s as usize]).collect();
    }
    let kept = found.iter().zip(&inside).filter(|f| *f.1).map(|f| f.0);
    let count = inside.iter().filter(|&&i| i).count();
    let mut nodes = Nodes {
        keys: Vec::with_capacity(count),
        clearance: Vec::with_capacity(count),
    };
    for c in kept {
        nodes.keys.push(c.key);
        nodes.clearance.push(c.clearance);
    }
    Ok(nodes)
}

/// Edges of the lattice.
pub(super) struct Edges {
    /// Pairs of lattice nodes.
    pub(super) lattice: Vec<[u32; 2]>,
    /// Lattice node and the mesh vertex whose shell copy it is tied to. Each connected part of the lattice has some.
    pub(super) ties: Vec<[u32; 2]>,
}

/// Joins neighbours that see each other. Where a lattice edge leads out of the lattice or through the surface, the node
/// is tied to the vertex nearest to the place where the edge leaves.
pub(super) fn edges(site: &Site, grid: &Grid, nodes: &Nodes, valence: u32) -> Result<Edges, Error> {
    let (near, present) = pairs(&nodes.keys, valence);
    let at = |i: u32| grid.position(nodes.keys[i as usize]);
    let blocked = map(&near, site.pool, site.progress, |&[a, b]| {
        let (p, q) = (at(a), at(b));
        let clear = nodes.clearance[a as usize] + nodes.clearance[b as usize];
        clear * CERTAIN <= p.distance(q) && site.surface.first_hit(p, q, None).is_some()
    })?;
    let mut leaving: Vec<(u32, Key)> = Vec::new();
    for (i, &present) in (0u32..).zip(&present) {
        let missing = directions(valence).filter(|d| present >> d & 1 == 0);
        leaving.extend(missing.map(|d| (i, toward(nodes.keys[i as usize], d))));
    }
    for (&[a, b], _) in near.iter().zip(&blocked).filter(|e| *e.1) {
        leaving.extend([(a, nodes.keys[b as usize]), (b, nodes.keys[a as usize])]);
    }
    // Several edges lead to the same place outside; its nearest point is looked up once.
    let mut ends: Vec<Key> = leaving.iter().map(|l| l.1).collect();
    ends.sort_unstable();
    ends.dedup();
    let nearest = map_along(
        &ends,
        site.pool,
        site.progress,
        |&end, before: Option<&Option<Nearest>>| {
            let p = grid.position(end);
            let within = before
                .copied()
                .flatten()
                .map_or(f64::INFINITY, |b| b.point.distance(p) * (1.0 + 1e-9));
            site.surface.closest_within(p, within)
        },
    )?;
    let vertices = map(&leaving, site.pool, site.progress, |&(i, end)| {
        let near = ends.binary_search(&end).ok().and_then(|at| nearest[at])?;
        let (p, q) = (at(i), grid.position(end));
        let clear = (nodes.clearance[i as usize] + near.distance) * CERTAIN > p.distance(q);
        let hit = if clear {
            None
        } else {
            site.surface.first_hit(p, q, None)
        };
        Some(hit.map_or(near.vertex, |hit| hit.vertex))
    })?;
    let mut ties: Vec<[u32; 2]> = leaving
        .iter()
        .zip(vertices)
        .filter_map(|(&(i, _), v)| Some([i, v?]))
        .collect();
    ties.sort_unstable();
    ties.dedup();
    let mut blocked = blocked.into_iter();
    let lattice = near.into_iter().filter(|_| blocked.next() == Some(false)).collect();
    Ok(Edges { lattice, ties })
}
