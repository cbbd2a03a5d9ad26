//! Weights of each vertex, where the motions of the bones are known.
//!
//! The paper fits weights of all bones and cuts them down to four, which is not the best set of four. Here a set grows:
//! each step adds the most promising bone and fits weights again (`simplex_fit`). From five bones on it removes the
//! least useful one, as long as the error falls.
//!
//! The smallest value of wᵀ G w over weights that are not negative and add up to one, for up to five of them.

use super::bone_fit::{BoneFrames, BoneProducts, FittedPlaces, gather_targets};
use super::joined::MeanWeights;
use super::sequence::ShapeSamples;
use crate::skeleton::BoneInfluences;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use rayon::prelude::*;

/// Vertices that are fitted together: what is gathered for them stays in cache.
const RUN: usize = 16;
/// Share of the error by which another set must be better.
const GAIN: f64 = 1e-5;
/// Changes of a set at most, and bones that are tried for each.
const CHANGES: usize = 24;
const TRIES: usize = 3;

/// Fits weights to all vertices, each drawn to its mean. Sets of bones begin with the heaviest of the mean. `drawn`: weights that are one
/// away from the mean count as much as an error of this part of the shape's size in each frame.
pub(super) fn fit_near_means(
    samples: &ShapeSamples,
    bones: &BoneFrames,
    most: usize,
    means: &[MeanWeights],
    drawn: f64,
    exec: &Exec<'_>,
) -> Result<Vec<BoneInfluences>, Cancelled> {
    let strength = drawn * drawn * samples.frames() as f64;
    let found = for_each_vertex(samples, bones, exec, |search, vertex, v| {
        search.draw_to(&means[v], strength);
        let mut heaviest = means[v].clone();
        let start = BoneInfluences::from_pairs(&mut heaviest).map(|start| start.cut_to(most));
        search.best_set(vertex, most, start.as_ref())
    });
    Ok(found?.0)
}

/// Fits weights to all vertices, beginning with `before` where it is given. Also answers each vertex's squared error, summed
/// over all frames.
pub(super) fn fit_influences(
    samples: &ShapeSamples,
    bones: &BoneFrames,
    most: usize,
    before: Option<&[BoneInfluences]>,
    exec: &Exec<'_>,
) -> Result<(Vec<BoneInfluences>, Vec<f64>), Cancelled> {
    for_each_vertex(samples, bones, exec, |search, vertex, v| {
        let start = before.map(|b| &b[v]);
        search.best_set(vertex, most, start)
    })
}

/// The bone that takes each vertex along best, and its squared error.
pub(super) fn best_bones(
    samples: &ShapeSamples,
    bones: &BoneFrames,
    exec: &Exec<'_>,
) -> Result<(Vec<BoneInfluences>, Vec<f64>), Cancelled> {
    for_each_vertex(samples, bones, exec, |search, vertex, _| {
        let (bone, error) = search.best_single(vertex);
        (BoneInfluences::one(bone as u16), error)
    })
}

fn for_each_vertex(
    samples: &ShapeSamples,
    bones: &BoneFrames,
    exec: &Exec<'_>,
    fit: impl Fn(&mut SetSearch<'_>, &FittedPlaces<'_>, usize) -> (BoneInfluences, f64) + Sync + Send,
) -> Result<(Vec<BoneInfluences>, Vec<f64>), Cancelled> {
    let products = BoneProducts::new(bones, exec)?;
    let vertices = samples.vertices();
    let mut influences = vec![BoneInfluences::default(); vertices];
    let mut errors = vec![0.0; vertices];
    exec.pool.install(|| {
        let runs = influences
            .par_chunks_mut(RUN)
            .zip(errors.par_chunks_mut(RUN))
            .enumerate();
        runs.try_for_each_init(
            || {
                (
                    SetSearch::new(&products),
                    vec![0.0; 4 * bones.bones() * RUN],
                    [0.0; RUN],
                )
            },
            |(search, pulls, squares), (run, (influences, errors))| {
                exec.check()?;
                let first = run * RUN;
                let count = influences.len();
                let pulls = &mut pulls[..4 * bones.bones() * count];
                gather_targets(samples, bones, first, pulls, &mut squares[..count]);
                for k in 0..count {
                    let size = 4 * bones.bones();
                    let own = &pulls[k * size..(k + 1) * size];
                    let vertex = FittedPlaces::new(samples.rest[first + k], own, squares[k]);
                    (influences[k], errors[k]) = fit(search, &vertex, first + k);
                }
                Ok::<(), Cancelled>(())
            },
        )
    })?;
    Ok((influences, errors))
}

/// Bones with weights, and the squared error that they leave.
#[derive(Clone, Copy)]
struct WeightedSet {
    bones: [usize; MOST],
    count: usize,
    fit: SimplexFit,
}

/// Searches the sets of bones of one vertex after the other.
struct SetSearch<'a> {
    products: &'a BoneProducts,
    /// The weights of all bones that a vertex is drawn to; empty where it is free.
    mean: Vec<f64>,
    /// How strongly, and the square of those weights.
    strength: f64,
    mean_square: f64,
    /// Each bone's error alone.
    alone: Vec<f64>,
    /// Rows of the Gram matrix that are known.
    rows: Vec<(usize, Vec<f64>)>,
    known: usize,
}

impl<'a> SetSearch<'a> {
    fn new(products: &'a BoneProducts) -> Self {
        Self {
            products,
            mean: Vec::new(),
            strength: 0.0,
            mean_square: 0.0,
            alone: Vec::new(),
            rows: Vec::new(),
            known: 0,
        }
    }

    /// Draws the next vertex to a mean: s ‖w − m‖² is added to its squared error.
    fn draw_to(&mut self, mean: &MeanWeights, strength: f64) {
        self.mean.clear();
        self.mean.resize(self.products.bones(), 0.0);
        mean.iter()
            .for_each(|(bone, weight)| self.mean[usize::from(*bone)] = *weight);
        self.mean_square = mean.iter().map(|m| m.1 * m.1).sum();
        self.strength = strength;
    }

    /// What the mean adds to the product of two bones: for weights that add up to one, ‖w − m‖² is a quadratic form of w.
    fn drawn(&self, a: usize, b: usize) -> f64 {
        if self.mean.is_empty() {
            return 0.0;
        }
        let same = if a == b { 1.0 } else { 0.0 };
        self.strength * (same - self.mean[a] - self.mean[b] + self.mean_square)
    }

    fn best_single(&mut self, vertex: &FittedPlaces<'_>) -> (usize, f64) {
        let mut best = (0, f64::INFINITY);
        for bone in 0..self.products.bones() {
            let error = self.products.own_error(vertex, bone);
            if error < best.1 {
                best = (bone, error);
            }
        }
        best
    }

    fn best_set(
        &mut self,
        vertex: &FittedPlaces<'_>,
        most: usize,
        start: Option<&BoneInfluences>,
    ) -> (BoneInfluences, f64) {
        self.known = 0;
        self.alone.clear();
        for bone in 0..self.products.bones() {
            let drawn = self.drawn(bone, bone);
            self.alone.push(self.products.own_error(vertex, bone) + drawn);
        }
        let mut single = 0;
        for (bone, error) in self.alone.iter().enumerate() {
            if *error < self.alone[single] {
                single = bone;
            }
        }
        let mut bones = [0; MOST];
        let mut count = 0;
        for (bone, _) in start.iter().flat_map(|s| s.iter()) {
            bones[count] = bone;
            count += 1;
        }
        if count == 0 {
            (bones[0], count) = (single, 1);
        }
        let set = self.fit_set(vertex, &bones[..count]);
        let set = self.improve(vertex, most, set);
        let mut pairs = [(0u16, 0.0); MOST];
        for k in 0..set.count {
            pairs[k] = (set.bones[k] as u16, set.fit.weights[k]);
        }
        let found = BoneInfluences::from_pairs(&mut pairs[..set.count]);
        (
            found.unwrap_or_else(|| BoneInfluences::one(single as u16)),
            set.fit.value,
        )
    }

    /// Takes bones in and lets others go while that lessens the error.
    fn improve(&mut self, vertex: &FittedPlaces<'_>, most: usize, mut set: WeightedSet) -> WeightedSet {
        for _ in 0..CHANGES {
            let mut better = None;
            for bone in self.promising(vertex, &set).into_iter().flatten() {
                let mut bones = set.bones;
                bones[set.count] = bone;
                let mut grown = self.fit_set(vertex, &bones[..set.count + 1]);
                if grown.count > most {
                    grown = self.without_one(vertex, &grown);
                }
                if grown.fit.value < set.fit.value * (1.0 - GAIN) {
                    better = Some(grown);
                    break;
                }
            }
            match better {
                Some(better) => set = better,
                None => break,
            }
        }
        set
    }

    /// The bones outside of the set towards which the error falls most.
    fn promising(&mut self, vertex: &FittedPlaces<'_>, set: &WeightedSet) -> [Option<usize>; TRIES] {
        let mut slope = [0usize; MOST];
        for k in 0..set.count {
            slope[k] = self.row(vertex, set.bones[k]);
        }
        let value = set.fit.value;
        let mut best = [(0.0, None); TRIES];
        for (bone, own) in self.alone.iter().enumerate() {
            if set.bones[..set.count].contains(&bone) {
                continue;
            }
            let gradient: f64 = (0..set.count)
                .map(|k| set.fit.weights[k] * self.rows[slope[k]].1[bone])
                .sum();
            let fall = value - gradient;
            if fall <= 0.0 {
                continue;
            }
            let curve = value - 2.0 * gradient + own;
            let gain = if fall < curve { fall * fall / curve } else { value - own };
            let mut entry = (gain, Some(bone));
            for place in &mut best {
                if entry.0 > place.0 {
                    std::mem::swap(place, &mut entry);
                }
            }
        }
        best.map(|b| b.1)
    }

    /// The best of the sets with one bone less.
    fn without_one(&mut self, vertex: &FittedPlaces<'_>, set: &WeightedSet) -> WeightedSet {
        let mut best: Option<WeightedSet> = None;
        for left_out in 0..set.count {
            let mut bones = [0; MOST];
            let kept = (0..set.count).filter(|&k| k != left_out);
            kept.enumerate().for_each(|(to, k)| bones[to] = set.bones[k]);
            let smaller = self.fit_set(vertex, &bones[..set.count - 1]);
            if best.is_none_or(|b| smaller.fit.value < b.fit.value) {
                best = Some(smaller);
            }
        }
        best.unwrap_or(*set)
    }

    /// Fits weights on a set; bones that get none are left out.
    fn fit_set(&mut self, vertex: &FittedPlaces<'_>, bones: &[usize]) -> WeightedSet {
        let mut gram = [[0.0; MOST]; MOST];
        for (a, &j) in bones.iter().enumerate() {
            let row = self.row(vertex, j);
            for (b, &k) in bones.iter().enumerate() {
                gram[a][b] = self.rows[row].1[k];
            }
        }
        let fit = fit_on_simplex(&gram, bones.len());
        let mut set = WeightedSet {
            bones: [0; MOST],
            count: 0,
            fit: SimplexFit {
                weights: [0.0; MOST],
                value: fit.value,
            },
        };
        for (k, &bone) in bones.iter().enumerate() {
            if fit.weights[k] > 0.0 {
                set.bones[set.count] = bone;
                set.fit.weights[set.count] = fit.weights[k];
                set.count += 1;
            }
        }
        set
    }

    /// Where the row of a bone is kept.
    fn row(&mut self, vertex: &FittedPlaces<'_>, bone: usize) -> usize {
        if let Some(at) = self.rows[..self.known].iter().position(|r| r.0 == bone) {
            return at;
        }
        if self.known == self.rows.len() {
            self.rows.push((bone, Vec::new()));
        }
        let (_, mut row) = std::mem::take(&mut self.rows[self.known]);
        self.products.gram_row(vertex, bone, &mut row);
        row.iter_mut()
            .enumerate()
            .for_each(|(other, product)| *product += self.drawn(bone, other));
        self.rows[self.known] = (bone, row);
        self.known += 1;
        self.known - 1
    }
}

/// The most weights.
pub(super) const MOST: usize = 5;

/// A Gram matrix of up to five; only the first few rows and columns are read.
pub(super) type SmallGram = [[f64; MOST]; MOST];

/// Weights, and the value that they reach.
#[derive(Debug, Clone, Copy)]
pub(super) struct SimplexFit {
    pub(super) weights: [f64; MOST],
    pub(super) value: f64,
}

/// Finds them by an active-set method (Lawson and Hanson 1974) from a weight of one on the first.
/// `G` must be positive definite, if only by a ridge.
fn fit_on_simplex(gram: &SmallGram, count: usize) -> SimplexFit {
    let mut best = 0;
    for k in 1..count {
        if gram[k][k] < gram[best][best] {
            best = k;
        }
    }
    let mut w = [0.0; MOST];
    w[best] = 1.0;
    let mut active = [false; MOST];
    active[best] = true;
    for _ in 0..4 * MOST {
        // The optimum on the active ones, or as far towards it as no weight turns negative.
        let Some(z) = equal_multipliers(gram, count, &active) else {
            break;
        };
        let mut step = 1.0f64;
        let mut leaving = None;
        for k in (0..count).filter(|&k| active[k]) {
            if z[k] <= 0.0 {
                let ratio = w[k] / (w[k] - z[k]);
                if ratio < step || leaving.is_none() {
                    step = ratio.min(step);
                    leaving = Some(k);
                }
            }
        }
        for k in (0..count).filter(|&k| active[k]) {
            w[k] += step * (z[k] - w[k]);
        }
        if let Some(k) = leaving {
            w[k] = 0.0;
            active[k] = false;
            continue;
        }
        let (value, gradient) = evaluate(gram, count, &w);
        let mut entering = None;
        let mut least = value - 1e-12 * value.abs();
        for k in (0..count).filter(|&k| !active[k]) {
            if gradient[k] < least {
                least = gradient[k];
                entering = Some(k);
            }
        }
        match entering {
            Some(k) => active[k] = true,
            None => break,
        }
    }
    let sum: f64 = w[..count].iter().sum();
    w[..count].iter_mut().for_each(|x| *x /= sum);
    SimplexFit {
        value: evaluate(gram, count, &w).0,
        weights: w,
    }
}

fn evaluate(gram: &SmallGram, count: usize, w: &[f64; MOST]) -> (f64, [f64; MOST]) {
    let mut gradient = [0.0; MOST];
    let mut value = 0.0;
    for k in 0..count {
        gradient[k] = (0..count).map(|j| gram[k][j] * w[j]).sum();
        value += w[k] * gradient[k];
    }
    (value, gradient)
}

/// Weights of the active ones, of any sign, that add up to one and see equal gradients: G z = 1, scaled.
fn equal_multipliers(gram: &SmallGram, count: usize, active: &[bool; MOST]) -> Option<[f64; MOST]> {
    let mut rows = [0; MOST];
    let mut m = 0;
    for k in (0..count).filter(|&k| active[k]) {
        rows[m] = k;
        m += 1;
    }
    let mut l = [[0.0; MOST]; MOST];
    let mut y = [0.0; MOST];
    for a in 0..m {
        let mut rhs = 1.0;
        for b in 0..=a {
            let mut sum = gram[rows[a]][rows[b]];
            for c in 0..b {
                sum -= l[a][c] * l[b][c];
            }
            if a == b {
                if sum <= 0.0 || !sum.is_finite() {
                    return None;
                }
                l[a][a] = sum.sqrt();
            } else {
                l[a][b] = sum / l[b][b];
                rhs -= l[a][b] * y[b];
            }
        }
        y[a] = rhs / l[a][a];
    }
    let mut z = [0.0; MOST];
    let mut sum = 0.0;
    for a in (0..m).rev() {
        let mut value = y[a];
        for b in a + 1..m {
            value -= l[b][a] * z[rows[b]];
        }
        z[rows[a]] = value / l[a][a];
        sum += z[rows[a]];
    }
    if sum <= 0.0 || !sum.is_finite() {
        return None;
    }
    z.iter_mut().for_each(|x| *x /= sum);
    Some(z)
}

#[cfg(test)]
mod simplex_fit_tests {
    use super::*;

    /// The Gram matrix of points in the plane: the fit is the point of their hull nearest to the origin.
    fn gram(points: &[[f64; 2]]) -> SmallGram {
        let mut g = [[0.0; MOST]; MOST];
        for (a, p) in points.iter().enumerate() {
            for (b, q) in points.iter().enumerate() {
                g[a][b] = p[0] * q[0] + p[1] * q[1] + if a == b { 1e-13 } else { 0.0 };
            }
        }
        g
    }

    #[test]
    fn the_nearest_point_of_a_hull_is_found_inside_on_an_edge_and_at_a_corner() {
        let around = [[2.0, 0.0], [-1.0, 1.0], [-1.0, -1.0], [5.0, 5.0], [-3.0, 0.0]];
        let inside = fit_on_simplex(&gram(&around), 5);
        assert!(inside.value < 1e-10);
        let edge = fit_on_simplex(&gram(&[[1.0, 3.0], [1.0, -1.0], [4.0, 0.0]]), 3);
        assert!((edge.value - 1.0).abs() < 1e-9 && edge.weights[2] == 0.0);
        assert!((edge.weights[0] - 0.25).abs() < 1e-9 && (edge.weights[1] - 0.75).abs() < 1e-9);
        let corner = fit_on_simplex(&gram(&[[3.0, 3.0], [1.0, 1.0], [2.0, 0.5 + 1.0]]), 3);
        assert!(corner.weights[1] == 1.0 && (corner.value - 2.0).abs() < 1e-9);
    }

    #[test]
    fn equal_points_share_the_weight() {
        let same = fit_on_simplex(&gram(&[[1.0, 0.0]; 4]), 4);
        assert!((same.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12 && (same.value - 1.0).abs() < 1e-9);
    }
}
