//! Graphs that change, and what a change of them is in the solver's terms.

use pliant_solver::GraphChange;

use super::graphs::{SplitMix, TestGraph};

/// No vertex.
const NONE: u32 = u32::MAX;

/// A graph whose vertices come and go. Vertices have kinds, and dense numbers go by kind first: what is new stands
/// between old vertices.
#[derive(Clone)]
pub struct EditableGraph {
    positions: Vec<[f64; 3]>,
    rows: Vec<Vec<(u32, f32)>>,
    kinds: Vec<u8>,
    lives: Vec<bool>,
    /// Changed since the last cast.
    dirty: Vec<bool>,
    weighted: bool,
    random: SplitMix,
}

/// A graph in dense numbers, and the change that led to it.
pub struct EditedGraph {
    pub graph: TestGraph,
    pub new_from_old: Vec<u32>,
    pub touched: Vec<u32>,
    /// Clay's vertex of each dense one.
    pub ids: Vec<u32>,
}

impl EditedGraph {
    pub fn change(&self) -> GraphChange<'_> {
        GraphChange {
            new_from_old: &self.new_from_old,
            touched: &self.touched,
        }
    }
}

impl EditableGraph {
    pub fn new(graph: &TestGraph, weighted: bool, seed: u64) -> EditableGraph {
        let n = graph.len();
        EditableGraph {
            positions: graph.positions.clone(),
            rows: (0..n)
                .map(|i| graph.row(i).map(|(j, w)| (j as u32, w as f32)).collect())
                .collect(),
            kinds: (0..n).map(|i| u8::from(2 * i > n)).collect(),
            lives: vec![true; n],
            dirty: vec![false; n],
            weighted,
            random: SplitMix::new(seed),
        }
    }

    /// The present graph; `before` holds the vertices of the last one in its dense order.
    pub fn cast(&mut self, before: &[u32]) -> EditedGraph {
        let mut ids: Vec<u32> = (0..self.lives.len() as u32)
            .filter(|&i| self.lives[i as usize])
            .collect();
        ids.sort_by_key(|&i| self.kinds[i as usize]);
        let mut numbers = vec![NONE; self.lives.len()];
        for (number, &i) in (0..).zip(&ids) {
            numbers[i as usize] = number;
        }
        let mut edges: Vec<(u32, u32, f32)> = Vec::new();
        for &i in &ids {
            let row = self.rows[i as usize].iter();
            edges.extend(row.map(|&(j, w)| (numbers[i as usize], numbers[j as usize], w)));
        }
        edges.sort_unstable_by_key(|e| (e.0, e.1));
        let positions = ids.iter().map(|&i| self.positions[i as usize]).collect();
        let one_way = edges.iter().filter(|e| e.0 < e.1).map(|e| (e.0, e.1)).collect();
        let mut graph = TestGraph::from_edges(positions, one_way);
        if self.weighted {
            graph = graph.with_weights(edges.iter().map(|e| e.2).collect());
        }
        let touched = ids.iter().filter(|&&i| self.dirty[i as usize]);
        let cast = EditedGraph {
            graph,
            new_from_old: before.iter().map(|&i| numbers[i as usize]).collect(),
            touched: touched.map(|&i| numbers[i as usize]).collect(),
            ids: ids.clone(),
        };
        self.dirty.fill(false);
        cast
    }

    fn within(&self, p: [f64; 3], radius: f64) -> Vec<u32> {
        let near = |i: usize| (0..3).map(|c| (self.positions[i][c] - p[c]).powi(2)).sum::<f64>() <= radius * radius;
        (0..self.lives.len())
            .filter(|&i| self.lives[i] && near(i))
            .map(|i| i as u32)
            .collect()
    }

    fn join(&mut self, a: u32, b: u32) {
        if a == b || self.rows[a as usize].iter().any(|e| e.0 == b) {
            return;
        }
        let w = if self.weighted {
            0.3 + 3.0 * self.random.unit() as f32
        } else {
            1.0
        };
        for (a, b) in [(a, b), (b, a)] {
            self.rows[a as usize].push((b, w));
            self.dirty[a as usize] = true;
        }
    }

    fn part(&mut self, a: u32, b: u32) {
        for (a, b) in [(a, b), (b, a)] {
            self.rows[a as usize].retain(|e| e.0 != b);
            self.dirty[a as usize] = true;
        }
    }

    fn remove(&mut self, i: u32) {
        for (j, _) in self.rows[i as usize].clone() {
            self.part(i, j);
        }
        self.lives[i as usize] = false;
    }

    fn add(&mut self, p: [f64; 3], reach: f64, most: usize) {
        let mut near = self.within(p, reach);
        let length = |i: u32| {
            (0..3)
                .map(|c| (self.positions[i as usize][c] - p[c]).powi(2))
                .sum::<f64>()
        };
        near.sort_by(|&a, &b| length(a).total_cmp(&length(b)));
        near.truncate(most);
        let new = self.lives.len() as u32;
        self.positions.push(p);
        self.rows.push(Vec::new());
        self.kinds.push(u8::from(self.random.unit() > 0.5));
        self.lives.push(true);
        self.dirty.push(true);
        for j in near {
            self.join(new, j);
        }
    }

    /// Any vertex.
    fn any(&mut self) -> u32 {
        loop {
            let i = (self.random.unit() * self.lives.len() as f64) as usize;
            if self.lives[i] {
                return i as u32;
            }
        }
    }

    /// A local edit of a random kind around a random vertex: a hole, a lump, a hole filled again, edges that change,
    /// vertices that move. New vertices get up to `degree` neighbours.
    pub fn edit(&mut self, degree: usize) {
        let at = self.any();
        let p = self.positions[at as usize];
        let shifted = |random: &mut SplitMix, p: [f64; 3], by: f64| p.map(|c| c + by * (2.0 * random.unit() - 1.0));
        match (5.0 * self.random.unit()) as u32 {
            0 => {
                let radius = 0.8 + 2.0 * self.random.unit();
                self.within(p, radius).into_iter().for_each(|i| self.remove(i));
            }
            1 => {
                for _ in 0..(4.0 + 20.0 * self.random.unit()) as usize {
                    let q = shifted(&mut self.random, p, 1.5);
                    self.add(q, 1.7, degree);
                }
            }
            2 => {
                let radius = 0.8 + 2.2 * self.random.unit();
                let gone = self.within(p, radius);
                gone.iter().for_each(|&i| self.remove(i));
                for i in gone {
                    let q = shifted(&mut self.random, self.positions[i as usize], 0.2);
                    self.add(q, 1.7, degree);
                }
            }
            3 => {
                let near = self.within(p, 1.9);
                for _ in 0..near.len() {
                    let mut pick = || near[(self.random.unit() * near.len() as f64) as usize];
                    let (a, b) = (pick(), pick());
                    self.part(a, b);
                    let (c, d) = (near[0], near[near.len() / 2]);
                    self.join(c, d);
                    if self.rows[a as usize].len() < 3 {
                        self.join(a, b);
                    }
                }
            }
            _ => {
                for i in self.within(p, 2.5) {
                    self.positions[i as usize] = shifted(&mut self.random, self.positions[i as usize], 0.3);
                    self.dirty[i as usize] = true;
                }
            }
        }
    }
}
