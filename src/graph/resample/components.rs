//! Connected components after an edit: from the old ones where what changed still hangs together, else found anew.

use super::rows::Fresh;
use crate::graph::Graph;
use crate::mesh::{Components, NONE};
use crate::pool::Pool;
use rayon::prelude::*;

/// What is looked at.
pub(super) struct View<'a> {
    pub(super) old: &'a Graph,
    /// Old numbers of all nodes.
    pub(super) from: &'a [u32],
    pub(super) offsets: &'a [u32],
    pub(super) neighbours: &'a [u32],
    pub(super) pool: &'a Pool,
}

/// The component of each node, numbered in the order of their smallest nodes.
pub(super) struct Followed {
    pub(super) of_node: Vec<u32>,
    pub(super) count: usize,
}

/// Every edge that is gone ran between nodes that are gone and nodes with fresh rows. So where all nodes with fresh rows
/// that were one component hang together by those rows, the component has not been split.
pub(super) fn follow(view: &View, fresh: &Fresh) -> Followed {
    let View { old, from, pool, .. } = *view;
    let mut near: Vec<u32> = (0..fresh.nodes.len()).flat_map(|k| fresh.row(k)).copied().collect();
    near.extend_from_slice(&fresh.nodes);
    near.sort_unstable();
    near.dedup();
    let local = |node: u32| near.binary_search(&node).unwrap_or(0) as u32;
    let edges = fresh.nodes.iter().enumerate().flat_map(|(k, &node)| {
        let own = local(node);
        fresh.row(k).iter().map(move |&m| (own, local(m)))
    });
    let pieces = Components::of_edges(near.len(), edges);
    // The old components that each piece has nodes of.
    let mut known: Vec<(u32, u32)> = Vec::new();
    for (&node, &piece) in near.iter().zip(&pieces.of_vertex) {
        let o = from[node as usize];
        if o != NONE {
            known.push((old.component[o as usize], piece));
        }
    }
    known.sort_unstable();
    known.dedup();
    if known.windows(2).any(|w| w[0].0 == w[1].0) {
        return anew(view);
    }
    if old.components == 1 && pieces.count == known.len() {
        return Followed {
            of_node: vec![0; from.len()],
            count: 1,
        };
    }
    // Old components and pieces, joined where a piece has nodes of a component.
    let before = old.components as u32;
    let joined = known.iter().map(|&(component, piece)| (component, before + piece));
    let joined = Components::of_edges(old.components + pieces.count, joined);
    let label = |node: usize| match from[node] {
        NONE => joined.of_vertex[(before + pieces.of_vertex[local(node as u32) as usize]) as usize],
        o => joined.of_vertex[old.component[o as usize] as usize],
    };
    let mut of_node: Vec<u32> = pool.install(|| {
        (0..from.len())
            .into_par_iter()
            .with_min_len(1 << 14)
            .map(label)
            .collect()
    });
    let mut number = vec![NONE; joined.count];
    let mut count = 0;
    for label in &mut of_node {
        let number = &mut number[*label as usize];
        if *number == NONE {
            *number = count;
            count += 1;
        }
        *label = *number;
    }
    Followed {
        of_node,
        count: count as usize,
    }
}

/// All components, from all edges.
fn anew(view: &View) -> Followed {
    let rows = view
        .offsets
        .windows(2)
        .map(|w| &view.neighbours[w[0] as usize..w[1] as usize]);
    let edges = (0u32..).zip(rows).flat_map(|(node, row)| {
        let lower = row.iter().take_while(move |&&m| m < node);
        lower.map(move |&m| (node, m))
    });
    let found = Components::of_edges(view.from.len(), edges);
    Followed {
        of_node: found.of_vertex,
        count: found.count,
    }
}
