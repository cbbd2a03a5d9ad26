//! Graphs to solve on.

use pliant_solver::WeightedGraph;

/// A graph with owned arrays.
#[derive(Debug, Clone)]
pub struct TestGraph {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
    weights: Option<Vec<f32>>,
    /// One per vertex, also where the solver is given none.
    pub positions: Vec<[f64; 3]>,
    positioned: bool,
}

impl TestGraph {
    /// Builds rows from undirected edges; repeated edges count once.
    pub fn from_edges(positions: Vec<[f64; 3]>, edges: Vec<(u32, u32)>) -> TestGraph {
        let mut both: Vec<(u32, u32)> = edges
            .iter()
            .flat_map(|&(a, b)| [(a, b), (b, a)])
            .filter(|(a, b)| a != b)
            .collect();
        both.sort_unstable();
        both.dedup();
        let mut offsets = vec![0u32; positions.len() + 1];
        for &(a, _) in &both {
            offsets[a as usize + 1] += 1;
        }
        for i in 0..positions.len() {
            offsets[i + 1] += offsets[i];
        }
        let neighbours = both.into_iter().map(|(_, b)| b).collect();
        TestGraph {
            offsets,
            neighbours,
            weights: None,
            positions,
            positioned: true,
        }
    }

    pub fn view(&self) -> WeightedGraph<'_> {
        WeightedGraph {
            offsets: &self.offsets,
            neighbours: &self.neighbours,
            weights: self.weights.as_deref(),
            positions: self.positioned.then_some(self.positions.as_slice()),
        }
    }

    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Neighbours of a vertex and the weights of the edges to them.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.offsets[i] as usize..self.offsets[i + 1] as usize;
        range.map(|k| {
            (
                self.neighbours[k] as usize,
                self.weights.as_ref().map_or(1.0, |w| f64::from(w[k])),
            )
        })
    }

    pub fn edges(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        (0..self.len()).flat_map(move |i| {
            self.row(i)
                .map(move |(j, _)| (i as u32, j as u32))
                .filter(|(i, j)| i < j)
        })
    }

    /// True for vertices within `width` of either end along an axis.
    pub fn ends(&self, axis: usize, width: f64) -> Vec<bool> {
        let along = |p: &[f64; 3]| p[axis];
        let low = self.positions.iter().map(along).fold(f64::INFINITY, f64::min);
        let high = self.positions.iter().map(along).fold(f64::NEG_INFINITY, f64::max);
        self.positions
            .iter()
            .map(|p| p[axis] < low + width || p[axis] > high - width)
            .collect()
    }

    pub fn without_positions(self) -> TestGraph {
        TestGraph {
            positioned: false,
            ..self
        }
    }

    pub fn moved(mut self, f: impl Fn([f64; 3]) -> [f64; 3]) -> TestGraph {
        self.positions.iter_mut().for_each(|p| *p = f(*p));
        self
    }

    /// Symmetric weights 10^e with e spread evenly from `low` to `high`.
    pub fn weighted(mut self, low: f64, high: f64, seed: u64) -> TestGraph {
        let weight = |a: u32, b: u32| {
            let mut random = SplitMix::new(seed ^ ((u64::from(a.min(b)) << 32) | u64::from(a.max(b))));
            libm::pow(10.0, low + (high - low) * random.unit()) as f32
        };
        let mut weights = Vec::with_capacity(self.neighbours.len());
        for i in 0..self.len() {
            for &j in &self.neighbours[self.offsets[i] as usize..self.offsets[i + 1] as usize] {
                weights.push(weight(i as u32, j));
            }
        }
        self.weights = Some(weights);
        self
    }

    /// With a weight for every entry of the rows.
    pub fn with_weights(mut self, weights: Vec<f32>) -> TestGraph {
        assert_eq!(weights.len(), self.neighbours.len());
        self.weights = Some(weights);
        self
    }

    /// Drops about a third of the edges.
    pub fn disconnected(self, seed: u64) -> TestGraph {
        let mut random = SplitMix::new(seed);
        let edges: Vec<(u32, u32)> = self.edges().filter(|_| random.unit() > 0.33).collect();
        TestGraph::from_edges(self.positions, edges)
    }
}

/// A body-centred cubic lattice, 8 + 6 neighbours per vertex.
pub fn lattice(nx: usize, ny: usize, nz: usize) -> TestGraph {
    let id = |s: usize, i: usize, j: usize, k: usize| (((s * nx + i) * ny + j) * nz + k) as u32;
    let (mut positions, mut edges) = (Vec::new(), Vec::new());
    for s in 0..2 {
        for i in 0..nx {
            for j in 0..ny {
                for k in 0..nz {
                    positions.push([i, j, k].map(|c| c as f64 + 0.5 * s as f64));
                    let here = id(s, i, j, k);
                    if i + 1 < nx {
                        edges.push((here, id(s, i + 1, j, k)));
                    }
                    if j + 1 < ny {
                        edges.push((here, id(s, i, j + 1, k)));
                    }
                    if k + 1 < nz {
                        edges.push((here, id(s, i, j, k + 1)));
                    }
                    for corner in 0..8 * s {
                        let (a, b, c) = (i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2));
                        if a < nx && b < ny && c < nz {
                            edges.push((here, id(0, a, b, c)));
                        }
                    }
                }
            }
        }
    }
    TestGraph::from_edges(positions, edges)
}

/// A triangulated, gently curved sheet.
pub fn surface(nx: usize, ny: usize) -> TestGraph {
    let id = |i: usize, j: usize| (i * ny + j) as u32;
    let (mut positions, mut edges) = (Vec::new(), Vec::new());
    for i in 0..nx {
        for j in 0..ny {
            let (x, y) = (i as f64, j as f64);
            positions.push([x, y, 3.0 * libm::sin(0.1 * x) * libm::cos(0.08 * y) + 3.0]);
            if i + 1 < nx {
                edges.push((id(i, j), id(i + 1, j)));
            }
            if j + 1 < ny {
                edges.push((id(i, j), id(i, j + 1)));
            }
            if i + 1 < nx && j + 1 < ny {
                edges.push((id(i, j), id(i + 1, j + 1)));
            }
        }
    }
    TestGraph::from_edges(positions, edges)
}

/// A connected graph: each vertex is tied to `degree` random earlier ones, near ones more often.
pub fn random_graph(n: usize, degree: usize, seed: u64) -> TestGraph {
    let mut random = SplitMix::new(seed);
    let positions = (0..n)
        .map(|_| [random.unit() * 10.0, random.unit() * 10.0, random.unit() * 10.0])
        .collect();
    let mut edges = Vec::new();
    for i in 1..n {
        for _ in 0..degree.min(i) {
            let u = random.unit();
            edges.push((
                i as u32,
                i as u32 - 1 - ((u * u * u * i as f64) as u32).min(i as u32 - 1),
            ));
        }
    }
    TestGraph::from_edges(positions, edges)
}

/// One hub with `leaves` neighbours.
pub fn star(leaves: usize) -> TestGraph {
    let mut random = SplitMix::new(1);
    let mut positions = vec![[0.0; 3]];
    positions.extend((0..leaves).map(|_| [random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.5]));
    TestGraph::from_edges(positions, (1..=leaves as u32).map(|i| (0, i)).collect())
}

/// A small reproducible generator (splitmix64).
#[derive(Clone)]
pub struct SplitMix(u64);

impl SplitMix {
    pub fn new(seed: u64) -> Self {
        SplitMix(seed)
    }

    /// Evenly spread over 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}
