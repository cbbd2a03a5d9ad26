//! Solves for harmonic fields: of few handles on the whole graph, of many each around its handle.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::handles::ownership::{NodeOwnership, UNHELD};
use crate::local_fields::{FieldEntries, HoldCells, NEXT_TO_NOTHING, solve_block};
use crate::shares::{SparseShares, keep_largest};
use pliant_exec::Exec;
use pliant_solver::{Constraints, InitialGuess, LinearSystem, SolveControl, SolveOptions, Workspace};

/// Relative residual to which fields are solved. Blending needs no more, and bends show no difference below it.
const FIELD_TOLERANCE: f64 = 1e-5;
/// What all shares that are left out at a node may come to.
const LEFT_OUT: f32 = 1e-3;
/// Blocks of handles between two looks at the progress, and the bytes of what they find.
const BLOCKS: usize = 32;
const ENTRY_BYTES: usize = size_of::<(u32, u32, f32)>();
const SHARE_BYTES: usize = 2 * size_of::<(u32, f32)>();

/// Solves for the fields of handles.
pub(crate) struct FieldSolver<'a> {
    body: &'a DeformableBody,
    ownership: &'a NodeOwnership,
    pub system: LinearSystem,
    exec: &'a Exec<'a>,
}

impl<'a> FieldSolver<'a> {
    /// `covered` says of each component whether any handle has a say in it.
    pub fn new(
        body: &'a DeformableBody,
        ownership: &'a NodeOwnership,
        covered: &[bool],
        exec: &'a Exec<'a>,
    ) -> Result<Self, Error> {
        let in_cover = |i: usize| covered[body.graph.component[i] as usize];
        let fixed: Vec<bool> = (0..body.nodes())
            .map(|i| ownership.hard[i] != UNHELD || !in_cover(i))
            .collect();
        let stiffness = ownership.stiffness();
        let constraints = Constraints {
            fixed: &fixed,
            stiffness: stiffness.as_deref(),
        };
        let system = body.hierarchy.constrain(&constraints, exec.pool)?;
        Ok(Self {
            body,
            ownership,
            system,
            exec,
        })
    }

    /// The fields of `holds` on the whole graph, a value for each at every node, and how many iterations they took.
    pub fn solve_columns(&self, holds: &[usize]) -> Result<(Vec<f64>, usize), Error> {
        let Self { body, ownership, .. } = *self;
        let (nodes, columns) = (body.nodes(), holds.len());
        let mut x = vec![0.0; nodes * columns];
        let mut column_of = vec![usize::MAX; holds.iter().max().map_or(0, |k| k + 1)];
        holds.iter().enumerate().for_each(|(c, &k)| column_of[k] = c);
        let column = |k: u32| column_of.get(k as usize).copied().filter(|c| *c != usize::MAX);
        for (node, &k) in ownership.hard.iter().enumerate() {
            if let Some(c) = column(k) {
                x[node * columns + c] = 1.0;
            }
        }
        let mut rhs = vec![0.0; nodes * columns];
        for &(node, k, stiffness) in ownership.soft.iter() {
            if let Some(c) = column(k) {
                rhs[node as usize * columns + c] += stiffness;
            }
        }
        let options = SolveOptions {
            start: InitialGuess::FullMultigrid {
                frames: None,
                rest: None,
            },
            tolerance: Some(FIELD_TOLERANCE),
            ..Default::default()
        };
        let mut workspace = Workspace::default();
        let equations = self.system.equations(&body.hierarchy, columns, &rhs);
        let stats = equations.solve(&mut x, &options, &mut workspace, self.exec, &mut |_| {
            SolveControl::Continue
        })?;
        Ok((x, stats.iterations))
    }

    /// The fields of the holds `active`, of `holds` in all, where they are more than next to nothing: those that fade around
    /// their handles are solved for there, the others on the whole graph.
    pub fn solve_sparse(&self, active: &[usize], holds: usize) -> Result<SparseShares, Error> {
        let Self {
            body, ownership, exec, ..
        } = *self;
        let nodes = body.nodes();
        let cells = HoldCells::find(body, ownership, holds);
        let first_pulls = ownership.first_pulls();
        let mut of_blocks: Vec<FieldEntries> = Vec::new();
        let mut count = 0;
        for some in cells.blocks(active.to_vec()).chunks(BLOCKS) {
            exec.check()?;
            let solved = (exec.pool).map(some.len(), 1, |k| {
                solve_block(body, ownership, &first_pulls, &cells, &some[k])
            });
            for (block, solved) in some.iter().zip(solved) {
                let entries = match solved {
                    Some(entries) => entries,
                    None => self.solve_whole(block)?,
                };
                count += entries.len();
                of_blocks.push(entries);
            }
            let bytes = (count * (ENTRY_BYTES + SHARE_BYTES)) as u64;
            if count > u32::MAX as usize || !exec.progress.may_hold(bytes) {
                return Err(Error::TooLarge { bytes });
            }
        }
        let mut first = vec![0usize; nodes + 1];
        let all = || of_blocks.iter().flatten();
        all().for_each(|e| first[e.0 as usize + 1] += 1);
        (0..nodes).for_each(|i| first[i + 1] += first[i]);
        let mut next = first.clone();
        let mut rows = vec![(0u32, 0.0f32); count];
        for &(node, hold, value) in all() {
            rows[next[node as usize]] = (hold, value);
            next[node as usize] += 1;
        }
        drop(of_blocks);
        Ok(SparseShares::of_rows(nodes, exec.pool, |node| {
            match ownership.hard[node] {
                UNHELD => keep_largest(rows[first[node]..first[node + 1]].to_vec(), LEFT_OUT),
                holder => vec![(holder, 1.0)],
            }
        }))
    }

    /// The fields of some holds, solved for on the whole graph, at free nodes where they are more than next to nothing.
    fn solve_whole(&self, holds: &[usize]) -> Result<FieldEntries, Error> {
        let (x, _) = self.solve_columns(holds)?;
        let free = (0u32..).zip(x.chunks_exact(holds.len()));
        let free = free.filter(|(node, _)| self.ownership.hard[*node as usize] == UNHELD);
        let entries = free.flat_map(|(node, row)| {
            let some = holds.iter().zip(row).filter(|(_, u)| **u > f64::from(NEXT_TO_NOTHING));
            some.map(move |(&k, &u)| (node, k as u32, u.min(1.0) as f32))
        });
        Ok(entries.collect())
    }
}
