//! The balance of all bones' pulls: one system, a column for each bone.

use super::HeaviestWeights;
use super::cell_paths::{CellPaths, OccupiedCells, SkinBone, distance_squared, nearest};
use super::even_jumps::even_jumps;
use crate::skeleton::BoneInfluences;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::graph::WindingTree;
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
    let tree = (!triangles.is_empty()).then(|| WindingTree::build(positions, triangles, exec.pool));
    let cells = bound_cells(positions, tree.as_ref(), options.cells, exec)?;
    let paths = CellPaths::of(&cells, tree.as_ref(), exec)?;
    let pulls = pulls(&paths, bones, options.stiffness, exec)?;
    let nodes = cells.places.len();
    let points: Vec<[f64; 3]> = cells.places.iter().map(DVec3::to_array).collect();
    let graph = WeightedGraph {
        offsets: &paths.offsets,
        neighbours: &paths.neighbours,
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
        let of_cells = cut.smoothed(&paths, &heaviest, exec)?;
        let all = positions.par_iter().with_min_len(RUN);
        let found = all.map(|p| {
            exec.check()?;
            let (around, count) = paths.around_point(*p);
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
    tree: Option<&WindingTree<'_>>,
    most: usize,
    exec: &Exec<'_>,
) -> Result<OccupiedCells, Cancelled> {
    let few = OccupiedCells::find(positions, tree, most.min(FEW_CELLS), exec)?;
    let filled = few.places.len() as f64 / few.node.len() as f64;
    OccupiedCells::find(positions, tree, most.min((OCCUPIED as f64 / filled) as usize), exec)
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
        paths: &CellPaths<'_>,
        heaviest: &[HeaviestWeights],
        exec: &Exec<'_>,
    ) -> Result<Vec<BoneInfluences>, SkinWeightError> {
        let taken = heaviest.iter().map(|h| h.share_cut(self.most));
        let loose: Vec<f64> = taken.map(|taken| (taken / LOOSE).min(1.0)).collect();
        let all = heaviest.par_iter().zip(&paths.cells.places).with_min_len(RUN);
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
                    let around = paths.row(node);
                    if loose[node] == 0.0 {
                        return Ok(of_cells[node]);
                    }
                    let share = loose[node] / (around.len() as f64 + 1.0);
                    let own = 1.0 - share * around.len() as f64;
                    let parts = around.iter().map(|n| (&of_cells[*n as usize], share));
                    let mixed = HeaviestWeights::of_mixture(parts.chain([(&of_cells[node], own)]));
                    Ok(self.few(&mixed, paths.cells.places[node]))
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
    paths: &CellPaths<'_>,
    bones: &[SkinBone],
    stiffness: f64,
    exec: &Exec<'_>,
) -> Result<Vec<CellPull>, Cancelled> {
    let nearest = paths.nearest_bones(bones, exec)?;
    let side = paths.cells.side;
    exec.pool.install(|| {
        let all = paths.cells.places.par_iter().zip(&nearest).with_min_len(RUN);
        let found = all.map(|(p, (bone, way))| {
            // All bones are looked at for each cell.
            exec.check()?;
            let own = distance_squared(&bones[*bone], *p).sqrt();
            let apart = EQUAL * (own + side);
            let near = (0..bones.len()).filter(|b| (distance_squared(&bones[*b], *p).sqrt() - own).abs() <= apart);
            let d = way / side;
            Ok(CellPull {
                bones: near.take(SHARING).collect(),
                stiffness: stiffness / (d * d).max(NEAREST * NEAREST),
            })
        });
        found.collect()
    })
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
