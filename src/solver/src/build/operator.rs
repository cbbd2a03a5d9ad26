//! Coarse equations: a finite-volume view of the graph Laplacian on aggregates.
//!
//! Between two aggregates I and J flows Σ w (x_i − x_j) over the edges that cross. If x is an affine function of
//! position, this is g·v with v = Σ w (p_i − p_j), while a single coarse edge of weight S = Σ w between the centroids
//! would carry S g·D with D = c_I − c_J. Their ratio φ = v·D / (S |D|²) makes the coarse edge carry the right flow, so
//! coarse corrections have the right length and need no over-correction factor.

use crate::build::coarsen::Aggregates;
use crate::build::draft::LevelDraft;
use crate::lanes::{Lanes, NO_ROW, WideLanes};
use crate::threads::{Parallelism, piece_count, piece_rows};

/// Bounds of φ. Below, a coarse vertex could lose its connection (φ can even be negative on folded surfaces); above 1
/// the coarse equations would be stiffer than the sums of the fine ones, and corrections only shorter.
const RATIO: (f64, f64) = (0.3, 1.0);

/// φ where positions are unknown or coincide pairwise.
const RATIO_WITHOUT_POSITIONS: f64 = 0.55;

/// Coarse rows that one piece of work handles.
const PIECE: usize = 1024;

/// An edge from a group to one of a larger number: the row and its neighbour.
#[derive(Debug, Clone, Copy, Default)]
struct CrossingEdge {
    from: u32,
    to: u32,
}

/// Groups that are asked of memory before they are needed.
const AHEAD: usize = 4;

/// Scratch of one thread: the groups beyond the present one that it touches, and the sums towards them.
struct RowAccumulator {
    /// Edges of the present group that lead on; longer than that.
    onward: Vec<CrossingEdge>,
    /// Their weights, where there are any.
    onward_weights: Vec<f32>,
    /// For each group the one whose slot numbers were written last, in the upper half, and the slot in the lower one.
    table: Vec<u64>,
    /// Group of each slot in use; longer than that.
    others: Vec<u32>,
    /// Σ w (p_i − p_j) in the first three lanes, Σ w in the last; 0 beyond those in use.
    sums: Vec<Lanes>,
    used: usize,
}

impl RowAccumulator {
    fn new(count: usize) -> RowAccumulator {
        RowAccumulator {
            onward: Vec::new(),
            onward_weights: Vec::new(),
            table: vec![u64::MAX; count],
            others: Vec::new(),
            sums: Vec::new(),
            used: 0,
        }
    }

    fn begin(&mut self) {
        self.sums[..self.used].fill(Lanes::ZERO);
        self.used = 0;
    }

    /// Makes sure that `more` edges can be taken behind the first `taken`.
    #[inline(always)]
    fn reserve_edges(&mut self, taken: usize, more: usize) {
        if self.onward.len() <= taken + more {
            self.onward.resize(2 * (taken + more) + 64, CrossingEdge::default());
            self.onward_weights.resize(self.onward.len(), 0.0);
        }
    }

    /// Makes sure that `most` slots can be taken.
    fn reserve_slots(&mut self, most: usize) {
        if self.sums.len() <= most {
            self.sums.resize(2 * most + 1, Lanes::ZERO);
            self.others.resize(2 * most + 1, NO_ROW);
        }
    }
}

/// Builds the next level from the groups of `draft`, a row for each group.
pub(crate) fn coarse_rows(draft: &LevelDraft, groups: &Aggregates, threads: Parallelism) -> LevelDraft {
    let count = groups.len();
    let threads = threads.for_rows(draft.rows());
    let positions = if draft.positions.is_empty() {
        Vec::new()
    } else {
        find_centroids(draft, groups, threads)
    };

    // Each pair of aggregates is summed once, from its smaller number, so the result is symmetric bit for bit.
    let halves = threads.map(
        0..piece_count(count, PIECE),
        || RowAccumulator::new(count),
        |slots, k| {
            let rows = piece_rows(k, count, PIECE);
            let mut entries: Vec<(u32, f32)> = Vec::with_capacity(8 * rows.len());
            let mut ends = Vec::with_capacity(rows.len());
            for coarse in rows {
                prefetch_members(draft, groups, coarse + AHEAD);
                match (&draft.weights, positions.is_empty()) {
                    (None, false) => sum_crossing::<false, true>(draft, groups, coarse, slots),
                    (Some(_), false) => sum_crossing::<true, true>(draft, groups, coarse, slots),
                    (None, true) => sum_crossing::<false, false>(draft, groups, coarse, slots),
                    (Some(_), true) => sum_crossing::<true, false>(draft, groups, coarse, slots),
                }
                let others = slots.others[..slots.used].iter().zip(&slots.sums);
                entries.extend(others.map(|(&other, &sum)| (other, weight(&positions, coarse, other as usize, sum))));
                ends.push(entries.len());
            }
            (entries, ends)
        },
    );
    mirror_halves(count, &halves, positions)
}

/// Asks for what [`sum_crossing`] will read of the rows of group `coarse`, if there is one.
#[inline(always)]
fn prefetch_members(draft: &LevelDraft, groups: &Aggregates, coarse: usize) {
    if coarse < groups.len() {
        for &i in groups.members_of(coarse) {
            draft.prefetch_row(i as usize);
        }
    }
}

/// Mean position of each aggregate's members.
fn find_centroids(draft: &LevelDraft, groups: &Aggregates, threads: Parallelism) -> Vec<Lanes> {
    let count = groups.len();
    let parts = threads.map(
        0..piece_count(count, PIECE),
        || (),
        |(), k| {
            let mean = |coarse: usize| {
                let members = groups.members_of(coarse);
                let mut sum = [0.0f64; 4];
                for &i in members {
                    crate::lanes::add_wide(&mut sum, draft.positions[i as usize].to_wide());
                }
                Lanes::from_wide(sum.map(|s| s / members.len() as f64))
            };
            piece_rows(k, count, PIECE).map(mean).collect::<Vec<_>>()
        },
    );
    parts.concat()
}

/// Sums over the edges from aggregate `coarse` to each aggregate of a larger number that they lead to.
///
/// First the edges that count are written side by side, whether one does being a sum and no question, since a question that
/// cannot be guessed costs more than writing an edge; then these few are summed.
fn sum_crossing<const WEIGHTED: bool, const PLACED: bool>(
    draft: &LevelDraft,
    groups: &Aggregates,
    coarse: usize,
    slots: &mut RowAccumulator,
) {
    let weights: &[f32] = draft.weights.as_deref().unwrap_or(&[]);
    let of_row = groups.of_row.as_slice();
    let mut taken = 0;
    for &i in groups.members_of(coarse) {
        let entries = draft.entries(i as usize);
        slots.reserve_edges(taken, entries.len());
        let (onward, onward_weights) = (&mut slots.onward[..], &mut slots.onward_weights[..]);
        let row_weights = if WEIGHTED { &weights[entries.clone()] } else { &[] };
        for (e, &j) in draft.neighbours[entries].iter().enumerate() {
            onward[taken] = CrossingEdge { from: i, to: j };
            if WEIGHTED {
                onward_weights[taken] = row_weights[e];
            }
            taken += usize::from(of_row[j as usize] as usize > coarse);
        }
    }
    slots.begin();
    slots.reserve_slots(taken);
    let owner = (coarse as u64) << 32;
    let (table, others, sums) = (&mut slots.table[..], &mut slots.others[..], &mut slots.sums[..]);
    let mut used = 0;
    for (edge, &weight) in slots.onward[..taken].iter().zip(&slots.onward_weights) {
        let at = |i: u32| {
            if PLACED {
                draft.positions[i as usize]
            } else {
                Lanes::ZERO
            }
        };
        let mut difference = at(edge.from) - at(edge.to);
        difference.0[3] = 1.0;
        let term = if WEIGHTED { difference * weight } else { difference };
        let other = of_row[edge.to as usize];
        let known = table[other as usize];
        let fresh = known ^ owner > u64::from(u32::MAX);
        let slot = if fresh { used } else { known as u32 as usize };
        // What a known slot writes at the end, the next fresh one replaces.
        others[used] = other;
        used += usize::from(fresh);
        table[other as usize] = owner | slot as u64;
        sums[slot] += term;
    }
    slots.used = used;
}

/// The coarse weight S·φ of two aggregates of the present draft.
fn weight(positions: &[Lanes], coarse: usize, other: usize, sum: Lanes) -> f32 {
    let apart = (!positions.is_empty()).then(|| positions[coarse] - positions[other]);
    coarse_weight(apart, sum.to_wide())
}

/// The coarse weight S·φ, never 0. `apart` is the way between the centroids, where there are positions; `sum` holds
/// Σ w (p_i − p_j) and S.
pub(crate) fn coarse_weight(apart: Option<Lanes>, sum: WideLanes) -> f32 {
    let [vx, vy, vz, s] = sum;
    let ratio = match apart {
        None => RATIO_WITHOUT_POSITIONS,
        Some(apart) => {
            let [dx, dy, dz, _] = apart.to_wide();
            let ratio = (vx * dx + vy * dy + vz * dz) / (s * (dx * dx + dy * dy + dz * dz));
            if ratio.is_finite() {
                ratio.clamp(RATIO.0, RATIO.1)
            } else {
                1.0
            }
        }
    };
    ((s * ratio) as f32).max(f32::MIN_POSITIVE)
}

type HalfRows = (Vec<(u32, f32)>, Vec<usize>);

/// Turns the entries towards larger numbers into full rows.
fn mirror_halves(count: usize, halves: &[HalfRows], positions: Vec<Lanes>) -> LevelDraft {
    let mut offsets = vec![0u32; count + 1];
    for (k, (entries, ends)) in halves.iter().enumerate() {
        let mut begin = 0;
        for (i, &end) in (k * PIECE..).zip(ends) {
            offsets[i + 1] += (end - begin) as u32;
            begin = end;
        }
        for &(other, _) in entries {
            offsets[other as usize + 1] += 1;
        }
    }
    for i in 0..count {
        offsets[i + 1] += offsets[i];
    }
    let mut cursor = offsets.clone();
    let mut neighbours = vec![0u32; offsets[count] as usize];
    let mut weights = vec![0.0f32; offsets[count] as usize];
    for (k, (entries, ends)) in halves.iter().enumerate() {
        let mut begin = 0;
        for (i, &end) in (k * PIECE..).zip(ends) {
            // All that smaller rows have put here stands before.
            let mut own = cursor[i] as usize;
            for &(other, w) in &entries[begin..end] {
                (neighbours[own], weights[own]) = (other, w);
                own += 1;
                let slot = &mut cursor[other as usize];
                (neighbours[*slot as usize], weights[*slot as usize]) = (i as u32, w);
                *slot += 1;
            }
            cursor[i] = own as u32;
            begin = end;
        }
    }
    LevelDraft {
        offsets,
        neighbours,
        weights: Some(weights),
        positions,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{BoxLattice, pool};

    #[test]
    fn coarse_weights_are_symmetric_and_bounded_by_their_sums() {
        let hierarchy = BoxLattice::new(12, 11, 10).weighted().hierarchy(1);
        assert!(cfg!(miri) || hierarchy.levels.len() > 2);
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
        let at = |x: f32| Lanes([x, 0.0, 0.0, 0.0]);
        let draft = LevelDraft {
            offsets: vec![0, 1, 3, 5, 6],
            neighbours: vec![1, 0, 2, 1, 3, 2],
            weights: None,
            positions: vec![at(0.0), at(1.0), at(2.0), at(3.0)],
        };
        let groups = Aggregates::new(vec![0, 0, 1, 1], 2);
        let coarse = coarse_rows(&draft, &groups, Parallelism::from_pool(&pool()));
        assert_eq!(coarse.neighbours, [1, 0]);
        assert!((coarse.weight(0) - 0.5).abs() < 1e-6, "{:?}", coarse.weights);
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
