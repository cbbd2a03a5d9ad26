//! Coarse equations: a finite-volume view of the graph Laplacian on aggregates.
//!
//! Between two aggregates I and J flows Σ w (x_i − x_j) over the edges that cross. If x is an affine function of
//! position, this is g·v with v = Σ w (p_i − p_j), while a single coarse edge of weight S = Σ w between the centroids
//! would carry S g·D with D = c_I − c_J. Their ratio φ = v·D / (S |D|²) makes the coarse edge carry the right flow, so
//! coarse corrections have the right length and need no over-correction factor.

use super::lanes::Lanes;
use super::level::{Level, NONE};
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

/// Scratch of one thread: where in the list of sums the present row keeps those for another aggregate.
struct Slots {
    owner: Vec<u32>,
    slot: Vec<u32>,
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
        || Slots {
            owner: vec![NONE; count],
            slot: vec![0; count],
        },
        |slots, k| {
            let rows = piece(k, count, PIECE);
            let mut entries: Vec<(u32, f32)> = Vec::new();
            let mut ends = Vec::with_capacity(rows.len());
            let mut sums: Vec<(u32, Lanes)> = Vec::new();
            for coarse in rows {
                sum_crossing(level, coarse, slots, &mut sums);
                for &(other, sum) in &sums {
                    entries.push((other, weight(&positions, coarse, other as usize, sum)));
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

/// For each aggregate after `coarse` that an edge leads to: Σ w (p_i − p_j) in the first three lanes, Σ w in the last.
fn sum_crossing(level: &Level, coarse: usize, slots: &mut Slots, sums: &mut Vec<(u32, Lanes)>) {
    sums.clear();
    for &i in level.members_of(coarse) {
        let i = i as usize;
        let mut here = level.positions.get(i).copied().unwrap_or(Lanes::ZERO);
        here.0[3] = 1.0;
        let (begin, _, end) = level.entries(i);
        for e in begin..end {
            let j = level.neighbours[e] as usize;
            let other = level.aggregates[j];
            if other as usize <= coarse {
                continue;
            }
            let there = level.positions.get(j).copied().unwrap_or(Lanes::ZERO);
            let term = (here - there) * level.weight(e);
            let known = slots.owner[other as usize] == coarse as u32;
            if known {
                sums[slots.slot[other as usize] as usize].1 += term;
            } else {
                slots.owner[other as usize] = coarse as u32;
                slots.slot[other as usize] = sums.len() as u32;
                sums.push((other, term));
            }
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
                let (begin, _, end) = coarse.entries(row);
                for e in begin..end {
                    let other = coarse.neighbours[e] as usize;
                    let (b, _, f) = coarse.entries(other);
                    let back = (b..f).find(|&k| coarse.neighbours[k] as usize == row).unwrap();
                    assert_eq!(coarse.weight(e).to_bits(), coarse.weight(back).to_bits());
                    let mut sum = 0.0;
                    for &i in fine.members_of(row) {
                        let (b, _, f) = fine.entries(i as usize);
                        let cross = |k: &usize| fine.aggregates[fine.neighbours[*k] as usize] as usize == other;
                        sum += (b..f).filter(cross).map(|k| fine.weight(k)).sum::<f32>();
                    }
                    let ratio = coarse.weight(e) / sum;
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
        let pieces = level.positions.iter().map(|p| u32::from(p.0[0] > 0.0)).collect();
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
