//! The lattice: nodes of a body-centred cubic grid that lie deep enough inside, and the edges between them.
//!
//! Inside soups only the winding number shows what is inside. There space is searched as an octree over grid cells, coarse to fine. A block far from the surface is decided as a whole;
//! only blocks near the surface are split, so the work grows with the surface, not with the box around it.

use crate::graph::parallel::{map, map_along};
use crate::graph::volume::caps::HullFaces;
use crate::graph::volume::lattice_grid::{
    CERTAIN, LatticeGrid, LatticeKey, LatticeNodes, LatticeRow, NONE, RoomQueries, TooFine, directions, key, toward,
};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::{lattice_grid, scan};
use crate::graph::winding::WindingTree;
use crate::query::closest_point::closest_point_on_triangle;
use crate::query::{SurfacePoint, TriangleBvh, corner_near};
use crate::{BoundingBox, Error};
use glam::DVec3;
use rayon::prelude::*;

/// Nodes whose ties are found in one go.
const NODES: usize = 32;

/// What lattice nodes lie inside of.
#[derive(Clone, Copy)]
pub(in crate::graph) struct LatticeBody<'a> {
    /// A closed surface, if there is one.
    pub(in crate::graph) hull: Option<HullFaces<'a>>,
    /// Soups, if there are any.
    pub(in crate::graph) soup: Option<&'a WindingTree<'a>>,
    /// The box around both.
    pub(in crate::graph) bounds: BoundingBox,
}

/// All nodes of `grid` that lie inside `body`, deeper than `depth` below the whole surface. At most `limit` of them, else
/// `Err(TooFine)` inside.
pub(in crate::graph) fn nodes(
    site: &VolumeSite,
    body: LatticeBody,
    grid: &LatticeGrid,
    depth: f64,
    limit: usize,
) -> Result<Result<LatticeNodes, TooFine>, Error> {
    let mut nodes = match body.hull {
        None => LatticeNodes::default(),
        Some(hull) => match scan::nodes(site, hull, grid, depth, limit)? {
            Ok(nodes) => nodes,
            Err(too_fine) => return Ok(Err(too_fine)),
        },
    };
    if let Some(soup) = body.soup {
        match octree_nodes(site, soup, grid, depth, limit)? {
            Ok(more) => nodes = merged(nodes, more),
            Err(too_fine) => return Ok(Err(too_fine)),
        }
    }
    let excess = nodes.keys.len() as f64 / limit.max(1) as f64;
    if excess > 1.0 {
        return Ok(Err(TooFine::by(libm::cbrt(excess))));
    }
    Ok(Ok(nodes))
}

/// Both together, each node once.
fn merged(a: LatticeNodes, b: LatticeNodes) -> LatticeNodes {
    if a.keys.is_empty() {
        return b;
    }
    let mut both = LatticeNodes {
        keys: Vec::with_capacity(a.keys.len() + b.keys.len()),
        clearance: Vec::with_capacity(a.keys.len() + b.keys.len()),
        shallow: a.shallow,
    };
    let mut left = a.keys.into_iter().zip(a.clearance).peekable();
    let mut right = b.keys.into_iter().zip(b.clearance).peekable();
    loop {
        let next = match (left.peek(), right.peek()) {
            (Some(l), Some(r)) if l.0 == r.0 => {
                let one = left.next();
                let other = right.next();
                one.zip(other).map(|(l, r)| (l.0, l.1.max(r.1)))
            }
            (Some(l), Some(r)) if r.0 < l.0 => right.next(),
            (Some(_), _) => left.next(),
            (None, _) => right.next(),
        };
        let Some((key, clearance)) = next else {
            return both;
        };
        both.keys.push(key);
        both.clearance.push(clearance);
    }
}

/// Where an edge of the grid leaves the lattice.
#[derive(Clone, Copy)]
pub(in crate::graph) struct LatticeExit {
    pub(in crate::graph) node: u32,
    /// The place on the surface where the edge goes through it, or the nearest one to where it leaves, and its triangle.
    pub(in crate::graph) point: DVec3,
    pub(in crate::graph) triangle: u32,
    /// The mesh vertex nearest to that place.
    pub(in crate::graph) vertex: u32,
}

/// Edges of the lattice.
pub(in crate::graph) struct LatticeEdges {
    /// For each node its neighbours in the lattice.
    pub(in crate::graph) rows: Vec<LatticeRow>,
    /// Where others leave; each connected part of the lattice has some.
    pub(in crate::graph) exits: Vec<LatticeExit>,
}

/// Joins neighbours that see each other, and finds where edges lead out of the lattice or through the surface.
pub(in crate::graph) fn edges(
    site: &VolumeSite,
    grid: &LatticeGrid,
    nodes: &LatticeNodes,
    valence: u32,
) -> Result<LatticeEdges, Error> {
    let mut rows = lattice_grid::rows(&nodes.keys, valence, site.exec.pool);
    let at = |i: u32| grid.position(nodes.keys[i as usize]);
    // Edges that triangles may cross, each once.
    let doubtful = |i: u32, j: u32| {
        let clear = nodes.clearance[i as usize] + nodes.clearance[j as usize];
        clear * CERTAIN <= at(i).distance(at(j))
    };
    let asked: Vec<[u32; 2]> = site.exec.pool.install(|| {
        let from = (0..rows.len() as u32).into_par_iter().with_min_len(1024);
        let edges = from.flat_map_iter(|i| rows[i as usize].into_iter().map(move |j| [i, j]));
        edges.filter(|&[i, j]| j != NONE && i < j && doubtful(i, j)).collect()
    });
    let blocked = map(&asked, site.budget, |&[i, j]| {
        site.surface.is_way_crossed(at(i), at(j), None)
    })?;
    for (&[i, j], _) in asked.iter().zip(&blocked).filter(|e| *e.1) {
        for (from, to) in [(i, j), (j, i)] {
            let there = rows[from as usize].iter_mut().filter(|n| **n == to);
            there.for_each(|n| *n = NONE);
        }
    }
    let starts: Vec<u32> = (0..rows.len() as u32).step_by(NODES).collect();
    let found = map(&starts, site.budget, |&first| {
        let last = (first + NODES as u32).min(rows.len() as u32);
        let mut found = FoundExits::default();
        let mut hints = [0; 14];
        for i in first..last {
            for d in directions(valence).filter(|&d| rows[i as usize][d] == NONE) {
                let end = toward(nodes.keys[i as usize], d);
                let near = nodes.shallow.find_key(end, &mut hints[d]);
                match left_at(site, grid, nodes, i, end, near) {
                    Some(exit) => found.exits.push(exit),
                    None => found.unmet.push((i, end)),
                }
            }
        }
        found
    })?;
    let mut exits = Vec::with_capacity(found.iter().map(|f| f.exits.len()).sum());
    found.iter().for_each(|f| exits.extend_from_slice(&f.exits));
    let unmet: Vec<(u32, LatticeKey)> = found.into_iter().flat_map(|f| f.unmet).collect();
    if !unmet.is_empty() {
        exits.extend(nearest_exits(site, grid, &unmet)?);
    }
    Ok(LatticeEdges { rows, exits })
}

/// Where edges of some nodes leave, and edges for which no place was found where they do.
#[derive(Default)]
struct FoundExits {
    exits: Vec<LatticeExit>,
    unmet: Vec<(u32, LatticeKey)>,
}

/// Where the edge from a node to the grid's node `end`, which stands at `near` among those near to the surface, leaves the
/// lattice or goes through the surface.
fn left_at(
    site: &VolumeSite,
    grid: &LatticeGrid,
    nodes: &LatticeNodes,
    node: u32,
    end: LatticeKey,
    near: Option<usize>,
) -> Option<LatticeExit> {
    let (p, q) = (grid.position(nodes.keys[node as usize]), grid.position(end));
    let (length, clear) = (p.distance(q), nodes.clearance[node as usize] * CERTAIN);
    let exit = |vertex: u32, point: DVec3, triangle: u32| LatticeExit {
        node,
        point,
        triangle,
        vertex: site.walk(vertex, point),
    };
    // No triangle reaches into the clear balls around both ends. Where they overlap none is crossed; else the way to look at
    // begins where the first one ends.
    let joined = near.is_some_and(|k| clear + nodes.shallow.squares[k].sqrt() * CERTAIN > length);
    if !joined {
        let start = p + (q - p) * (clear / length).min(1.0);
        if let Some(hit) = site.surface.first_hit(start, q) {
            return Some(exit(hit.vertex, hit.point, hit.triangle));
        }
    }
    let triangle = nodes.shallow.triangles[near?];
    let face = site.mesh.triangles[triangle as usize];
    let corners = face.map(|v| site.mesh.positions[v as usize]);
    let vertex = corner_near(&site.mesh.positions, face, q);
    Some(exit(vertex, closest_point_on_triangle(q, corners), triangle))
}

/// Exits of edges that leave the lattice for a place of which nothing is known: at the point of the surface nearest to it.
fn nearest_exits(
    site: &VolumeSite,
    grid: &LatticeGrid,
    unmet: &[(u32, LatticeKey)],
) -> Result<Vec<LatticeExit>, Error> {
    // Several edges lead to the same place; its nearest point is looked up once.
    let mut ends: Vec<LatticeKey> = unmet.iter().map(|e| e.1).collect();
    site.exec.pool.install(|| ends.par_sort_unstable());
    ends.dedup();
    let surface = site.surface.tree().bvh();
    let nearest = map_along(&ends, site.budget, |&end, before: Option<&Option<SurfacePoint>>| {
        let p = grid.position(end);
        let within = before
            .copied()
            .flatten()
            .map_or(f64::INFINITY, |b| b.point.distance(p) * (1.0 + 1e-9));
        surface.closest_point_within(p, within)
    })?;
    let exit = |&(node, end): &(u32, LatticeKey)| {
        let near = ends.binary_search(&end).ok().and_then(|at| nearest[at])?;
        Some(LatticeExit {
            node,
            point: near.point,
            triangle: near.triangle,
            vertex: site.walk(near.vertex, near.point),
        })
    };
    Ok(unmet.iter().filter_map(exit).collect())
}

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
pub(in crate::graph) fn octree_nodes(
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
