//! Connected components after an edit: from the old ones, and from a search where something may have been cut loose.

use crate::graph::resample::change::FreshRows;
use crate::graph::resample::change::GraphBefore;
use crate::mesh::{Components, NONE};
use crate::pool::Pool;
use rayon::prelude::*;

/// Nodes that each search visits before the next has its turn.
const TURN: usize = 256;

/// What is looked at.
pub(super) struct ComponentView<'a> {
    pub(super) old: &'a GraphBefore<'a>,
    /// Old numbers of all nodes.
    pub(super) from: &'a [u32],
    pub(super) offsets: &'a [u32],
    pub(super) neighbours: &'a [u32],
    pub(super) pool: &'a Pool,
}

/// The component of each node, numbered in the order of their smallest nodes.
pub(super) struct FollowedComponents {
    pub(super) of_node: Vec<u32>,
    pub(super) count: usize,
}

/// Every edge that is gone ran between nodes that are gone and nodes with fresh rows. So where all nodes with fresh rows
/// that were one component hang together by those rows, the component has not been split; where they do not, each of
/// their pieces is searched from.
pub(super) fn follow_components(view: &ComponentView, fresh: &FreshRows) -> FollowedComponents {
    let ComponentView { old, from, pool, .. } = *view;
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
    if old.components == 1 && pieces.count == 1 && known.len() == 1 {
        return FollowedComponents {
            of_node: vec![0; from.len()],
            count: 1,
        };
    }
    let search = PieceSearch::search_pieces(view, &near, &pieces, &known);
    // Old components and pieces, joined where a piece has nodes of a component and has not been cut loose from it.
    let before = old.components as u32;
    let rests = known.iter().filter(|&&(_, piece)| !search.is_loose(piece));
    let joined = rests.map(|&(component, piece)| (component, before + piece));
    let met = (0..pieces.count as u32).map(|piece| (before + piece, before + search.find_group(piece)));
    let joined = Components::of_edges(old.components + pieces.count, joined.chain(met));
    let label = |node: usize| {
        let loose = search
            .reached
            .get(node)
            .copied()
            .filter(|&piece| piece != NONE && search.is_loose(piece));
        let element = match (loose, from[node]) {
            (Some(piece), _) => before + piece,
            (None, NONE) => before + pieces.of_vertex[local(node as u32) as usize],
            (None, o) => old.component[o as usize],
        };
        joined.of_vertex[element as usize]
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
    FollowedComponents {
        of_node,
        count: count as usize,
    }
}

/// Searches from pieces of components that may have been split, in turns, until those of each component have met, or all
/// but one have nowhere left to go: that takes time in proportion to what was cut loose.
struct PieceSearch {
    /// Pieces that have met have the same root.
    parent: Vec<u32>,
    /// For each piece the nodes that its search reached, in order; empty for pieces that are not searched from.
    queues: Vec<Vec<u32>>,
    /// How many of them have been visited.
    visited: Vec<usize>,
    /// For each node the piece whose search reached it; empty without any search.
    reached: Vec<u32>,
    /// For each piece whether its group is a component of its own, with all its nodes reached.
    loose: Vec<bool>,
}

impl PieceSearch {
    fn search_pieces(view: &ComponentView, near: &[u32], pieces: &Components, known: &[(u32, u32)]) -> Self {
        let mut search = Self {
            parent: (0..pieces.count as u32).collect(),
            queues: vec![Vec::new(); pieces.count],
            visited: vec![0; pieces.count],
            reached: Vec::new(),
            loose: vec![false; pieces.count],
        };
        let split: Vec<&[(u32, u32)]> = known.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() > 1).collect();
        if split.is_empty() {
            return search;
        }
        let mut asked: Vec<u32> = split.iter().flat_map(|c| c.iter().map(|k| k.1)).collect();
        asked.sort_unstable();
        asked.dedup();
        search.reached = vec![NONE; view.from.len()];
        for (&node, &piece) in near.iter().zip(&pieces.of_vertex) {
            if asked.binary_search(&piece).is_ok() {
                search.reached[node as usize] = piece;
                search.queues[piece as usize].push(node);
            }
        }
        loop {
            // Groups that still have somewhere to go.
            let mut active: Vec<u32> = asked.iter().copied().filter(|&p| search.goes_on(p)).collect();
            active.iter_mut().for_each(|p| *p = search.find_group(*p));
            active.sort_unstable();
            active.dedup();
            let undecided = split.iter().any(|component| {
                let groups = component.iter().map(|k| search.find_group(k.1));
                let mut groups: Vec<u32> = groups.filter(|g| active.binary_search(g).is_ok()).collect();
                groups.sort_unstable();
                groups.dedup();
                groups.len() > 1
            });
            if !undecided {
                for &piece in &asked {
                    search.loose[piece as usize] = active.binary_search(&search.find_group(piece)).is_err();
                }
                return search;
            }
            asked.iter().for_each(|&piece| search.go_on(view, piece));
        }
    }

    fn find_group(&self, mut piece: u32) -> u32 {
        while self.parent[piece as usize] != piece {
            piece = self.parent[piece as usize];
        }
        piece
    }

    fn is_loose(&self, piece: u32) -> bool {
        self.loose[piece as usize]
    }

    fn goes_on(&self, piece: u32) -> bool {
        self.visited[piece as usize] < self.queues[piece as usize].len()
    }

    /// One turn of the search from a piece.
    fn go_on(&mut self, view: &ComponentView, piece: u32) {
        let mut queue = std::mem::take(&mut self.queues[piece as usize]);
        let first = self.visited[piece as usize];
        let mut visited = first;
        while visited < queue.len() && visited < first + TURN {
            let node = queue[visited] as usize;
            visited += 1;
            for &next in &view.neighbours[view.offsets[node] as usize..view.offsets[node + 1] as usize] {
                match &mut self.reached[next as usize] {
                    free @ &mut NONE => {
                        *free = piece;
                        queue.push(next);
                    }
                    &mut other if other == piece => {}
                    &mut other => {
                        let (a, b) = (self.find_group(piece), self.find_group(other));
                        self.parent[a.max(b) as usize] = a.min(b);
                    }
                }
            }
        }
        self.visited[piece as usize] = visited;
        self.queues[piece as usize] = queue;
    }
}
