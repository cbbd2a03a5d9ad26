//! The balance of all bones' pulls: one system, a column for each bone.
//!
//! Cells of a cubic lattice that a mesh occupies, all its parts together.

use super::HeaviestWeights;
use super::even_jumps::even_jumps;
use crate::skeleton::BoneInfluences;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::graph::WindingTree;
use pliant_mesh::query::closest_point::closest_point_on_segment;
use pliant_solver::{
    BuildOptions, Constraints, Hierarchy, InitialGuess, SolveControl, SolveOptions, WeightedGraph, Workspace,
};
use rayon::prelude::*;

/// How a mesh is bound to bones.
#[derive(Debug, Clone, PartialEq)]
pub struct SkinWeightOptions {
    /// Bones that a vertex follows at most, 1 to 8.
    pub influences: usize,
    /// Cells of the box around the mesh at most; more follow thinner limbs and take longer.
    pub cells: usize,
    /// c: how strongly a cell is pulled to its nearest bone. More is crisper.
    pub stiffness: f64,
}

impl Default for SkinWeightOptions {
    fn default() -> Self {
        Self {
            influences: 4,
            cells: 1 << 20,
            stiffness: 0.5,
        }
    }
}

/// A bone that vertices can follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinBone {
    /// Where it begins and where it ends, in model space; the same point twice for a bone without length.
    pub ends: [DVec3; 2],
    /// Number of the bone that it hangs on, lower than its own; `None` for a root.
    pub parent: Option<usize>,
}

/// Why a mesh cannot be bound to bones.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SkinWeightError {
    /// Something given is not what it may be.
    #[error("{what}: {problem}")]
    Invalid {
        /// What.
        what: String,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// The caller cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The system of the lattice cannot be solved.
    #[error("the weights cannot be solved for: {0}")]
    Solver(pliant_solver::Error),
}

impl From<pliant_solver::Error> for SkinWeightError {
    fn from(e: pliant_solver::Error) -> Self {
        match e {
            pliant_solver::Error::Cancelled => Self::Cancelled(Cancelled),
            other => Self::Solver(other),
        }
    }
}

/// The most bones.
const MOST_BONES: usize = 4096;
/// Columns that are solved together: memory grows with them, not with the number of bones.
const COLUMNS: usize = 32;
/// Relative residual of a column. What is left is far below what a weight shows.
const TOLERANCE: f64 = 1e-5;
/// Rounds of smoothing where more bones pull than a vertex follows.
const ROUNDS: usize = 64;
/// From what share of all weight on that is left out a cell takes part in it fully.
const LOOSE: f64 = 0.01;
/// No pull is stronger than from this distance to a bone, in cells.
const NEAREST: f64 = 0.5;
/// Bones whose distances differ by less than this share are equally near and share the pull: those that meet in a joint.
const EQUAL: f64 = 1e-6;
/// Bones that share one pull at most, the first of them: more at one place are no joint, and each cell would list them all.
const SHARING: usize = 32;
/// Cells that one thread takes in a row.
const RUN: usize = 256;
/// Cells with something of the mesh in them at most, about: what fills its box needs fewer than what is thin.
const OCCUPIED: usize = 1 << 17;
/// Cells in which the share of its box that a mesh fills is counted.
const FEW_CELLS: usize = 1 << 15;

/// Weights of all vertices for bones that run from one point to another. Each vertex follows at least one bone.
///
/// ```
/// use glam::DVec3;
/// use pliant_exec::{Exec, pool::Pool, progress::Silent};
/// use pliant_motion::skin_weights::{SkinBone, SkinWeightOptions, skin_weights};
///
/// let strip: Vec<DVec3> = (0..9).map(|k| DVec3::new(f64::from(k), 0.0, 0.0)).collect();
/// let bones = [
///     SkinBone { ends: [DVec3::ZERO, DVec3::X * 4.0], parent: None },
///     SkinBone { ends: [DVec3::X * 4.0, DVec3::X * 8.0], parent: Some(0) },
/// ];
/// let pool = Pool::new(1)?;
/// let found = skin_weights(&strip, &[], &bones, &SkinWeightOptions::default(), &Exec::new(&pool, &Silent))?;
/// assert!(found[0].bones[0] == 0 && found[8].bones[0] == 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`SkinWeightError`] for no vertex or bone or too many bones, numbers that are not finite or not in their range, a triangle
/// of vertices that do not exist, and when the caller cancels.
pub fn skin_weights(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    bones: &[SkinBone],
    options: &SkinWeightOptions,
    exec: &Exec<'_>,
) -> Result<Vec<BoneInfluences>, SkinWeightError> {
    check(positions, triangles, bones, options)?;
    let cells = bound_cells(positions, triangles, options.cells, exec)?;
    let pulls = pulls(&cells, bones, options.stiffness, exec)?;
    let (offsets, neighbours) = cells.rows();
    let nodes = cells.places.len();
    let points: Vec<[f64; 3]> = cells.places.iter().map(DVec3::to_array).collect();
    let graph = WeightedGraph {
        offsets: &offsets,
        neighbours: &neighbours,
        weights: None,
        positions: Some(&points),
    };
    let hierarchy = Hierarchy::build(&graph, &BuildOptions::default(), exec)?;
    let stiffness: Vec<f64> = pulls.iter().map(|p| p.stiffness).collect();
    let fixed = vec![false; nodes];
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: Some(&stiffness),
    };
    let system = hierarchy.constrain(&constraints, exec.pool)?;
    let mut heaviest = vec![HeaviestWeights::default(); nodes];
    let mut workspace = Workspace::default();
    let all: Vec<usize> = (0..bones.len()).collect();
    for group in all.chunks(COLUMNS) {
        exec.check()?;
        let columns = group.len();
        let own = group[0]..group[0] + columns;
        let mut rhs = vec![0.0; nodes * columns];
        for (row, pull) in rhs.chunks_mut(columns).zip(&pulls) {
            for bone in pull.bones.iter().filter(|b| own.contains(*b)) {
                row[bone - group[0]] = pull.stiffness / pull.bones.len() as f64;
            }
        }
        let mut x = vec![0.0; nodes * columns];
        let solve = SolveOptions {
            start: InitialGuess::FullMultigrid {
                frames: None,
                rest: None,
            },
            tolerance: Some(TOLERANCE),
            ..SolveOptions::default()
        };
        let equations = system.equations(&hierarchy, columns, &rhs);
        equations.solve(&mut x, &solve, &mut workspace, exec, &mut |_| SolveControl::Continue)?;
        exec.pool.install(|| {
            let runs = heaviest.par_chunks_mut(RUN).zip(x.par_chunks(RUN * columns));
            runs.try_for_each(|(heaviest, rows)| {
                exec.check()?;
                for (heaviest, row) in heaviest.iter_mut().zip(rows.chunks(columns)) {
                    let weights = group.iter().zip(row);
                    weights.for_each(|(bone, weight)| heaviest.add(*bone as u16, *weight));
                }
                Ok::<(), Cancelled>(())
            })
        })?;
    }
    let cut = WeightCut {
        most: options.influences,
        parents: bones.iter().map(|b| b.parent).collect(),
        bones,
    };
    exec.pool.install(|| {
        let of_cells = cut.smoothed(&cells, &offsets, &neighbours, &heaviest, exec)?;
        let all = positions.par_iter().with_min_len(RUN);
        let found = all.map(|p| {
            exec.check()?;
            let (around, count) = cells.around_point(*p);
            let parts = around[..count].iter().map(|(node, w)| (&of_cells[*node as usize], *w));
            Ok(cut.few(&HeaviestWeights::of_mixture(parts), *p))
        });
        let mut found: Vec<BoneInfluences> = found.collect::<Result<_, Cancelled>>()?;
        even_jumps(
            positions,
            triangles,
            |heaviest, p| cut.few(heaviest, p),
            &mut found,
            exec,
        )?;
        Ok(found)
    })
}

/// The cells of a mesh, among `most` or fewer.
fn bound_cells(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    most: usize,
    exec: &Exec<'_>,
) -> Result<OccupiedCells, Cancelled> {
    let few = OccupiedCells::find(positions, triangles, most.min(FEW_CELLS), exec)?;
    let filled = few.places.len() as f64 / few.node.len() as f64;
    OccupiedCells::find(
        positions,
        triangles,
        most.min((OCCUPIED as f64 / filled) as usize),
        exec,
    )
}

/// How many of all weights are kept.
struct WeightCut<'a> {
    most: usize,
    parents: Vec<Option<usize>>,
    bones: &'a [SkinBone],
}

impl WeightCut<'_> {
    /// The few that a point follows. What is far from any weight that the solver left still has its nearest bone.
    fn few(&self, heaviest: &HeaviestWeights, p: DVec3) -> BoneInfluences {
        let few = heaviest.cut(self.most, &self.parents);
        few.unwrap_or_else(|| BoneInfluences::one(nearest(self.bones, p).0 as u16))
    }

    /// The few of each cell, smoothed where something was taken from them: what is left of the weights there passes in less
    /// space from bone to bone than all of them do, and a mean with the cells around that is cut again spreads it.
    fn smoothed(
        &self,
        cells: &OccupiedCells,
        offsets: &[u32],
        neighbours: &[u32],
        heaviest: &[HeaviestWeights],
        exec: &Exec<'_>,
    ) -> Result<Vec<BoneInfluences>, SkinWeightError> {
        let taken = heaviest.iter().map(|h| h.share_cut(self.most));
        let loose: Vec<f64> = taken.map(|taken| (taken / LOOSE).min(1.0)).collect();
        let all = heaviest.par_iter().zip(&cells.places).with_min_len(RUN);
        let few = all.map(|(heaviest, p)| {
            exec.check()?;
            Ok(self.few(heaviest, *p))
        });
        let mut of_cells: Vec<BoneInfluences> = few.collect::<Result<_, Cancelled>>()?;
        if loose.iter().all(|l| *l == 0.0) {
            return Ok(of_cells);
        }
        for _ in 0..ROUNDS {
            let all = (0..of_cells.len()).into_par_iter().with_min_len(RUN);
            of_cells = all
                .map(|node| {
                    exec.check()?;
                    let around = &neighbours[offsets[node] as usize..offsets[node + 1] as usize];
                    if loose[node] == 0.0 {
                        return Ok(of_cells[node]);
                    }
                    let share = loose[node] / (around.len() as f64 + 1.0);
                    let own = 1.0 - share * around.len() as f64;
                    let parts = around.iter().map(|n| (&of_cells[*n as usize], share));
                    let mixed = HeaviestWeights::of_mixture(parts.chain([(&of_cells[node], own)]));
                    Ok(self.few(&mixed, cells.places[node]))
                })
                .collect::<Result<_, Cancelled>>()?;
        }
        Ok(of_cells)
    }
}

/// To which bones a cell is pulled, and how strongly.
struct CellPull {
    bones: Vec<usize>,
    stiffness: f64,
}

fn pulls(
    cells: &OccupiedCells,
    bones: &[SkinBone],
    stiffness: f64,
    exec: &Exec<'_>,
) -> Result<Vec<CellPull>, Cancelled> {
    exec.pool.install(|| {
        let all = cells.places.par_iter().with_min_len(RUN);
        let found = all.map(|p| {
            // All bones are looked at for each cell.
            exec.check()?;
            let (_, square) = nearest(bones, *p);
            let reach = square * (1.0 + EQUAL) * (1.0 + EQUAL) + EQUAL * EQUAL * cells.side * cells.side;
            let near = (0..bones.len()).filter(|b| distance_squared(&bones[*b], *p) <= reach);
            let d = square / (cells.side * cells.side);
            Ok(CellPull {
                bones: near.take(SHARING).collect(),
                stiffness: stiffness / d.max(NEAREST * NEAREST),
            })
        });
        found.collect()
    })
}

fn distance_squared(bone: &SkinBone, p: DVec3) -> f64 {
    let [from, to] = bone.ends;
    closest_point_on_segment(p, from, to).distance_squared(p)
}

/// The bone nearest to a point, and its squared distance.
fn nearest(bones: &[SkinBone], p: DVec3) -> (usize, f64) {
    let mut best = (0, f64::INFINITY);
    for (bone, own) in bones.iter().enumerate() {
        let square = distance_squared(own, p);
        if square < best.1 {
            best = (bone, square);
        }
    }
    best
}

fn check(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    bones: &[SkinBone],
    options: &SkinWeightOptions,
) -> Result<(), SkinWeightError> {
    let refuse = |what: &str, problem: String| {
        let what = what.into();
        Err(SkinWeightError::Invalid { what, problem })
    };
    if positions.is_empty() {
        return refuse("the mesh", "has no vertex, at least one is needed".into());
    }
    if let Some(at) = positions.iter().position(|p| !p.is_finite()) {
        return refuse(&format!("vertex {at}"), "is not a point of finite numbers".into());
    }
    let missing = |t: &[u32; 3]| t.iter().any(|v| *v as usize >= positions.len());
    if let Some(at) = triangles.iter().position(missing) {
        let problem = format!("names a vertex that is not there, there are {}", positions.len());
        return refuse(&format!("triangle {at}"), problem);
    }
    if bones.is_empty() || bones.len() > MOST_BONES {
        return refuse("bones", format!("are {}, allowed are 1 to {MOST_BONES}", bones.len()));
    }
    if let Some(at) = bones.iter().position(|b| !b.ends.iter().all(|p| p.is_finite())) {
        return refuse(
            &format!("bone {at}"),
            "has an end that is not a point of finite numbers".into(),
        );
    }
    let above = |(at, bone): (usize, &SkinBone)| bone.parent.is_some_and(|p| p >= at);
    if let Some(at) = bones.iter().enumerate().position(above) {
        let problem = "has a parent that does not come before it; parents come first".into();
        return refuse(&format!("bone {at}"), problem);
    }
    if !(1..=BoneInfluences::MOST).contains(&options.influences) {
        let problem = format!("are {}, allowed are 1 to {}", options.influences, BoneInfluences::MOST);
        return refuse("influences", problem);
    }
    if !(1 << 9..=1 << 26).contains(&options.cells) {
        return refuse(
            "cells",
            format!("are {}, allowed are 512 to {}", options.cells, 1 << 26),
        );
    }
    if !(options.stiffness.is_finite() && options.stiffness > 0.0) {
        return refuse(
            "stiffness",
            format!("is {}, a number above 0 is needed", options.stiffness),
        );
    }
    Ok(())
}

/// A cell is passed by a triangle that comes this near to its centre, in cells. From √3/2 on no triangle passes unseen; less
/// keeps parts that nearly touch apart.
const REACH: f64 = 0.75;
/// Cells in a row, all without a triangle, after which the test for inside is repeated. In between the answer cannot
/// change where the surface is closed, and changes slowly where it is not.
const ASK_EVERY: usize = 8;
/// Cells along the longest side at most.
const LONGEST: f64 = 256.0;
/// Not occupied.
const EMPTY: u32 = u32::MAX;

/// Cells of a cubic lattice, numbered with x running fastest; the occupied ones are nodes.
pub(crate) struct OccupiedCells {
    /// The lowest corner.
    origin: DVec3,
    /// Side of a cell.
    pub(crate) side: f64,
    size: [usize; 3],
    /// By cell: its node, or [`EMPTY`].
    node: Vec<u32>,
    /// By node: the middle of its cell.
    pub(crate) places: Vec<DVec3>,
}

impl OccupiedCells {
    /// Finds them, among `most` cells or fewer.
    pub(crate) fn find(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        most: usize,
        exec: &Exec<'_>,
    ) -> Result<Self, Cancelled> {
        let low = positions.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = positions.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let mut cells = Self::around(low, high, most);
        exec.check()?;
        let mut occupied = cells.inside_or_passed(positions, triangles, exec)?;
        for p in positions {
            occupied[cells.cell_of(*p)] = true;
        }
        cells.node = vec![EMPTY; occupied.len()];
        for (cell, _) in occupied.iter().enumerate().filter(|(_, o)| **o) {
            cells.node[cell] = cells.places.len() as u32;
            cells.places.push(cells.middle(cell));
        }
        Ok(cells)
    }

    /// A lattice around a box, whose middle is the middle of the lattice.
    fn around(low: DVec3, high: DVec3, most: usize) -> Self {
        let extent = high - low;
        let longest = extent.max_element();
        let mut side = if longest > 0.0 { longest / LONGEST } else { 1.0 };
        let count = |side: f64| (extent / side).floor() + DVec3::ONE;
        let total = |side: f64| count(side).to_array().iter().product::<f64>();
        while total(side) > most as f64 {
            side *= 1.02;
        }
        let size = count(side);
        Self {
            origin: 0.5 * (low + high) - 0.5 * side * size,
            side,
            size: size.to_array().map(|n| n as usize),
            node: Vec::new(),
            places: Vec::new(),
        }
    }

    fn middle(&self, cell: usize) -> DVec3 {
        let [nx, ny, _] = self.size;
        let at = DVec3::new((cell % nx) as f64, (cell / nx % ny) as f64, (cell / (nx * ny)) as f64);
        self.origin + (at + 0.5) * self.side
    }

    /// The cell around a point, or the nearest to it.
    fn cell_of(&self, p: DVec3) -> usize {
        let at = (p - self.origin) / self.side;
        let [x, y, z] = [0, 1, 2].map(|k| (at[k].max(0.0) as usize).min(self.size[k] - 1));
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// By cell: whether a triangle passes it or its middle lies inside.
    fn inside_or_passed(
        &self,
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        exec: &Exec<'_>,
    ) -> Result<Vec<bool>, Cancelled> {
        let [nx, ny, nz] = self.size;
        let mut occupied = vec![false; nx * ny * nz];
        if triangles.is_empty() {
            return Ok(occupied);
        }
        let tree = WindingTree::build(positions, triangles, exec.pool);
        for (z, layer) in occupied.chunks_mut(nx * ny).enumerate() {
            exec.pool.install(|| {
                layer.par_chunks_mut(nx).enumerate().try_for_each(|(y, row)| {
                    let mut known = None;
                    for (x, cell) in row.iter_mut().enumerate() {
                        // Triangles as long as the mesh are near every cell.
                        exec.check()?;
                        let middle = self.middle((z * ny + y) * nx + x);
                        if tree.bvh().has_triangle_within(middle, REACH * self.side) {
                            (*cell, known) = (true, None);
                            continue;
                        }
                        let (inside, since) = match known {
                            Some((inside, since)) if since < ASK_EVERY => (inside, since + 1),
                            _ => (tree.contains(middle), 0),
                        };
                        *cell = inside;
                        known = Some((inside, since));
                    }
                    Ok::<(), Cancelled>(())
                })
            })?;
        }
        Ok(occupied)
    }

    /// Rows of the graph that joins cells with a side in common: where each begins, and the neighbours in rising order.
    pub(super) fn rows(&self) -> (Vec<u32>, Vec<u32>) {
        let [nx, ny, nz] = self.size;
        let steps = [(2, nx * ny), (1, nx), (0, 1)];
        let size = [nx, ny, nz];
        let mut offsets = Vec::with_capacity(self.places.len() + 1);
        let mut neighbours = Vec::with_capacity(6 * self.places.len());
        offsets.push(0);
        for (cell, _) in self.node.iter().enumerate().filter(|(_, n)| **n != EMPTY) {
            let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
            let below = steps.iter().filter(|s| at[s.0] > 0).map(|s| cell - s.1);
            let above = steps
                .iter()
                .rev()
                .filter(|s| at[s.0] + 1 < size[s.0])
                .map(|s| cell + s.1);
            let found = below.chain(above).map(|c| self.node[c]).filter(|n| *n != EMPTY);
            neighbours.extend(found);
            offsets.push(neighbours.len() as u32);
        }
        (offsets, neighbours)
    }

    /// The nodes around a point and their shares, by which what is known at nodes is read off in between. Shares add up to
    /// one; cells that are not occupied have none.
    fn around_point(&self, p: DVec3) -> ([(u32, f64); 8], usize) {
        let at = (p - self.origin) / self.side - 0.5;
        let base = at.floor();
        let part = at - base;
        let mut found = [(0, 0.0); 8];
        let mut count = 0;
        let mut sum = 0.0;
        for corner in 0..8 {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let mut share = 1.0;
            let mut cell = [0; 3];
            for k in 0..3 {
                let place = base[k] + step[k] as f64;
                share *= if step[k] == 1 { part[k] } else { 1.0 - part[k] };
                if place < 0.0 || place >= self.size[k] as f64 {
                    share = 0.0;
                } else {
                    cell[k] = place as usize;
                }
            }
            let node = self.node[(cell[2] * self.size[1] + cell[1]) * self.size[0] + cell[0]];
            if share > 0.0 && node != EMPTY {
                found[count] = (node, share);
                count += 1;
                sum += share;
            }
        }
        if sum <= 1e-9 {
            return ([(self.node[self.cell_of(p)], 1.0); 8], 1);
        }
        found[..count].iter_mut().for_each(|f| f.1 /= sum);
        (found, count)
    }
}
