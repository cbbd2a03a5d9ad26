//! Reading a change: which rows of the finest level it moves, and whether it is consistent.

use crate::build::draft::{LevelDraft, along_curve, breadth_first};
use crate::build::hierarchy::{Hierarchy, block_size};
use crate::build::level::HierarchyLevel;
use crate::error::Error;
use crate::graph::WeightedGraph;
use crate::lanes::{Lanes, NO_ROW};
use crate::repair::marks::MarkedRows;
use crate::threads::{Parallelism, piece_count, piece_rows};
use std::ops::Range;

/// Rows that one piece of work handles.
const PIECE: usize = 1 << 14;
/// Scaled weights above this one lie too far from 1 for the scale that the hierarchy has.
const HEAVIEST: f32 = 65536.0;

/// What a topology change does to the vertices of a graph.
#[derive(Debug, Clone, Copy)]
pub struct GraphChange<'a> {
    /// For each vertex of the old graph its number in the new one, `u32::MAX` if it is gone. No two have the same.
    pub new_from_old: &'a [u32],
    /// Vertices of the new graph, rising: all that are new, and all whose neighbours, weights or position are not what
    /// they were. A new number of a neighbour is not a change. Positions of other vertices are not read.
    pub touched: &'a [u32],
}

/// What a repair did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RepairReport {
    /// True if the hierarchy was rebuilt: more than a quarter of the vertices was touched or deleted, or the graph is
    /// small, or its change cannot be followed.
    pub rebuilt: bool,
    /// Vertices with new places, on all levels that were not rebuilt.
    pub moved: usize,
}

/// True if a change of `rows` rows of `all` is not worth following.
fn is_large(rows: usize, all: usize) -> bool {
    4 * rows > all
}

/// Rows of one level that come, move or change, and have no place yet.
#[derive(Debug)]
pub(super) struct TouchedRows {
    /// In the order in which they are to be placed; neighbours that stay are foreign.
    pub(super) draft: LevelDraft,
    /// The rows of the level that foreign neighbours stand for.
    pub(super) foreign: Vec<u32>,
    /// The row that each of the draft has been, or [`NO_ROW`].
    pub(super) origins: Vec<u32>,
    /// Rows of the level that leave their places, rising.
    pub(super) dead: Vec<u32>,
    /// For each row of the draft the number of what it stands for: touched vertex or group.
    pub(super) sequence: Vec<u32>,
}

/// What a change does to the finest level.
pub(super) struct RepairPlan {
    pub(super) touched: TouchedRows,
    /// The vertex of each row of the draft.
    pub(super) vertices: Vec<u32>,
    /// The new vertex of each present row; [`NO_ROW`] for those that leave.
    pub(super) order: Vec<u32>,
}

/// Reads `change`. `None` if a rebuild is better than a repair.
///
/// # Errors
/// [`Error::Invalid`] if the parts that are read contradict each other.
pub(super) fn read_change(
    hierarchy: &Hierarchy,
    graph: &WeightedGraph<'_>,
    change: &GraphChange<'_>,
    threads: Parallelism,
) -> Result<Option<RepairPlan>, Error> {
    let (level, touched) = (&hierarchy.levels[0], change.touched);
    check_map(hierarchy, graph, change, threads)?;
    graph.check_some(touched)?;
    let scale = hierarchy.weight_scale as f32;
    let same_kind = graph.weights.is_some() == level.weights.is_some()
        && (graph.vertices() == 0 || graph.positions.is_some() != level.positions.is_empty());
    if !same_kind {
        return Ok(None);
    }
    let mut surroundings = TouchedSurroundings::new(*graph, touched, scale);
    if surroundings.has_too_heavy_edge() {
        return Ok(None);
    }
    surroundings.mark_vertices();
    let Some(located) = surroundings.locate_rows(hierarchy, change.new_from_old, threads)? else {
        return Ok(None);
    };
    let present = |v: u32| surroundings.edges_outside(&located, v);
    let LocatedRows { gone, origins, .. } = &located;
    check_border(level, touched, gone, origins, present, &located.order)?;

    // Into the order in which they are to be placed.
    let positions: Vec<Lanes> = match graph.positions {
        Some(p) => touched.iter().map(|&v| hierarchy.frame.apply(p[v as usize])).collect(),
        None => Vec::new(),
    };
    let sequence = match graph.positions {
        Some(_) => along_curve(&positions, threads),
        None => sequence_of(touched, &surroundings.own, |v| {
            &graph.neighbours[surroundings.entries(v)]
        }),
    };
    let (draft, foreign) = surroundings.draft_rows(&located, &sequence, &positions);
    let of_sequence = |all: &[u32]| sequence.iter().map(|&k| all[k as usize]).collect();
    let (origins, vertices) = (of_sequence(&located.origins), of_sequence(touched));
    let mut dead = located.gone;
    dead.extend(located.origins.iter().filter(|&&row| row != NO_ROW));
    dead.sort_unstable();
    Ok(Some(RepairPlan {
        touched: TouchedRows {
            draft,
            foreign,
            origins,
            dead,
            sequence,
        },
        vertices,
        order: located.order,
    }))
}

/// The touched vertices of the new graph and their neighbours.
struct TouchedSurroundings<'a> {
    graph: WeightedGraph<'a>,
    touched: &'a [u32],
    /// Factor on weights.
    scale: f32,
    /// The touched vertices.
    own: MarkedRows,
    /// Neighbours of touched vertices that are not touched.
    near: MarkedRows,
    /// Both.
    any: MarkedRows,
}

/// Where touched vertices and their neighbours were before the change.
struct LocatedRows {
    /// The new vertex of each present row; [`NO_ROW`] for those that leave.
    order: Vec<u32>,
    /// Rows whose vertices are gone.
    gone: Vec<u32>,
    /// The row of each touched vertex, or [`NO_ROW`].
    origins: Vec<u32>,
    /// The row of each neighbour that is not touched, by its rank in [`TouchedSurroundings::near`].
    near_rows: Vec<u32>,
}

impl<'a> TouchedSurroundings<'a> {
    /// Knows no neighbours yet.
    fn new(graph: WeightedGraph<'a>, touched: &'a [u32], scale: f32) -> Self {
        let none = || MarkedRows::new(graph.vertices());
        Self {
            graph,
            touched,
            scale,
            own: none(),
            near: none(),
            any: none(),
        }
    }

    /// Entries of a vertex in the graph.
    fn entries(&self, v: u32) -> Range<usize> {
        self.graph.offsets[v as usize] as usize..self.graph.offsets[v as usize + 1] as usize
    }

    /// Scaled weight of an entry.
    fn weight(&self, entry: usize) -> f32 {
        self.graph.weights.map_or(1.0, |w| w[entry] * self.scale)
    }

    fn has_too_heavy_edge(&self) -> bool {
        let is_heavy = |v: &u32| self.entries(*v).any(|e| self.weight(e) > HEAVIEST);
        self.touched.iter().any(is_heavy)
    }

    fn mark_vertices(&mut self) {
        for &v in self.touched {
            self.own.insert(v);
        }
        self.own.count();
        self.any.clone_from(&self.own);
        for &v in self.touched {
            for &j in &self.graph.neighbours[self.entries(v)] {
                if self.any.insert(j) {
                    self.near.insert(j);
                }
            }
        }
        self.near.count();
    }

    /// Finds the rows of all vertices that matter. `None` if the change is large.
    fn locate_rows(
        &self,
        hierarchy: &Hierarchy,
        new_from_old: &[u32],
        threads: Parallelism,
    ) -> Result<Option<LocatedRows>, Error> {
        let (n, touched) = (self.graph.vertices(), self.touched.len());
        let (order, found) = renumber_rows(&hierarchy.order, new_from_old, &self.own, &self.any, threads);
        let mut located = LocatedRows {
            order,
            gone: Vec::new(),
            origins: vec![NO_ROW; touched],
            near_rows: vec![NO_ROW; self.near.iter().count()],
        };
        let mut left = 0;
        for found in found {
            left += found.left;
            located.gone.extend(found.gone);
            for (v, row) in found.own {
                located.origins[self.own.rank(v)] = row;
            }
            for (v, row) in found.near {
                located.near_rows[self.near.rank(v)] = row;
            }
        }
        if is_large(touched + located.gone.len(), n.max(hierarchy.levels[0].occupied())) {
            return Ok(None);
        }
        let new = located.origins.iter().filter(|&&row| row == NO_ROW).count();
        if left + new != n {
            return Err(Error::Invalid(format!(
                "of {n} vertices {left} were there before and {new} of the touched ones were not: all new vertices must \
                 be among the touched ones"
            )));
        }
        Ok(Some(located))
    }

    /// Edges of a touched vertex to neighbours that are not touched, as (row, weight).
    fn edges_outside(&self, located: &LocatedRows, v: u32) -> Vec<(u32, f32)> {
        let outside = self
            .entries(v)
            .filter(|&e| !self.own.contains(self.graph.neighbours[e]));
        let edge = |e: usize| (self.near_row(located, self.graph.neighbours[e]), self.weight(e));
        outside.map(edge).collect()
    }

    fn near_row(&self, located: &LocatedRows, v: u32) -> u32 {
        located.near_rows[self.near.rank(v)]
    }

    /// The rows of the touched vertices in the order of `sequence`, and the rows that their foreign neighbours stand for.
    fn draft_rows(&self, located: &LocatedRows, sequence: &[u32], positions: &[Lanes]) -> (LevelDraft, Vec<u32>) {
        let mut places = vec![0u32; self.touched.len()];
        for (place, &k) in (0..).zip(sequence) {
            places[k as usize] = place;
        }
        let padded = self.touched.len().next_multiple_of(block_size(0));
        let mut draft = LevelDraft {
            offsets: vec![0],
            weights: self.graph.weights.map(|_| Vec::new()),
            ..LevelDraft::default()
        };
        let mut foreign = Vec::new();
        for &k in sequence {
            for e in self.entries(self.touched[k as usize]) {
                let j = self.graph.neighbours[e];
                draft.neighbours.push(if self.own.contains(j) {
                    places[self.own.rank(j)]
                } else {
                    foreign.push(self.near_row(located, j));
                    (padded + foreign.len() - 1) as u32
                });
                if let Some(w) = &mut draft.weights {
                    w.push(self.weight(e));
                }
            }
            draft.offsets.push(draft.neighbours.len() as u32);
            draft.positions.extend(positions.get(k as usize));
        }
        (draft, foreign)
    }
}

/// Checks lengths and ranges, and that no two old vertices become one.
fn check_map(
    hierarchy: &Hierarchy,
    graph: &WeightedGraph<'_>,
    change: &GraphChange<'_>,
    threads: Parallelism,
) -> Result<(), Error> {
    let (n, before) = (graph.vertices(), hierarchy.vertices());
    let GraphChange { new_from_old, touched } = *change;
    if new_from_old.len() != before {
        let seen = new_from_old.len();
        return Err(Error::Invalid(format!(
            "the change maps {seen} old vertices, there were {before}"
        )));
    }
    if let Some(k) = (1..touched.len()).find(|&k| touched[k - 1] >= touched[k]) {
        return Err(Error::Invalid(format!(
            "touched vertices must rise, but {} is followed by {}",
            touched[k - 1],
            touched[k]
        )));
    }
    if let Some(&v) = touched.last().filter(|&&v| v as usize >= n) {
        return Err(Error::Invalid(format!("touched vertex {v} is not one of {n} vertices")));
    }
    // Old vertices mostly keep their order, and then it shows that no two become one.
    let ends = threads.for_rows(before).map(
        0..piece_count(before, PIECE),
        || (),
        |(), k| rising_ends(&new_from_old[piece_rows(k, before, PIECE)]),
    );
    let mut last = None;
    let rising = ends.iter().all(|ends| match *ends {
        Some((first, end)) => {
            let rises = first == NO_ROW || last.is_none_or(|last| first > last);
            last = if first == NO_ROW { last } else { Some(end) };
            rises
        }
        None => false,
    });
    if rising && last.is_none_or(|last| (last as usize) < n) {
        return Ok(());
    }
    let mut seen = MarkedRows::new(n);
    for (old, &v) in new_from_old.iter().enumerate().filter(|(_, v)| **v != NO_ROW) {
        if v as usize >= n {
            return Err(Error::Invalid(format!(
                "old vertex {old} becomes {v}, which is not one of {n} vertices"
            )));
        }
        if !seen.insert(v) {
            return Err(Error::Invalid(format!(
                "old vertex {old} becomes {v}, and so does another one"
            )));
        }
    }
    Ok(())
}

/// The first and the last number of `map` that is not [`NO_ROW`], which stands for both where there is none; `None` unless
/// these numbers rise.
fn rising_ends(map: &[u32]) -> Option<(u32, u32)> {
    const STEP: usize = 64;
    let (mut first, mut last) = (NO_ROW, NO_ROW);
    for part in map.chunks(STEP) {
        // Most parts rise all the way, which is seen without a branch per number.
        let rises = part.iter().zip(&part[1..]).fold(true, |r, (a, b)| r & (a < b));
        let all = rises && part[part.len() - 1] != NO_ROW;
        let own = |v: &&u32| **v != NO_ROW;
        let rest = if all { &part[part.len() - 1..] } else { part };
        if all && last != NO_ROW && part[0] <= last {
            return None;
        }
        if first == NO_ROW {
            first = part.iter().find(own).copied().unwrap_or(NO_ROW);
        }
        for &v in rest.iter().filter(own) {
            if last != NO_ROW && v <= last {
                return None;
            }
            last = v;
        }
    }
    Some((first, last))
}

/// Rows of one piece that concern the change.
struct RenumberedPiece {
    /// Rows whose vertices are gone.
    gone: Vec<u32>,
    /// Touched vertices and their rows.
    own: Vec<(u32, u32)>,
    /// Untouched neighbours of touched vertices and their rows.
    near: Vec<(u32, u32)>,
    /// Vertices that are not gone.
    left: usize,
}

/// The one pass over all rows: their new vertices, and the rows of the vertices that matter, `any`: touched ones, which
/// are `own`, and their neighbours.
fn renumber_rows(
    order: &[u32],
    new_from_old: &[u32],
    own: &MarkedRows,
    any: &MarkedRows,
    threads: Parallelism,
) -> (Vec<u32>, Vec<RenumberedPiece>) {
    let n = order.len();
    let mut next = vec![0u32; n];
    let found = threads.for_rows(n).map_pieces(
        PIECE,
        next.as_mut_slice(),
        || (),
        |(), first, next| {
            let mut found = RenumberedPiece {
                gone: Vec::new(),
                own: Vec::new(),
                near: Vec::new(),
                left: 0,
            };
            for (row, out) in (first..).zip(next) {
                let old = order[row];
                *out = NO_ROW;
                if old == NO_ROW {
                    continue;
                }
                let v = new_from_old[old as usize];
                if v == NO_ROW {
                    found.gone.push(row as u32);
                    continue;
                }
                found.left += 1;
                if any.contains(v) && own.contains(v) {
                    found.own.push((v, row as u32));
                    continue;
                }
                *out = v;
                if any.contains(v) {
                    found.near.push((v, row as u32));
                }
            }
            found
        },
    );
    (next, found)
}

/// Checks that untouched vertices keep their edges: their edges with rows that leave their places must be those that
/// the touched vertices have.
///
/// `gone` are the rows of deleted vertices, `origins` those that the touched vertices had, `present` the untouched
/// neighbours of each touched vertex, as (row, weight); `order` has the new numbers.
fn check_border(
    level: &HierarchyLevel,
    touched: &[u32],
    gone: &[u32],
    origins: &[u32],
    present: impl Fn(u32) -> Vec<(u32, f32)>,
    order: &[u32],
) -> Result<(), Error> {
    let stays = |row: usize| order[row] != NO_ROW;
    let changed = |row: u32, to: &str| {
        let vertex = order.get(row as usize).copied().unwrap_or(NO_ROW);
        Err(Error::Invalid(format!(
            "vertex {vertex} is not among the touched ones, but its edge to {to} is not what it was"
        )))
    };
    for &row in gone {
        if let Some((j, _)) = level.row(row as usize).find(|&(j, _)| stays(j)) {
            return changed(j as u32, "a vertex that is gone");
        }
    }
    let sorted = |mut edges: Vec<(u32, f32)>| {
        edges.sort_unstable_by_key(|e| e.0);
        edges
    };
    for (&v, &origin) in touched.iter().zip(origins) {
        let now = sorted(present(v));
        let before = match origin {
            NO_ROW => Vec::new(),
            row => sorted(
                level
                    .row(row as usize)
                    .filter(|&(j, _)| stays(j))
                    .map(|(j, w)| (j as u32, w))
                    .collect(),
            ),
        };
        if now != before {
            let other = now.iter().zip(&before).find(|(a, b)| a != b).map(|(a, b)| a.0.min(b.0));
            let longer = now.get(before.len()).or(before.get(now.len())).map(|e| e.0);
            let row = other.or(longer).unwrap_or(NO_ROW);
            return changed(row, &format!("vertex {v}"));
        }
    }
    Ok(())
}

/// Breadth first through the touched vertices; positions among them.
fn sequence_of<'g>(touched: &[u32], own: &MarkedRows, row: impl Fn(u32) -> &'g [u32]) -> Vec<u32> {
    let (mut offsets, mut neighbours) = (vec![0], Vec::new());
    for &v in touched {
        let inside = row(v).iter().filter(|&&j| own.contains(j));
        neighbours.extend(inside.map(|&j| own.rank(j) as u32));
        offsets.push(neighbours.len() as u32);
    }
    breadth_first(&offsets, &neighbours)
}
