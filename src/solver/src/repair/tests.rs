//! What a built hierarchy promises, a repaired one keeps.

use crate::build::hierarchy::Hierarchy;
use crate::graph::WeightedGraph;
use crate::lanes::{NO_ROW, SLICE_ROWS};
use crate::options::{BuildOptions, Constraints, SolveMethod, SolveOptions};
use crate::repair::change::{GraphChange, RepairReport};
use crate::solve::group::{IterationReport, SolveControl, Workspace};
use crate::testing::{BoxLattice, pool};
use pliant_exec::Exec;
use pliant_exec::progress::Silent;

/// A graph that tests change: weights by pair of ids that never change, dead vertices left out of views.
pub(super) struct EditableRows {
    positions: Vec<[f64; 3]>,
    edges: std::collections::BTreeMap<(u32, u32), f32>,
    lives: Vec<bool>,
    weighted: bool,
}

/// A view of clay in dense numbers.
pub(super) struct RowsCast {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
    weights: Option<Vec<f32>>,
    pub(super) positions: Vec<[f64; 3]>,
    /// Dense number of each vertex ever.
    numbers: Vec<u32>,
}

impl RowsCast {
    pub(super) fn view(&self) -> WeightedGraph<'_> {
        WeightedGraph {
            offsets: &self.offsets,
            neighbours: &self.neighbours,
            weights: self.weights.as_deref(),
            positions: Some(&self.positions),
        }
    }
}

impl EditableRows {
    /// With weights of their own.
    pub(super) fn new(positions: Vec<[f64; 3]>, edges: std::collections::BTreeMap<(u32, u32), f32>) -> EditableRows {
        EditableRows {
            lives: vec![true; positions.len()],
            positions,
            edges,
            weighted: true,
        }
    }

    fn of(block: &BoxLattice) -> EditableRows {
        let mut edges = std::collections::BTreeMap::new();
        for i in 0..block.positions.len() {
            for e in block.offsets[i] as usize..block.offsets[i + 1] as usize {
                let w = block.weights.as_ref().map_or(1.0, |w| w[e]);
                edges.insert((i as u32, block.neighbours[e]), w);
            }
        }
        EditableRows {
            positions: block.positions.clone(),
            edges,
            lives: vec![true; block.positions.len()],
            weighted: block.weights.is_some(),
        }
    }

    pub(super) fn cast(&self) -> RowsCast {
        let mut numbers = vec![NO_ROW; self.lives.len()];
        let alive: Vec<usize> = (0..self.lives.len()).filter(|&i| self.lives[i]).collect();
        for (n, &i) in alive.iter().enumerate() {
            numbers[i] = n as u32;
        }
        let mut offsets = vec![0u32; alive.len() + 1];
        let (mut neighbours, mut weights) = (Vec::new(), Vec::new());
        for (&(a, b), &w) in &self.edges {
            offsets[numbers[a as usize] as usize + 1] += 1;
            neighbours.push(numbers[b as usize]);
            weights.push(w);
        }
        for i in 0..alive.len() {
            offsets[i + 1] += offsets[i];
        }
        RowsCast {
            offsets,
            neighbours,
            weights: self.weighted.then_some(weights),
            positions: alive.iter().map(|&i| self.positions[i]).collect(),
            numbers,
        }
    }

    fn distance(&self, i: usize, p: [f64; 3]) -> f64 {
        (0..3)
            .map(|c| (self.positions[i][c] - p[c]).powi(2))
            .sum::<f64>()
            .sqrt()
    }

    fn within(&self, p: [f64; 3], radius: f64) -> impl Iterator<Item = usize> + '_ {
        (0..self.lives.len()).filter(move |&i| self.lives[i] && self.distance(i, p) <= radius)
    }

    /// Deletes the vertices within `radius` of `p`.
    pub(super) fn bite(&mut self, p: [f64; 3], radius: f64) {
        for i in 0..self.lives.len() {
            self.lives[i] &= self.distance(i, p) > radius;
        }
        let lives = &self.lives;
        self.edges.retain(|&(a, b), _| lives[a as usize] && lives[b as usize]);
    }

    /// Adds a vertex at `p` with edges to all within `reach`.
    pub(super) fn grow(&mut self, p: [f64; 3], reach: f64) {
        let new = self.lives.len() as u32;
        let near: Vec<usize> = self.within(p, reach).collect();
        for i in near {
            let w = if self.weighted { 0.5 + (i % 7) as f32 } else { 1.0 };
            self.edges.insert((i as u32, new), w);
            self.edges.insert((new, i as u32), w);
        }
        self.positions.push(p);
        self.lives.push(true);
    }

    pub(super) fn disconnect(&mut self, p: [f64; 3]) {
        let near = (0..self.lives.len()).filter(|&i| self.lives[i]);
        let near = near.min_by(|&a, &b| self.distance(a, p).total_cmp(&self.distance(b, p)));
        if let Some(i) = near.map(|i| i as u32) {
            self.edges.retain(|&(a, b), _| a != i && b != i);
        }
    }
}

/// The change between two casts of one piece of clay.
pub(super) fn difference(before: &RowsCast, after: &RowsCast) -> (Vec<u32>, Vec<u32>) {
    let old: Vec<usize> = (0..before.numbers.len())
        .filter(|&i| before.numbers[i] != NO_ROW)
        .collect();
    let new_from_old: Vec<u32> = old.iter().map(|&i| after.numbers[i]).collect();
    let row = |cast: &RowsCast, v: usize, all: &[u32]| {
        let range = cast.offsets[v] as usize..cast.offsets[v + 1] as usize;
        let mut row: Vec<(u32, u32)> = range
            .map(|e| {
                let w = cast.weights.as_ref().map_or(1.0, |w| w[e]);
                (all[cast.neighbours[e] as usize], w.to_bits())
            })
            .collect();
        row.sort_unstable();
        row
    };
    let same: Vec<u32> = (0..after.positions.len() as u32).collect();
    let touched = (0..after.numbers.len())
        .filter(|&i| after.numbers[i] != NO_ROW)
        .filter(|&i| {
            let v = after.numbers[i] as usize;
            let Some(old) = before.numbers.get(i).filter(|o| **o != NO_ROW).map(|&o| o as usize) else {
                return true;
            };
            before.positions[old] != after.positions[v] || row(before, old, &new_from_old) != row(after, v, &same)
        });
    let touched = touched.map(|i| after.numbers[i]).collect();
    (new_from_old, touched)
}

/// Everything that a level promises.
pub(super) fn check_levels(hierarchy: &Hierarchy, graph: &WeightedGraph<'_>) {
    let n = graph.vertices();
    let mut row_of = vec![NO_ROW; n];
    assert_eq!(hierarchy.order.len(), hierarchy.levels[0].rows());
    for (row, &v) in hierarchy.order.iter().enumerate().filter(|(_, v)| **v != NO_ROW) {
        assert_eq!(std::mem::replace(&mut row_of[v as usize], row as u32), NO_ROW);
    }
    assert!(row_of.iter().all(|&r| r != NO_ROW), "every vertex has a row");
    let scale = hierarchy.weight_scale as f32;
    for v in 0..n {
        let mut want: Vec<(usize, f32)> = (graph.offsets[v] as usize..graph.offsets[v + 1] as usize)
            .map(|e| {
                let w = graph.weights.map_or(1.0, |w| w[e] * scale);
                (row_of[graph.neighbours[e] as usize] as usize, w)
            })
            .collect();
        let mut seen: Vec<(usize, f32)> = hierarchy.levels[0].row(row_of[v] as usize).collect();
        want.sort_by_key(|w| w.0);
        seen.sort_by_key(|w| w.0);
        assert_eq!(seen, want, "vertex {v}");
    }
    for (l, level) in hierarchy.levels.iter().enumerate() {
        let lives = |i: usize| match l {
            0 => hierarchy.order[i] != NO_ROW,
            _ => !hierarchy.levels[l - 1].members_of(i).is_empty(),
        };
        let rows = level.rows();
        assert_eq!(level.bundles.len() * SLICE_ROWS, rows);
        assert_eq!(level.occupied(), (0..rows).filter(|&i| lives(i)).count());
        assert_eq!(
            level.entries,
            level.bundles.iter().map(|b| (b.end - b.begin) as usize).sum::<usize>()
        );
        assert_eq!(level.positions.len(), if graph.positions.is_some() { rows } else { 0 });
        let mut spans: Vec<(u32, u32)> = level
            .bundles
            .iter()
            .map(|b| (b.begin, b.end))
            .filter(|s| s.0 < s.1)
            .collect();
        spans.sort_unstable();
        assert!(spans.windows(2).all(|s| s[0].1 <= s[1].0), "bundles share entries");

        let filling = level.filling() as usize;
        let block_of = |row: usize| level.blocks.partition_point(|&b| b as usize <= row) - 1;
        let colour_of = |row: usize| level.colours.partition_point(|&c| c as usize <= block_of(row)) - 1;
        assert_eq!(level.blocks[0], 0);
        assert!(level.blocks.is_sorted() && level.colours.is_sorted());
        assert_eq!(*level.colours.last().unwrap() as usize, level.blocks.len() - 1);
        let end = *level.blocks.last().unwrap() as usize;
        assert!(end == rows || (end == filling && filling + SLICE_ROWS == rows));
        for i in 0..rows {
            let (begin, middle, end) = level.slice_extent(i / SLICE_ROWS);
            let mut sum = 0.0f64;
            for e in (begin + i % SLICE_ROWS..end).step_by(SLICE_ROWS) {
                let j = level.neighbours[e] as usize;
                if j == filling {
                    assert_eq!(level.weights.as_ref().map_or(0.0, |w| w[e]), 0.0);
                    continue;
                }
                sum += f64::from(level.weight(e));
                assert!(lives(i) && lives(j), "level {l} row {i} to {j}");
                assert_eq!(j < i, e < middle, "on the right side");
                assert_ne!(i / SLICE_ROWS, j / SLICE_ROWS, "adjacent rows in one bundle");
                assert!(block_of(i) == block_of(j) || colour_of(i) != colour_of(j));
                let back: Vec<f32> = level.row(j).filter(|b| b.0 == i).map(|b| b.1).collect();
                assert_eq!(back.len(), 1, "level {l}: one edge between {i} and {j}");
                assert_eq!(back[0].to_bits(), level.weight(e).to_bits());
            }
            assert!((sum - f64::from(level.diagonal[i])).abs() <= 1e-6 * sum);
            assert_eq!(level.connected(i), sum > 0.0);
        }
        let Some(next) = hierarchy.levels.get(l + 1) else {
            assert!(level.aggregates.is_empty() && level.occupied() <= hierarchy.options.coarsest);
            continue;
        };
        assert_eq!(level.aggregates.len(), rows);
        assert_eq!(level.coarse_rows(), next.rows());
        let mut seen = vec![false; rows];
        for a in 0..next.rows() {
            let members = level.members_of(a);
            for &i in members {
                assert_eq!(level.aggregates[i as usize], a as u32);
                assert!(!std::mem::replace(&mut seen[i as usize], true));
                let tied = level.row(i as usize).any(|(j, _)| members.contains(&(j as u32)));
                assert!(members.len() == 1 || tied, "members of {a} hang together");
            }
            if !level.positions.is_empty() && !members.is_empty() {
                for c in 0..3 {
                    let sum: f32 = members.iter().map(|&i| level.positions[i as usize].0[c]).sum();
                    assert!((next.positions[a].0[c] - sum / members.len() as f32).abs() < 1e-5);
                }
            }
            for (b, w) in next.row(a) {
                let crossing = members.iter().flat_map(|&i| level.row(i as usize));
                let crossing = crossing.filter(|&(j, _)| level.aggregates[j] as usize == b);
                let ratio = w / crossing.map(|e| e.1).sum::<f32>();
                assert!((0.2999..=1.0001).contains(&ratio), "level {l}, {a} to {b}: {ratio}");
            }
        }
        for i in 0..rows {
            assert_eq!(seen[i], level.connected(i), "level {l} row {i}");
            assert_eq!(seen[i], level.aggregates[i] != NO_ROW);
        }
    }
}

fn repair(hierarchy: &mut Hierarchy, before: &RowsCast, after: &RowsCast) -> RepairReport {
    let (new_from_old, touched) = difference(before, after);
    let change = GraphChange {
        new_from_old: &new_from_old,
        touched: &touched,
    };
    after.view().check().unwrap();
    hierarchy
        .repair_above(60, &after.view(), &change, &Exec::new(&pool(), &Silent))
        .unwrap()
}

fn run(block: BoxLattice) {
    let mut clay = EditableRows::of(&block);
    let mut before = clay.cast();
    let mut hierarchy = Hierarchy::build(&before.view(), &Default::default(), &Exec::new(&pool(), &Silent)).unwrap();
    check_levels(&hierarchy, &before.view());
    let mut repaired = 0;
    for step in 0..14 {
        let p = [5.0 + f64::from(step % 5) * 3.0, 4.0 + f64::from(step % 3) * 4.0, 9.0];
        match step % 7 {
            0 => clay.bite(p, 2.2),
            1 => clay.grow([p[0] + 0.5, p[1] + 0.4, p[2] + 0.3], 1.6),
            2 => clay.positions[1000 + step as usize][0] += 0.3,
            3 => {}
            4 => (0..6).for_each(|k| clay.grow([p[0], p[1], 18.0 + 0.5 * f64::from(k)], 1.7)),
            5 => clay.disconnect(p),
            _ => {
                clay.bite(p, 1.2);
                clay.grow(p, 2.5);
            }
        }
        let after = clay.cast();
        let report = repair(&mut hierarchy, &before, &after);
        repaired += usize::from(!report.rebuilt);
        check_levels(&hierarchy, &after.view());
        before = after;
    }
    assert_eq!(repaired, 14);
    converges(&hierarchy, &before);
}

#[test]
fn levels_keep_their_promises() {
    run(BoxLattice::new(20, 18, 18));
}

#[test]
fn weighted_levels_keep_their_promises() {
    run(BoxLattice::new(20, 18, 18).weighted());
}

/// Iterations to 1e-6 with the lowest vertices along x held at 0 and the highest at 1.
fn iterations(hierarchy: &Hierarchy, cast: &RowsCast) -> usize {
    let along = |p: &[f64; 3]| p[0];
    let low = cast.positions.iter().map(along).fold(f64::MAX, f64::min);
    let high = cast.positions.iter().map(along).fold(f64::MIN, f64::max);
    let ends = |p: &[f64; 3]| (p[0] < low + 0.9, p[0] > high - 0.9);
    let fixed: Vec<bool> = cast.positions.iter().map(ends).map(|(a, b)| a || b).collect();
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: None,
    };
    let system = hierarchy.constrain(&constraints, &pool()).unwrap();
    let mut x: Vec<f64> = cast.positions.iter().map(|p| f64::from(u8::from(ends(p).1))).collect();
    let rhs = vec![0.0; x.len()];
    let options = SolveOptions {
        tolerance: Some(1e-6),
        ..SolveOptions::default()
    };
    let mut watch = |_: &IterationReport<'_>| SolveControl::Continue;
    let mut workspace = Workspace::default();
    let stats = system.equations(hierarchy, 1, &rhs).solve(
        &mut x,
        &options,
        &mut workspace,
        &Exec::new(&pool(), &Silent),
        &mut watch,
    );
    let stats = stats.unwrap();
    assert!(stats.converged && stats.method == SolveMethod::Multigrid, "{stats:?}");
    stats.iterations
}

fn converges(hierarchy: &Hierarchy, cast: &RowsCast) {
    let fresh = Hierarchy::build(&cast.view(), &hierarchy.options, &Exec::new(&pool(), &Silent)).unwrap();
    let (seen, want) = (iterations(hierarchy, cast), iterations(&fresh, cast));
    assert!(seen <= want + 1, "{seen} iterations, {want} after a build");
    let ratio = hierarchy.levels[1].occupied() as f64 / fresh.levels[1].occupied() as f64;
    assert!(
        (0.8..1.25).contains(&ratio),
        "{ratio} of the coarse vertices of a build"
    );
}

/// Deletes and fills holes at the places that `place` names; every level is repaired, down to small ones.
fn holes(block: BoxLattice, edits: u32, place: impl Fn(u32) -> [f64; 3]) -> Hierarchy {
    let mut clay = EditableRows::of(&block);
    let mut before = clay.cast();
    let options = BuildOptions {
        coarsest: 20,
        ..BuildOptions::default()
    };
    let mut hierarchy = Hierarchy::build(&before.view(), &options, &Exec::new(&pool(), &Silent)).unwrap();
    for step in 1..=edits {
        let p = place(step);
        let filled: Vec<[f64; 3]> = clay.within(p, 1.9).map(|i| clay.positions[i]).collect();
        clay.bite(p, 1.9);
        for (k, q) in (0..).zip(filled) {
            let shift = |c: u32| f64::from((step * 7 + k * 5 + c * 3) % 11) / 40.0 - 0.125;
            clay.grow([q[0] + shift(0), q[1] + shift(1), q[2]], 1.8);
        }
        let after = clay.cast();
        assert!(!repair(&mut hierarchy, &before, &after).rebuilt);
        before = after;
        if step % 25 == 0 {
            check_levels(&hierarchy, &before.view());
            converges(&hierarchy, &before);
        }
    }
    hierarchy
}

#[test]
fn hundreds_of_edits_leave_a_sound_hierarchy() {
    let anywhere = |k: u32| [f64::from(k * 37 % 16), f64::from(k * 53 % 14), f64::from(k * 29 % 13)];
    holes(BoxLattice::new(16, 14, 13).weighted(), 200, anywhere);
}

#[test]
fn hundreds_of_edits_leave_a_sound_sheet() {
    let anywhere = |k: u32| [f64::from(k * 37 % 60), f64::from(k * 53 % 40), 0.0];
    holes(BoxLattice::new(60, 40, 1), 200, anywhere);
}

#[test]
fn a_place_can_be_edited_forever() {
    let hierarchy = holes(BoxLattice::new(16, 14, 13), 150, |_| [8.0, 7.0, 6.0]);
    for level in &hierarchy.levels {
        assert!(level.rows() <= 2 * level.occupied() + 512 + 64, "no level wastes more");
        assert!(level.neighbours.len() <= 2 * level.entries + 8192);
    }
}

#[test]
fn wear_is_seen() {
    let mut hierarchy = BoxLattice::new(20, 18, 18).hierarchy(100);
    let cast = EditableRows::of(&BoxLattice::new(20, 18, 18)).cast();
    let same: Vec<u32> = (0..cast.positions.len() as u32).collect();
    let mut repairs = 0;
    while !hierarchy.is_worn() {
        let touched: Vec<u32> = (repairs * 200..repairs * 200 + 200).collect();
        let change = GraphChange {
            new_from_old: &same,
            touched: &touched,
        };
        hierarchy
            .repair(&cast.view(), &change, &Exec::new(&pool(), &Silent))
            .unwrap();
        repairs += 1;
    }
    assert!((3..=8).contains(&repairs), "after {repairs} of 200 in 6480 vertices");
    check_levels(&hierarchy, &cast.view());
}

#[test]
fn numbers_may_change_in_any_order() {
    // Vertices trade numbers in a way that does not rise, at places where parts of the map meet.
    let block = BoxLattice::new(20, 18, 18);
    let n = block.positions.len();
    for (a, b) in [(63, 64), (127, 191), (0, n - 1), (640, 703), (200, 4000)] {
        let mut map: Vec<u32> = (0..n as u32).collect();
        map.swap(a, b);
        let mut order: Vec<usize> = (0..n).collect();
        order.swap(a, b);
        let mut graph = RowsCast {
            offsets: vec![0],
            neighbours: Vec::new(),
            weights: None,
            positions: order.iter().map(|&i| block.positions[i]).collect(),
            numbers: Vec::new(),
        };
        for &i in &order {
            let row = &block.neighbours[block.offsets[i] as usize..block.offsets[i + 1] as usize];
            let mut row: Vec<u32> = row.iter().map(|&j| map[j as usize]).collect();
            row.sort_unstable();
            graph.neighbours.extend(row);
            graph.offsets.push(graph.neighbours.len() as u32);
        }
        let mut hierarchy = block.hierarchy(100);
        let change = GraphChange {
            new_from_old: &map,
            touched: &[5, 6000],
        };
        let report = hierarchy
            .repair(&graph.view(), &change, &Exec::new(&pool(), &Silent))
            .unwrap();
        assert!(!report.rebuilt);
        check_levels(&hierarchy, &graph.view());
        map[a] = map[b];
        let change = GraphChange {
            new_from_old: &map,
            touched: &[5],
        };
        let error = block
            .hierarchy(100)
            .repair(&graph.view(), &change, &Exec::new(&pool(), &Silent))
            .unwrap_err();
        assert!(error.to_string().contains("so does another one"), "{error}");
    }
}
