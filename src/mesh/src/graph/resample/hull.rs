//! What an edit does to the parts that enclose space: which new points belong to them, and which passages along edges
//! they lack to be closed.
//!
//! Connected components after an edit: from the old ones, and from a search where something may have been cut loose.

use crate::graph::mesh_graph::InteriorRecipe;
use crate::graph::resample::change::{ChangedPoints, FreshRows, GraphBefore, MeshChange};
use crate::graph::volume::caps::{missing_of, rings};
use crate::graph::volume::solid::{OPEN, SOUP, sample};
use crate::graph::winding::WindingTree;
use crate::{Components, NONE, sorted_set};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Caps of new holes may be as large as this part of their surface; with more of it open, the whole surface decides
/// whether it still encloses anything.
const LARGEST_CAP: f64 = 0.15;
/// Winding numbers are asked this part of an offset beside a face.
pub(super) const BESIDE: f64 = 1.0 / 64.0;

/// Parts that enclose space after an edit.
pub(super) struct HullChange {
    /// As in [`InteriorRecipe`].
    pub(super) reach: Vec<f32>,
    /// As in [`InteriorRecipe`].
    pub(super) open: Vec<[u32; 2]>,
    /// New parts whose sides are not known yet: their points, by new number.
    pub(super) unsided: Vec<Vec<u32>>,
    /// Loops of new points that faces close.
    pub(super) loops: Vec<Vec<u32>>,
    /// Those of them that are new, and those that are no more, by old points.
    pub(super) new_loops: Vec<Vec<u32>>,
    pub(super) lost_loops: Vec<Vec<u32>>,
}

/// The fan over a loop: its middle, and a face for each edge.
pub(super) fn fan_over_loop(ring: &[u32], at: impl Fn(u32) -> DVec3) -> (DVec3, impl Iterator<Item = [u32; 2]> + '_) {
    let middle = ring.iter().map(|&v| at(v)).sum::<DVec3>() / ring.len() as f64;
    let next = ring.iter().cycle().skip(1);
    (middle, ring.iter().zip(next).map(|(&a, &b)| [a, b]))
}

/// Follows an edit. `None` when only the whole surface shows what it encloses now.
pub(super) fn follow_hull(
    old: &GraphBefore<'_>,
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
    pool: &Pool,
) -> Option<HullChange> {
    let (assigned, fresh) = assign_reach(inside, change, points)?;
    let mut reach: Vec<f32> = pool.install(|| {
        let of = |&o: &u32| if o == NONE { 0.0 } else { inside.reach[o as usize] };
        change.old_from_new.par_iter().with_min_len(1 << 14).map(of).collect()
    });
    assigned.iter().for_each(|&(p, r)| reach[p as usize] = r);

    let mut unsided = Vec::new();
    for part in fresh {
        let solid = enclosing_edge_length(change, &part, pool)?;
        if solid > 0.0 {
            let offset = solid.min(old.stats.shell_offset) as f32;
            part.points.iter().for_each(|&p| reach[p as usize] = offset);
            unsided.push(part.points);
        }
    }

    let open = missing_passages(inside, change, points, &reach)?;
    let before = passage_loops(&inside.open);
    let loops = if open == inside.open {
        before.clone()
    } else {
        passage_loops(&open)
    };
    let turned = |ring: Vec<u32>| {
        let first = (0..ring.len()).min_by_key(|&k| ring[k]).unwrap_or(0);
        let mut ring = ring;
        ring.rotate_left(first);
        ring
    };
    // What each old loop is now, where none of its points changed.
    let still = |ring: &Vec<u32>| -> Option<Vec<u32>> {
        let to = |&v: &u32| Some(points.new_from_old[v as usize]).filter(|&n| n != NONE && !points.moved[n as usize]);
        ring.iter().map(to).collect::<Option<Vec<u32>>>().map(turned)
    };
    let mut known: Vec<Vec<u32>> = before.iter().filter_map(still).collect();
    known.sort_unstable();
    let mut there: Vec<Vec<u32>> = loops.iter().cloned().map(turned).collect();
    there.sort_unstable();
    let lost = |ring: &&Vec<u32>| still(ring).is_none_or(|r| there.binary_search(&r).is_err());
    let lost_loops = before.iter().filter(lost).cloned().collect();
    let is_new = |ring: &&Vec<u32>| known.binary_search(&turned((*ring).clone())).is_err();
    let new_loops: Vec<Vec<u32>> = loops.iter().filter(is_new).cloned().collect();
    let hull = HullChange {
        reach,
        open,
        unsided,
        loops,
        new_loops,
        lost_loops,
    };
    (!too_open(old, change, &hull)).then_some(hull)
}

/// New points with their reach.
type NewReach = Vec<(u32, f32)>;

/// Triangles and points that are new and hang together with no old point.
struct NewPart {
    triangles: Vec<[u32; 3]>,
    points: Vec<u32>,
}

/// The reach of new points that hang together with old ones, and the new parts. `None` where an edit joins what encloses
/// space with what does not.
fn assign_reach(
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
) -> Option<(NewReach, Vec<NewPart>)> {
    let faces: Vec<[u32; 3]> = change.added.iter().map(|&t| change.triangles[t as usize]).collect();
    let used: Vec<u32> = sorted_set(faces.iter().flatten().copied());
    let local = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
    let small: Vec<[u32; 3]> = faces.iter().map(|t| t.map(local)).collect();
    let groups = Components::of_triangles(used.len(), &small);
    let mut seen: Vec<Option<f32>> = vec![None; groups.count];
    for (&v, &group) in used.iter().zip(&groups.of_vertex) {
        let known = &mut seen[group as usize];
        if (v as usize) < points.kept {
            let own = inside.reach[change.old_from_new[v as usize] as usize];
            match *known {
                None => *known = Some(own),
                Some(other) if (own > 0.0) != (other > 0.0) || (own < 0.0) != (other < 0.0) => return None,
                Some(_) => {}
            }
        }
    }
    let mut assigned = Vec::new();
    let mut fresh: Vec<Option<NewPart>> = seen
        .iter()
        .map(|s| {
            s.is_none().then(|| NewPart {
                triangles: Vec::new(),
                points: Vec::new(),
            })
        })
        .collect();
    for (&v, &group) in used.iter().zip(&groups.of_vertex) {
        match (seen[group as usize], &mut fresh[group as usize]) {
            (Some(reach), _) if v as usize >= points.kept => assigned.push((v, reach)),
            (None, Some(part)) => part.points.push(v),
            _ => {}
        }
    }
    for (face, t) in faces.iter().zip(&small) {
        if let Some(part) = &mut fresh[groups.of_vertex[t[0] as usize] as usize] {
            part.triangles.push(*face);
        }
    }
    Some((assigned, fresh.into_iter().flatten().collect()))
}

/// The mean edge length of a new part when it encloses space, else 0; `None` when only its winding number shows it.
fn enclosing_edge_length(change: &MeshChange, part: &NewPart, pool: &Pool) -> Option<f64> {
    let at = |v: u32| change.positions[v as usize];
    let mut length = 0.0;
    let mut passed: Vec<([u32; 2], i32)> = Vec::with_capacity(3 * part.triangles.len());
    for t in &part.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            length += at(a).distance(at(b));
            passed.push(([a.min(b), a.max(b)], if a < b { 1 } else { -1 }));
        }
    }
    let mean = length / passed.len() as f64;
    passed.sort_unstable();
    let (mut edges, mut open) = (0usize, 0usize);
    for edge in passed.chunk_by(|a, b| a.0 == b.0) {
        edges += 1;
        open += usize::from(edge.iter().map(|e| e.1).sum::<i32>() != 0);
    }
    if open == 0 {
        return Some(mean);
    }
    let tree = WindingTree::build(change.positions, &part.triangles, pool);
    let faces = sample((0..part.triangles.len() as u32).collect(), 1, |_| 0);
    let mut seen = (0.0, 0.0);
    for t in faces {
        let [a, b, c] = part.triangles[t as usize].map(at);
        if let Some(normal) = (b - a).cross(c - a).try_normalize() {
            let winding = tree.rough_winding_number((a + b + c) / 3.0 - normal * (mean * BESIDE));
            seen = (seen.0 + (winding - winding.round()).abs(), seen.1 + 1.0);
        }
    }
    match seen.1 > 0.0 && seen.0 <= OPEN * seen.1 {
        false => Some(0.0),
        true if open * SOUP > edges => None,
        true => Some(mean),
    }
}

/// The passages that enclosing parts lack after an edit. `None` when an edge of a point that is gone keeps a face, so
/// that the edit contradicts itself.
fn missing_passages(
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
    reach: &[f32],
) -> Option<Vec<[u32; 2]>> {
    let beyond = change.positions.len() as u32;
    let name = |old: u32| match points.new_from_old[old as usize] {
        NONE => beyond + old,
        new => new,
    };
    let mut passed: Vec<([u32; 2], i32)> = Vec::new();
    let mut pass = |a: u32, b: u32, times: i32| {
        passed.push(([a.min(b), a.max(b)], if a < b { times } else { -times }));
    };
    inside.open.iter().for_each(|&[a, b]| pass(name(a), name(b), -1));
    let mut face = |[a, b, c]: [u32; 3], times: i32| {
        pass(a, b, times);
        pass(b, c, times);
        pass(c, a, times);
    };
    let removed = change.removed.iter().filter(|t| inside.reach[t[0] as usize] != 0.0);
    removed.for_each(|t| face(t.map(name), -1));
    let added = change.added.iter().map(|&t| change.triangles[t as usize]);
    added.filter(|t| reach[t[0] as usize] != 0.0).for_each(|t| face(t, 1));
    passed.sort_unstable();
    let mut open = Vec::new();
    for edge in passed.chunk_by(|a, b| a.0 == b.0) {
        let sum: i32 = edge.iter().map(|e| e.1).sum();
        if sum != 0 && edge[0].0[1] >= beyond {
            return None;
        }
        open.extend(missing_of(edge[0].0, sum));
    }
    open.sort_unstable();
    Some(open)
}

/// The loops that sorted passages run in.
fn passage_loops(open: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let used: Vec<u32> = sorted_set(open.iter().flatten().copied());
    let local = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
    // Renumbering keeps the order, so the passages stay sorted.
    let small: Vec<[u32; 2]> = open.iter().map(|p| p.map(local)).collect();
    let rings = rings(used.len(), &small);
    rings
        .into_iter()
        .map(|ring| ring.into_iter().map(|v| used[v as usize]).collect())
        .collect()
}

/// Whether holes grew by much against the surface that they are in.
fn too_open(old: &GraphBefore<'_>, change: &MeshChange, hull: &HullChange) -> bool {
    let now = |v: u32| change.positions[v as usize];
    let before = |v: u32| old.positions[v as usize];
    let mut caps: Vec<(u32, f64)> = Vec::new();
    for ring in &hull.new_loops {
        let known = ring
            .iter()
            .map(|&v| change.old_from_new[v as usize])
            .find(|&o| o != NONE);
        caps.extend(known.map(|o| (old.component[o as usize], cap_area(ring, now))));
    }
    let lost = hull.lost_loops.iter();
    caps.extend(lost.map(|ring| (old.component[ring[0] as usize], -cap_area(ring, before))));
    caps.sort_by_key(|c| c.0);
    caps.chunk_by(|a, b| a.0 == b.0).any(|of_part| {
        let cap: f64 = of_part.iter().map(|c| c.1).sum();
        let part = of_part[0].0;
        let vertices = old.component[..old.surface].iter().filter(|&&c| c == part).count();
        // Two equilateral faces for each vertex.
        let edge = old.stats.shell_offset;
        cap > LARGEST_CAP * vertices as f64 * edge * edge * 0.866
    })
}

fn cap_area(ring: &[u32], at: impl Fn(u32) -> DVec3 + Copy) -> f64 {
    let (middle, edges) = fan_over_loop(ring, at);
    edges
        .map(|[a, b]| 0.5 * (at(a) - middle).cross(at(b) - middle).length())
        .sum()
}

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
        let asked: Vec<u32> = sorted_set(split.iter().flat_map(|c| c.iter().map(|k| k.1)));
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
                let groups: Vec<u32> = sorted_set(groups.filter(|g| active.binary_search(g).is_ok()));
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
