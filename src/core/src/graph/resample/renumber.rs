//! Old and new numbers of nodes.

use crate::graph::resample::change::NodeNumbers;
use crate::graph::resample::graph_edit::{BLOCK, GraphEdit};
use crate::mesh::NONE;
use crate::pool::Pool;
use rayon::prelude::*;

/// Old nodes whose numbers move by the same, more often than not.
const SHIFTED: usize = 256;

/// Old and new numbers of nodes.
pub(super) struct Renumbered {
    pub(super) new_from_old: Vec<u32>,
    pub(super) old_from_new: Vec<u32>,
    /// Where shell and lattice begin, and the end, before and after.
    pub(super) before: [usize; 3],
    pub(super) after: [usize; 3],
    /// How many old nodes of each kind are left.
    pub(super) left: [usize; 3],
    /// By runs of [`SHIFTED`] old nodes: what to add to the number of each, or [`NONE`] when they differ.
    shifts: Vec<u32>,
}

impl Renumbered {
    pub(super) fn from_edit(edit: &GraphEdit, pool: &Pool) -> Self {
        let old = edit.old;
        let before = [old.surface, old.surface + old.stats.shell_nodes, old.nodes()];
        let born = [edit.numbers.points, edit.numbers.shells, edit.numbers.lattice].map(|n| n as usize);
        let gone_before = |node: usize| edit.gone.partition_point(|&g| (g as usize) < node);
        let (mut left, mut after, mut from, mut start) = ([0; 3], [0; 3], 0, 0);
        let mut first_new = [0usize; 3];
        for kind in 0..3 {
            left[kind] = before[kind] - from - (gone_before(before[kind]) - gone_before(from));
            first_new[kind] = start;
            start += left[kind] + born[kind];
            after[kind] = start;
            from = before[kind];
        }
        let first_old = [0, before[0], before[1]];
        let mut new_from_old = vec![NONE; old.nodes()];
        let fill = |(block, out): (usize, &mut [u32])| {
            let (mut node, end) = (block * BLOCK, block * BLOCK + out.len());
            let mut next = gone_before(node);
            while node < end {
                let kind = before.partition_point(|&b| b <= node).min(2);
                let gone = edit.gone.get(next).map_or(usize::MAX, |&g| g as usize);
                if gone == node {
                    node += 1;
                    next += 1;
                    continue;
                }
                let to = end.min(before[kind]).min(gone);
                let number = first_new[kind] + (node - first_old[kind]) - (next - gone_before(first_old[kind]));
                let slots = &mut out[node - block * BLOCK..to - block * BLOCK];
                (number as u32..).zip(slots).for_each(|(n, slot)| *slot = n);
                node = to;
            }
        };
        pool.install(|| new_from_old.par_chunks_mut(BLOCK).enumerate().for_each(fill));
        let shifts = new_from_old.chunks(SHIFTED).enumerate().map(|(block, numbers)| {
            let first = block * SHIFTED;
            let end = first + numbers.len();
            let whole = gone_before(first) == gone_before(end) && before.iter().all(|&b| b <= first || b >= end);
            if whole {
                numbers[0].wrapping_sub(first as u32)
            } else {
                NONE
            }
        });
        let shifts = shifts.collect();
        // Filled from the old side: the order of each kind is kept.
        let mut old_from_new = vec![NONE; after[2]];
        let mut rest = old_from_new.as_mut_slice();
        let mut parts: Vec<(usize, &mut [u32])> = Vec::new();
        for kind in 0..3 {
            let (own, more) = rest.split_at_mut(left[kind] + born[kind]);
            parts.push((kind, &mut own[..left[kind]]));
            rest = more;
        }
        for (kind, mut out) in parts {
            let mut node = first_old[kind];
            let mut next = gone_before(node);
            while !out.is_empty() {
                let gone = edit.gone.get(next).map_or(usize::MAX, |&g| g as usize);
                let run = out.len().min(gone - node);
                let (own, more) = std::mem::take(&mut out).split_at_mut(run);
                (node as u32..).zip(own).for_each(|(n, slot)| *slot = n);
                out = more;
                node += run + 1;
                next += 1;
            }
        }
        Self {
            new_from_old,
            old_from_new,
            before,
            after,
            left,
            shifts,
        }
    }

    /// The number of a node that is left, from its number in the old graph.
    #[inline]
    pub(super) fn of_old(&self, node: u32) -> u32 {
        match self.shifts[node as usize / SHIFTED] {
            NONE => self.new_from_old[node as usize],
            shift => node.wrapping_add(shift),
        }
    }

    /// The number of a node from its number during the edit.
    pub(super) fn of_any(&self, numbers: &NodeNumbers, node: u32) -> u32 {
        let Some(born) = node.checked_sub(numbers.old) else {
            return self.new_from_old[node as usize];
        };
        let counts = [numbers.points, numbers.shells, numbers.lattice];
        let kind = usize::from(born >= counts[0]) + usize::from(born >= counts[0] + counts[1]);
        let first = [0, self.after[0], self.after[1]][kind] + self.left[kind];
        first as u32 + born - counts[..kind].iter().sum::<u32>()
    }
}
