//! Writes the graph after an edit: rows that changed one by one, all others copied in runs with their nodes renumbered.
//!
//! Old and new numbers of nodes.

use crate::NONE;
use crate::graph::mesh_graph::{GraphRecipe, GraphStats, MeshGraph};
use crate::graph::resample::change::{BLOCK, FreshRows, GraphBefore, GraphEdit, NodeNumbers, ResampledGraph};
use crate::graph::resample::hull::{ComponentView, FollowedComponents, follow_components};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

const GONE: u8 = 1;
const OUTER: u8 = 2;
const LATTICE: u8 = 4;
const UNTIED: u8 = 8;

/// Carries out an edit.
///
/// Also answers the numbers after it of the nodes in `edit.nearest`, in their order.
pub(super) fn write_rows(
    edit: &GraphEdit,
    mut stats: GraphStats,
    recipe: GraphRecipe,
    pool: &Pool,
) -> (ResampledGraph, Vec<u32>) {
    let (old, change) = (edit.old, edit.change);
    let renumbered = Renumbered::from_edit(edit, pool);
    let any = |node: u32| renumbered.of_any(edit.numbers, node);
    let fresh = fresh_rows(edit, &renumbered, pool);
    let nodes = renumbered.after[2];
    let (offsets, neighbours, weights) = pool.install(|| copy_rows(old, &renumbered, &fresh));

    let surface = change.positions.len();
    let from = &renumbered.old_from_new;
    let place = |node: usize| match from[node] {
        _ if node < surface => change.positions[node],
        NONE => DVec3::ZERO,
        o => old.positions[o as usize],
    };
    let vertex = |node: usize| match from[node] {
        _ if node < surface => node as u32,
        NONE => NONE,
        o => edit.points.new_from_old[old.nearest_surface[o as usize] as usize],
    };
    let (mut positions, mut nearest_surface): (Vec<DVec3>, Vec<u32>) = pool.install(|| {
        rayon::join(
            || (0..nodes).into_par_iter().with_min_len(BLOCK).map(place).collect(),
            || (0..nodes).into_par_iter().with_min_len(BLOCK).map(vertex).collect(),
        )
    });
    edit.placed.iter().for_each(|&(n, p)| positions[any(n) as usize] = p);
    edit.nearest
        .iter()
        .for_each(|&(n, v)| nearest_surface[any(n) as usize] = v);

    let mut touched = fresh.nodes.clone();
    let moves = |p: u32| change.positions[p as usize] != old.positions[change.old_from_new[p as usize] as usize];
    touched.extend(change.moved.iter().filter(|&&p| moves(p)));
    touched.extend(edit.placed.iter().map(|&(n, _)| any(n)));
    touched.sort_unstable();
    touched.dedup();

    let view = ComponentView {
        old,
        from,
        offsets: &offsets,
        neighbours: &neighbours,
        pool,
    };
    let FollowedComponents { of_node, count } = follow_components(&view, &fresh);
    stats.shell_nodes = renumbered.after[1] - surface;
    stats.lattice_nodes = nodes - renumbered.after[1];
    stats.component_has_volume = vec![false; count];
    if count == 1 {
        stats.component_has_volume[0] = nodes > surface;
    } else {
        let inner = of_node[surface..].iter();
        inner.for_each(|&c| stats.component_has_volume[c as usize] = true);
    }
    let asked = edit.nearest.iter().map(|&(n, _)| any(n)).collect();
    let Renumbered {
        new_from_old,
        old_from_new,
        ..
    } = renumbered;
    let resampled = ResampledGraph {
        graph: MeshGraph {
            offsets,
            neighbours,
            weights,
            positions,
            surface,
            nearest_surface,
            component: of_node,
            components: count,
            stats,
            recipe,
            ties: None,
        },
        new_from_old,
        old_from_new,
        touched,
    };
    (resampled, asked)
}

/// The rows that differ from those of the old graph.
fn fresh_rows(edit: &GraphEdit, renumbered: &Renumbered, pool: &Pool) -> FreshRows {
    let old = edit.old;
    let mut flags = vec![0u8; old.nodes()];
    let flagged = [
        (&edit.gone, GONE),
        (&edit.outer, OUTER),
        (&edit.lattice, LATTICE),
        (&edit.untied, UNTIED),
    ];
    for (nodes, flag) in flagged {
        nodes.iter().for_each(|&n| flags[n as usize] |= flag);
    }
    let first_lattice = renumbered.before[1] as u32;
    // An edge belongs to the outer nodes, to the lattice, or ties both.
    let dropped = |a: u32, b: u32| {
        let both = flags[a as usize] | flags[b as usize];
        both & GONE != 0
            || match (a < first_lattice, b < first_lattice) {
                (true, true) => both & OUTER != 0,
                (false, false) => both & LATTICE != 0,
                _ => both & UNTIED != 0,
            }
    };
    let left = |node: u32| flags[node as usize] & GONE == 0;
    let mut links: Vec<(u32, u32, f32)> = Vec::with_capacity(2 * edit.links.len());
    let mut dirty: Vec<u32> = Vec::new();
    for link in &edit.links {
        let [a, b] = link.ends.map(|n| renumbered.of_any(edit.numbers, n));
        links.extend([(a, b, link.weight), (b, a, link.weight)]);
        dirty.extend(link.ends.iter().filter(|&&n| n < edit.numbers.old));
    }
    pool.install(|| links.par_sort_unstable_by_key(|l| u64::from(l.0) << 32 | u64::from(l.1)));
    links.dedup_by_key(|l| (l.0, l.1));
    for (nodes, _) in flagged {
        for &n in nodes {
            let partners = old.row(n).iter().filter(|&&m| left(m) && dropped(n, m));
            dirty.extend(partners);
            dirty.extend(Some(n).filter(|&n| left(n)));
        }
    }
    dirty.sort_unstable();
    dirty.dedup();

    let own_links = |node: u32| {
        let from = links.partition_point(|l| l.0 < node);
        links[from..]
            .iter()
            .take_while(move |l| l.0 == node)
            .map(|l| (l.1, l.2))
    };
    let weight = |entry: usize| old.weight(entry);
    type Row = (u32, Vec<(u32, f32)>);
    // Old nodes whose rows differ from what they were.
    let rows: Vec<Row> = pool.install(|| {
        let rows = dirty.par_iter().with_min_len(64).filter_map(|&o| {
            let node = renumbered.new_from_old[o as usize];
            let entries = old.entries(o);
            let kept = entries.clone().filter(|&e| !dropped(o, old.neighbours[e]));
            let mut row: Vec<(u32, f32)> = own_links(node).collect();
            row.extend(kept.map(|e| (renumbered.of_old(old.neighbours[e]), weight(e))));
            row.sort_by_key(|r| r.0);
            row.dedup_by_key(|r| r.0);
            let before = |e: usize| (renumbered.new_from_old[old.neighbours[e] as usize], weight(e));
            (row.len() != entries.len() || row.iter().zip(entries).any(|(&r, e)| r != before(e))).then_some((node, row))
        });
        rows.collect()
    });
    let born = (0..3).flat_map(|kind| {
        let first = [0, renumbered.after[0], renumbered.after[1]][kind] + renumbered.left[kind];
        first as u32..renumbered.after[kind] as u32
    });
    let mut rows = rows;
    rows.extend(born.map(|node| (node, own_links(node).collect())));
    rows.sort_unstable_by_key(|r: &Row| r.0);
    let mut fresh = FreshRows {
        nodes: Vec::new(),
        offsets: vec![0],
        neighbours: Vec::new(),
        weights: Vec::new(),
    };
    for (node, row) in rows {
        fresh.nodes.push(node);
        fresh.neighbours.extend(row.iter().map(|r| r.0));
        fresh.weights.extend(row.iter().map(|r| r.1));
        fresh.offsets.push(fresh.neighbours.len() as u32);
    }
    fresh
}

/// Where a run of rows comes from.
enum RowSource {
    /// Old nodes from this one on.
    Old(usize),
    /// Fresh rows from this one on.
    Fresh(usize),
}

/// A run of rows to be written.
struct RowRun<'a> {
    source: RowSource,
    /// Where the first row starts.
    start: u32,
    /// Where each row ends.
    ends: &'a mut [u32],
    neighbours: &'a mut [u32],
    weights: &'a mut [f32],
}

/// Finds runs of nodes with the source of their rows: fresh, or one old node after the other.
fn find_row_sources(renumbered: &Renumbered, fresh: &FreshRows) -> Vec<(RowSource, usize)> {
    let from = &renumbered.old_from_new;
    let nodes = from.len();
    let mut sources: Vec<(RowSource, usize)> = Vec::new();
    let (mut node, mut next) = (0, 0);
    let first_gap = |node: usize, end: usize| {
        // Old numbers rise along a run without gap, as numbers do.
        let shift = from[node].wrapping_sub(node as u32);
        let (mut low, mut high) = (node, end - 1);
        if from[high].wrapping_sub(high as u32) == shift {
            return end;
        }
        while high - low > 1 {
            let middle = low.midpoint(high);
            let same = from[middle].wrapping_sub(middle as u32) == shift;
            (low, high) = if same { (middle, high) } else { (low, middle) };
        }
        high
    };
    while node < nodes {
        if fresh.nodes.get(next).is_some_and(|&f| f as usize == node) {
            let run = (1..)
                .take_while(|&k| fresh.nodes.get(next + k) == Some(&((node + k) as u32)))
                .count()
                + 1;
            sources.push((RowSource::Fresh(next), run));
            next += run;
            node += run;
            continue;
        }
        let kind = renumbered.after.partition_point(|&a| a <= node).min(2);
        let end = fresh
            .nodes
            .get(next)
            .map_or(nodes, |&f| f as usize)
            .min(renumbered.after[kind]);
        let end = first_gap(node, end.min(node + BLOCK));
        sources.push((RowSource::Old(from[node] as usize), end - node));
        node = end;
    }
    sources
}

/// Copies old rows and fresh ones into the offsets, neighbours and weights of the new graph.
fn copy_rows(
    old: &GraphBefore<'_>,
    renumbered: &Renumbered,
    fresh: &FreshRows,
) -> (Vec<u32>, Vec<u32>, Option<Vec<f32>>) {
    let nodes = renumbered.old_from_new.len();
    let sources = find_row_sources(renumbered, fresh);
    let entries = |source: &RowSource, run: usize| match *source {
        RowSource::Old(o) => (old.offsets[o + run] - old.offsets[o]) as usize,
        RowSource::Fresh(f) => (fresh.offsets[f + run] - fresh.offsets[f]) as usize,
    };
    let total: usize = sources.iter().map(|(source, run)| entries(source, *run)).sum();
    let mut offsets = vec![0u32; nodes + 1];
    let mut neighbours = vec![0u32; total];
    let mut weights = old.weights.as_ref().map(|_| vec![0f32; total]);
    let mut runs = Vec::with_capacity(sources.len());
    let mut start = 0u32;
    let (mut rest, mut more) = (&mut offsets[1..], neighbours.as_mut_slice());
    let mut weighed = weights.as_deref_mut().unwrap_or_default();
    for (source, run) in sources {
        let count = entries(&source, run);
        let (ends, after) = std::mem::take(&mut rest).split_at_mut(run);
        let (own, others) = std::mem::take(&mut more).split_at_mut(count);
        let weights_here = count.min(weighed.len());
        let (own_weights, lighter) = std::mem::take(&mut weighed).split_at_mut(weights_here);
        (rest, more, weighed) = (after, others, lighter);
        runs.push(RowRun {
            source,
            start,
            ends,
            neighbours: own,
            weights: own_weights,
        });
        start += count as u32;
    }
    runs.into_par_iter().for_each(|run| {
        let (lengths, numbers, before) = match run.source {
            RowSource::Old(o) => {
                let entries = old.offsets[o] as usize..old.offsets[o + run.ends.len()] as usize;
                let weights = old.weights.as_ref().map(|w| &w[entries.clone()]);
                (
                    &old.offsets[o..=o + run.ends.len()],
                    Some(&old.neighbours[entries]),
                    weights,
                )
            }
            RowSource::Fresh(f) => {
                let entries = fresh.offsets[f] as usize..fresh.offsets[f + run.ends.len()] as usize;
                run.neighbours.copy_from_slice(&fresh.neighbours[entries.clone()]);
                let weights = old.weights.as_ref().map(|_| &fresh.weights[entries]);
                (&fresh.offsets[f..=f + run.ends.len()], None, weights)
            }
        };
        let shift = run.start.wrapping_sub(lengths[0]);
        let ends = run.ends.iter_mut().zip(&lengths[1..]);
        ends.for_each(|(end, &before)| *end = before.wrapping_add(shift));
        if let Some(numbers) = numbers {
            let entries = run.neighbours.iter_mut().zip(numbers);
            entries.for_each(|(entry, &o)| *entry = renumbered.of_old(o));
        }
        if let Some(before) = before {
            run.weights.copy_from_slice(before);
        }
    });
    (offsets, neighbours, weights)
}

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
    fn from_edit(edit: &GraphEdit, pool: &Pool) -> Self {
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
    fn of_old(&self, node: u32) -> u32 {
        match self.shifts[node as usize / SHIFTED] {
            NONE => self.new_from_old[node as usize],
            shift => node.wrapping_add(shift),
        }
    }

    /// The number of a node from its number during the edit.
    fn of_any(&self, numbers: &NodeNumbers, node: u32) -> u32 {
        let Some(born) = node.checked_sub(numbers.old) else {
            return self.new_from_old[node as usize];
        };
        let counts = [numbers.points, numbers.shells, numbers.lattice];
        let kind = usize::from(born >= counts[0]) + usize::from(born >= counts[0] + counts[1]);
        let first = [0, self.after[0], self.after[1]][kind] + self.left[kind];
        first as u32 + born - counts[..kind].iter().sum::<u32>()
    }
}
