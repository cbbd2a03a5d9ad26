//! Coarse equations: a finite-volume view of the graph Laplacian on aggregates.
//!
//! Between two aggregates I and J flows Σ w (x_i − x_j) over the edges that cross. If x is an affine function of
//! position, this is g·v with v = Σ w (p_i − p_j), while a single coarse edge of weight S = Σ w between the centroids
//! would carry S g·D with D = c_I − c_J. Their ratio φ = v·D / (S |D|²) makes the coarse edge carry the right flow, so
//! coarse corrections have the right length and need no over-correction factor.

use super::lanes::Lanes;
use super::level::{BUNDLE, Level, NONE};
use super::threads::{Threads, piece, pieces};

/// Bounds of φ. Below, a coarse vertex could lose its connection (φ can even be negative on folded surfaces); above 1
/// the coarse equations would be stiffer than the sums of the fine ones, and corrections only shorter.
const RATIO: (f64, f64) = (0.3, 1.0);

/// φ where positions are unknown or coincide pairwise.
const RATIO_WITHOUT_POSITIONS: f64 = 0.55;

/// Coarse rows that one piece of work handles.
const PIECE: usize = 1024;

/// Rows of the next level, numbered like the aggregates.
#[derive(Debug, Default)]
pub(crate) struct CoarseRows {
    pub(crate) offsets: Vec<u32>,
    pub(crate) neighbours: Vec<u32>,
    pub(crate) weights: Vec<f32>,
    /// Centroids, or empty.
    pub(crate) positions: Vec<Lanes>,
}

/// Scratch of one thread: the aggregates that the present one touches, and the sums towards them.
///
/// Every entry is added somewhere without asking where it leads, since such questions cost more than the sums: those
/// inside the aggregate and filling get sums of their own, which nobody reads.
struct Slots {
    /// For each aggregate the one whose slot numbers `slots` holds last.
    owners: Vec<u32>,
    slots: Vec<u32>,
    /// Aggregate of each slot in use; longer than that.
    others: Vec<u32>,
    /// Σ w (p_i − p_j) in the first three lanes, Σ w in the last; 0 beyond those in use.
    sums: Vec<Lanes>,
    used: usize,
}

impl Slots {
    fn new(count: usize) -> Slots {
        // One more for entries that lead to no aggregate.
        Slots {
            owners: vec![NONE; count + 1],
            slots: vec![0; count + 1],
            others: Vec::new(),
            sums: Vec::new(),
            used: 0,
        }
    }

    fn begin(&mut self) {
        self.sums[..self.used].fill(Lanes::ZERO);
        self.used = 0;
    }

    /// Makes sure that `more` slots can be taken.
    fn reserve(&mut self, more: usize) {
        let want = self.used + more + 1;
        if self.sums.len() < want {
            self.sums.resize(want, Lanes::ZERO);
            self.others.resize(want, NONE);
        }
    }

    #[inline(always)]
    fn add(&mut self, owner: u32, other: u32, term: Lanes) {
        let known = self.owners[other as usize] == owner;
        let slot = if known {
            self.slots[other as usize]
        } else {
            self.used as u32
        };
        self.others[self.used] = other;
        self.used += usize::from(!known);
        self.owners[other as usize] = owner;
        self.slots[other as usize] = slot;
        // A fresh slot overwrites what lies at its end; a known one writes there what the next fresh one replaces.
        self.others[slot as usize] = other;
        self.sums[slot as usize] += term;
    }
}

/// Builds the coarse rows of a level whose aggregates are set.
pub(crate) fn coarse_rows(level: &Level, threads: Threads) -> CoarseRows {
    let count = level.coarse_rows();
    let threads = threads.for_rows(level.rows());
    let positions = if level.positions.is_empty() {
        Vec::new()
    } else {
        centroids(level, threads)
    };

    // Each pair of aggregates is summed once, from its smaller number, so the result is symmetric to the bit.
    let halves = threads.map(
        0..pieces(count, PIECE),
        || Slots::new(count),
        |slots, k| {
            let rows = piece(k, count, PIECE);
            let mut entries: Vec<(u32, f32)> = Vec::with_capacity(8 * rows.len());
            let mut ends = Vec::with_capacity(rows.len());
            for coarse in rows {
                match (&level.weights, positions.is_empty()) {
                    (None, false) => sum_crossing::<false, true>(level, coarse, slots),
                    (Some(_), false) => sum_crossing::<true, true>(level, coarse, slots),
                    (None, true) => sum_crossing::<false, false>(level, coarse, slots),
                    (Some(_), true) => sum_crossing::<true, false>(level, coarse, slots),
                }
                for (&other, &sum) in slots.others[..slots.used].iter().zip(&slots.sums) {
                    if other as usize > coarse && (other as usize) < count {
                        entries.push((other, weight(&positions, coarse, other as usize, sum)));
                    }
                }
                ends.push(entries.len());
            }
            (entries, ends)
        },
    );
    mirror(count, &halves, positions)
}

/// Mean position of each aggregate's members.
fn centroids(level: &Level, threads: Threads) -> Vec<Lanes> {
    let count = level.coarse_rows();
    let parts = threads.map(
        0..pieces(count, PIECE),
        || (),
        |(), k| {
            let mean = |coarse: usize| {
                let members = level.members_of(coarse);
                let mut sum = [0.0f64; 4];
                for &i in members {
                    super::lanes::add_wide(&mut sum, level.positions[i as usize].wide());
                }
                Lanes::from_wide(sum.map(|s| s / members.len() as f64))
            };
            piece(k, count, PIECE).map(mean).collect::<Vec<_>>()
        },
    );
    parts.concat()
}

/// Sums over the edges from aggregate `coarse` to each aggregate that they lead to.
fn sum_crossing<const WEIGHTED: bool, const PLACED: bool>(level: &Level, coarse: usize, slots: &mut Slots) {
    let weights: &[f32] = level.weights.as_deref().unwrap_or(&[]);
    let nowhere = level.coarse_rows() as u32;
    slots.begin();
    for &i in level.members_of(coarse) {
        let i = i as usize;
        let mut here = if PLACED { level.positions[i] } else { Lanes::ZERO };
        here.0[3] = 1.0;
        let (begin, _, end) = level.bundle(i / BUNDLE);
        slots.reserve((end - begin) / BUNDLE);
        for e in (begin + i % BUNDLE..end).step_by(BUNDLE) {
            let j = level.neighbours[e] as usize;
            let there = if PLACED { level.positions[j] } else { Lanes::ZERO };
            let difference = here - there;
            let term = if WEIGHTED { difference * weights[e] } else { difference };
            slots.add(coarse as u32, level.aggregates[j].min(nowhere), term);
        }
    }
}

/// The coarse weight S·φ, never 0.
fn weight(positions: &[Lanes], coarse: usize, other: usize, sum: Lanes) -> f32 {
    let [vx, vy, vz, s] = sum.wide();
    let ratio = if positions.is_empty() {
        RATIO_WITHOUT_POSITIONS
    } else {
        let [dx, dy, dz, _] = (positions[coarse] - positions[other]).wide();
        let ratio = (vx * dx + vy * dy + vz * dz) / (s * (dx * dx + dy * dy + dz * dz));
        if ratio.is_finite() {
            ratio.clamp(RATIO.0, RATIO.1)
        } else {
            1.0
        }
    };
    ((s * ratio) as f32).max(f32::MIN_POSITIVE)
}

type Half = (Vec<(u32, f32)>, Vec<usize>);

/// Turns the entries towards larger numbers into full rows.
fn mirror(count: usize, halves: &[Half], positions: Vec<Lanes>) -> CoarseRows {
    let each = |visit: &mut dyn FnMut(usize, u32, f32)| {
        for (k, (entries, ends)) in halves.iter().enumerate() {
            let mut begin = 0;
            for (local, &end) in ends.iter().enumerate() {
                for &(other, w) in &entries[begin..end] {
                    visit(k * PIECE + local, other, w);
                }
                begin = end;
            }
        }
    };
    let mut offsets = vec![0u32; count + 1];
    each(&mut |i, j, _| {
        offsets[i + 1] += 1;
        offsets[j as usize + 1] += 1;
    });
    for i in 0..count {
        offsets[i + 1] += offsets[i];
    }
    let mut cursor = offsets.clone();
    let mut neighbours = vec![0u32; offsets[count] as usize];
    let mut weights = vec![0.0f32; offsets[count] as usize];
    let mut put = |i: usize, j: u32, w: f32| {
        let slot = cursor[i] as usize;
        neighbours[slot] = j;
        weights[slot] = w;
        cursor[i] += 1;
    };
    each(&mut |i, j, w| {
        put(i, j, w);
        put(j as usize, i as u32, w);
    });
    CoarseRows {
        offsets,
        neighbours,
        weights,
        positions,
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Block, pool};
    use super::*;

    #[test]
    fn coarse_weights_are_symmetric_and_bounded_by_their_sums() {
        let hierarchy = Block::new(12, 11, 10).weighted().hierarchy(1);
        assert!(hierarchy.levels.len() > 2);
        for pair in hierarchy.levels.windows(2) {
            let (fine, coarse) = (&pair[0], &pair[1]);
            for row in 0..coarse.rows() {
                for (other, w) in coarse.row(row) {
                    let back = coarse.row(other).find(|(k, _)| *k == row).unwrap().1;
                    assert_eq!(w.to_bits(), back.to_bits());
                    let mut sum = 0.0;
                    for &i in fine.members_of(row) {
                        let cross = |(j, _): &(usize, f32)| fine.aggregates[*j] as usize == other;
                        sum += fine.row(i as usize).filter(cross).map(|(_, w)| w).sum::<f32>();
                    }
                    let ratio = w / sum;
                    assert!((0.2999..=1.0001).contains(&ratio), "{ratio}");
                }
            }
        }
    }

    #[test]
    fn an_affine_field_flows_alike_on_both_levels() {
        // Along a chain cut into equal pieces the coarse edge must carry the flow of the one edge it replaces:
        // one fine edge of length 1 against a coarse edge of length 2.
        let mut block = Block::new(4, 1, 1);
        block.positions = (0..4).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let mut level = block.hierarchy(4).levels.swap_remove(0);
        let piece_of = |(i, p): (usize, &Lanes)| match level.connected(i) {
            true => u32::from(p.0[0] > 0.0),
            false => NONE,
        };
        let pieces = level.positions.iter().enumerate().map(piece_of).collect();
        level.set_aggregates(pieces, 2);
        let coarse = coarse_rows(&level, Threads::of(&pool()));
        assert_eq!(coarse.neighbours, [1, 0]);
        assert!((coarse.weights[0] - 0.5).abs() < 1e-6, "{:?}", coarse.weights);
    }

    #[test]
    fn positions_that_say_nothing_keep_the_sum() {
        let sum = Lanes([0.0, 0.0, 0.0, 7.0]);
        assert_eq!(weight(&[Lanes::ZERO; 2], 0, 1, sum), 7.0);
        assert!(
            (weight(&[], 0, 1, sum) - 3.85).abs() < 1e-6,
            "0.55 of the sum where nothing is known"
        );
        let apart = [Lanes([1.0, 0.0, 0.0, 0.0]), Lanes::ZERO];
        assert_eq!(
            weight(&apart, 0, 1, Lanes([-5.0, 0.0, 0.0, 10.0])),
            3.0,
            "a flow backwards is clamped"
        );
        assert_eq!(weight(&apart, 0, 1, Lanes([25.0, 0.0, 0.0, 10.0])), 10.0);
        assert!(weight(&[], 0, 1, Lanes([0.0, 0.0, 0.0, f32::MIN_POSITIVE])) > 0.0);
    }
}
