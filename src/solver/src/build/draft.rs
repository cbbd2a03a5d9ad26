//! A level on its way: rows in an order that keeps neighbours close, and its blocks coloured.
//!
//! Coarsening works on this form, where the neighbours of a row lie side by side.
//!
//! Sequences of vertices: along a space-filling curve, or breadth first where no positions are known.

use crate::lanes::{Lanes, NO_ROW, SharedRows, prefetch};
use crate::threads::{Parallelism, cut, piece_count, piece_rows};
use bytemuck::zeroed_vec;

/// Rows of a graph in any order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct UnorderedRows<'a> {
    pub(crate) offsets: &'a [u32],
    pub(crate) neighbours: &'a [u32],
    pub(crate) weights: Option<&'a [f32]>,
    /// Factor on every weight.
    pub(crate) scale: f32,
    /// One per row, or empty.
    pub(crate) positions: &'a [Lanes],
}

/// A graph in compressed rows, neighbours close to each other.
///
/// Rows that join a level that exists may have neighbours there: `k` stands for the *foreign* row number
/// `k − padded(size)` where it is not below the number of rows, `size` being that of the blocks.
#[derive(Debug, Default)]
pub(crate) struct LevelDraft {
    pub(crate) offsets: Vec<u32>,
    pub(crate) neighbours: Vec<u32>,
    /// `None`: all 1.
    pub(crate) weights: Option<Vec<f32>>,
    /// Positions in the unit box, or empty.
    pub(crate) positions: Vec<Lanes>,
}

/// Consecutive rows of a draft that one thread fills in.
struct DraftPiece<'a> {
    offsets: &'a mut [u32],
    neighbours: &'a mut [u32],
    weights: Option<&'a mut [f32]>,
    /// Empty without positions.
    positions: &'a mut [Lanes],
}

/// Rows that are asked of memory before they are copied.
const AHEAD: usize = 16;

impl LevelDraft {
    /// Copies `rows` in the order of `sequence`.
    pub(crate) fn new(rows: &UnorderedRows<'_>, sequence: &[u32], threads: Parallelism) -> LevelDraft {
        const PIECE: usize = 2048;
        let n = sequence.len();
        let threads = threads.for_rows(n);
        let mut ranks = vec![0u32; n];
        let mut offsets = vec![0u32; n + 1];
        let shared_ranks = SharedRows::new(&mut ranks);
        let totals = threads.map(
            0..piece_count(n, PIECE),
            || (),
            |(), k| {
                let range = piece_rows(k, n, PIECE);
                let mut total = 0;
                for (&i, k) in sequence[range.clone()].iter().zip(range) {
                    // SAFETY: a sequence holds every row once.
                    unsafe { shared_ranks.set(i as usize, k as u32) };
                    total += rows.offsets[i as usize + 1] - rows.offsets[i as usize];
                }
                total
            },
        );
        let mut total = 0;
        let mut bases = Vec::with_capacity(totals.len());
        for t in &totals {
            bases.push(total);
            total += t;
        }
        offsets[n] = total;
        let mut draft = LevelDraft {
            neighbours: vec![0; total as usize],
            weights: rows.weights.map(|w| vec![0.0; w.len()]),
            positions: zeroed_vec(if rows.positions.is_empty() { 0 } else { n }),
            offsets,
        };
        let pieces = draft.pieces(PIECE, totals.iter().map(|&total| total as usize));
        threads.for_each_item(
            pieces,
            || (),
            |(), k, piece| {
                let DraftPiece {
                    offsets,
                    neighbours: out,
                    weights: mut out_weights,
                    positions,
                } = piece;
                let range = piece_rows(k, n, PIECE);
                for (out, &i) in positions.iter_mut().zip(&sequence[range.clone()]) {
                    *out = rows.positions[i as usize];
                }
                let mut to = 0;
                for (at, length) in range.zip(offsets) {
                    if let Some(&later) = sequence.get(at + 2 * AHEAD) {
                        prefetch(rows.offsets, later as usize);
                    }
                    if let Some(&later) = sequence.get(at + AHEAD) {
                        let entries = rows.offsets[later as usize] as usize..rows.offsets[later as usize + 1] as usize;
                        prefetch_both_ends(rows.neighbours, &entries);
                        if let Some(weights) = rows.weights {
                            prefetch_both_ends(weights, &entries);
                        }
                    }
                    let i = sequence[at];
                    *length = bases[k] + to as u32;
                    let from = rows.offsets[i as usize] as usize..rows.offsets[i as usize + 1] as usize;
                    if let (Some(out), Some(w)) = (out_weights.as_deref_mut(), rows.weights) {
                        for (out, w) in out[to..].iter_mut().zip(&w[from.clone()]) {
                            *out = w * rows.scale;
                        }
                    }
                    out[to..to + from.len()].copy_from_slice(&rows.neighbours[from.clone()]);
                    to += from.len();
                }
                // All at once: a loop without branches waits for many of them at the same time.
                for j in out {
                    *j = ranks[*j as usize];
                }
            },
        );
        draft
    }

    /// Cuts the draft into pieces of `size` rows, `entries` in each.
    fn pieces(&mut self, size: usize, entries: impl Iterator<Item = usize> + Clone) -> Vec<DraftPiece<'_>> {
        let n = self.rows();
        let mut weights = self.weights.as_mut().map(|w| cut(w, entries.clone()).into_iter());
        let mut positions = self.positions.chunks_mut(size);
        let offsets = self.offsets[..n].chunks_mut(size);
        offsets
            .zip(cut(&mut self.neighbours, entries))
            .map(|(offsets, neighbours)| DraftPiece {
                offsets,
                neighbours,
                weights: weights.as_mut().and_then(Iterator::next),
                positions: positions.next().unwrap_or_default(),
            })
            .collect()
    }

    pub(crate) fn rows(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Entries of row `i`.
    #[inline(always)]
    pub(crate) fn entries(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i] as usize..self.offsets[i + 1] as usize
    }

    /// Neighbours of row `i`.
    #[inline(always)]
    pub(crate) fn row(&self, i: usize) -> &[u32] {
        &self.neighbours[self.entries(i)]
    }

    /// Asks memory for the neighbours of row `i`, and their weights.
    #[inline(always)]
    pub(crate) fn prefetch_row(&self, i: usize) {
        let entries = self.entries(i);
        prefetch_both_ends(&self.neighbours, &entries);
        if let Some(weights) = &self.weights {
            prefetch_both_ends(weights, &entries);
        }
    }

    #[inline(always)]
    pub(crate) fn weight(&self, entry: usize) -> f32 {
        self.weights.as_ref().map_or(1.0, |w| w[entry])
    }

    /// True if row `i` has a neighbour.
    #[inline(always)]
    pub(crate) fn connected(&self, i: usize) -> bool {
        self.offsets[i] < self.offsets[i + 1]
    }
}

/// Asks memory for entries that lie in two lines of a cache at most, as those of nearly all rows do.
#[inline(always)]
fn prefetch_both_ends<T>(all: &[T], entries: &std::ops::Range<usize>) {
    prefetch(all, entries.start);
    prefetch(all, entries.end);
}

/// Blocks of consecutive rows of a [`LevelDraft`], coloured so that two blocks of one colour are not adjacent.
#[derive(Debug)]
pub(crate) struct RowBlocks {
    /// Rows per block, a power of two; the last block may have fewer.
    pub(crate) size: usize,
    rows: usize,
    /// First of `by_colour` for each colour, and the number of blocks.
    pub(crate) colours: Vec<u32>,
    /// Blocks colour by colour.
    pub(crate) by_colour: Vec<u32>,
}

impl RowBlocks {
    /// Cuts `draft` into blocks of `size` rows and colours them greedily in their order.
    pub(crate) fn new(draft: &LevelDraft, size: usize, threads: Parallelism) -> RowBlocks {
        let rows = draft.rows();
        let count = rows.div_ceil(size);
        let shift = size.trailing_zeros();
        let adjacency = threads.for_rows(rows).map(
            0..count,
            || vec![NO_ROW; count],
            |stamps, b| {
                let entries = draft.offsets[b * size] as usize..draft.offsets[((b + 1) * size).min(rows)] as usize;
                stamps[b] = b as u32;
                let mut touched = Vec::new();
                for &j in &draft.neighbours[entries] {
                    let other = (j >> shift) as usize;
                    // Foreign rows are in no block.
                    if other < count && stamps[other] != b as u32 {
                        stamps[other] = b as u32;
                        touched.push(other as u32);
                    }
                }
                touched
            },
        );
        let (colours, by_colour) = colour(&both_ways(adjacency));
        RowBlocks {
            size,
            rows,
            colours,
            by_colour,
        }
    }

    /// The number that the first foreign row goes by.
    pub(crate) fn padded(&self) -> usize {
        self.rows.next_multiple_of(self.size)
    }

    /// Rows of block `b`.
    pub(crate) fn range(&self, b: usize) -> std::ops::Range<usize> {
        b * self.size..((b + 1) * self.size).min(self.rows)
    }
}

/// Adds to every list of adjacent blocks those that name its block. In a symmetric graph they are there already; that
/// blocks of one colour can be swept at the same time must not hang on a caller's promise.
fn both_ways(mut adjacency: Vec<Vec<u32>>) -> Vec<Vec<u32>> {
    let named: Vec<(u32, u32)> = (0u32..)
        .zip(&adjacency)
        .flat_map(|(b, others)| others.iter().map(move |&other| (b, other)))
        .filter(|&(b, other)| !adjacency[other as usize].contains(&b))
        .collect();
    for (b, other) in named {
        adjacency[other as usize].push(b);
    }
    adjacency
}

/// Colours blocks greedily in their order. Returns the first block of each colour and the blocks colour by colour.
fn colour(adjacency: &[Vec<u32>]) -> (Vec<u32>, Vec<u32>) {
    let mut colour_of = vec![NO_ROW; adjacency.len()];
    let mut taken: Vec<usize> = Vec::new();
    for (b, others) in adjacency.iter().enumerate() {
        for &other in others {
            let c = colour_of[other as usize];
            if c != NO_ROW {
                taken[c as usize] = b + 1;
            }
        }
        let free = taken.iter().position(|&t| t != b + 1).unwrap_or(taken.len());
        if free == taken.len() {
            taken.push(0);
        }
        colour_of[b] = free as u32;
    }
    let mut begins = vec![0u32; taken.len() + 1];
    for &c in &colour_of {
        begins[c as usize + 1] += 1;
    }
    for c in 0..taken.len() {
        begins[c + 1] += begins[c];
    }
    let mut cursor = begins.clone();
    let mut by_colour = vec![0u32; adjacency.len()];
    for (b, &c) in colour_of.iter().enumerate() {
        by_colour[cursor[c as usize] as usize] = b as u32;
        cursor[c as usize] += 1;
    }
    (begins, by_colour)
}

/// Bits per axis of the curve.
const BITS: u32 = 10;

/// Moves and scales positions into a unit box around 0: `p = (position - centre) / size`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct UnitBoxMap {
    /// Middle of the bounding box.
    pub(crate) centre: [f64; 3],
    /// Longest side of the bounding box, 1 if it has none.
    pub(crate) size: f64,
    inverse: f64,
}

impl UnitBoxMap {
    pub(crate) fn around(positions: &[[f64; 3]]) -> UnitBoxMap {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in positions {
            for c in 0..3 {
                low[c] = if p[c] < low[c] { p[c] } else { low[c] };
                high[c] = if p[c] > high[c] { p[c] } else { high[c] };
            }
        }
        if positions.is_empty() {
            return UnitBoxMap::new([0.0; 3], 1.0);
        }
        let centre = [0, 1, 2].map(|c| 0.5 * low[c] + 0.5 * high[c]);
        let half = (0..3).map(|c| 0.5 * high[c] - 0.5 * low[c]).fold(0.0, f64::max);
        // Twice the half may overflow for boxes that fill the range of f64; a box half as large serves as well.
        let size = if (2.0 * half).is_finite() { 2.0 * half } else { half };
        UnitBoxMap::new(centre, size)
    }

    fn new(centre: [f64; 3], size: f64) -> UnitBoxMap {
        let size = if (1.0 / size).is_finite() { size } else { 1.0 };
        UnitBoxMap {
            centre,
            size,
            inverse: 1.0 / size,
        }
    }

    #[inline]
    pub(crate) fn apply(&self, p: [f64; 3]) -> Lanes {
        let f = |c: usize| ((p[c] - self.centre[c]) * self.inverse) as f32;
        Lanes([f(0), f(1), f(2), 0.0])
    }
}

/// Spreads the low ten bits so that two zero bits follow each.
#[inline]
fn spread_bits(v: u32) -> u32 {
    let v = v & 0x3ff;
    let v = (v | (v << 16)) & 0x0300_00ff;
    let v = (v | (v << 8)) & 0x0300_f00f;
    let v = (v | (v << 4)) & 0x030c_30c3;
    (v | (v << 2)) & 0x0924_9249
}

/// Rows that one piece of work sorts.
const PIECE: usize = 1 << 15;

/// Vertices along the Morton curve through positions in the box −1 … 1; equal cells keep the order of the ids.
///
/// A radix sort by three digits. Every piece counts its digits, and from the counts of all pieces follows where each
/// of its items belongs, so that pieces move their items independently.
pub(crate) fn along_curve(positions: &[Lanes], threads: Parallelism) -> Vec<u32> {
    const DIGITS: usize = 1 << BITS;
    let n = positions.len();
    let threads = threads.for_rows(n);
    let cells = DIGITS as f32;
    let cell = |v: f32| ((v + 0.5) * cells).clamp(0.0, cells - 1.0) as u32;
    let digit = |key: u32, pass: u32| (key >> (pass * BITS)) as usize % DIGITS;
    let mut items = vec![(0u32, 0u32); n];
    let mut spare = vec![(0u32, 0u32); n];
    let mut order = vec![0u32; n];
    for pass in 0..3 {
        let counts = threads.map_pieces(
            PIECE,
            items.as_mut_slice(),
            || (),
            |(), first, items| {
                if pass == 0 {
                    for ((item, p), i) in items.iter_mut().zip(&positions[first..]).zip(first..) {
                        let [x, y, z, _] = p.0;
                        let key = spread_bits(cell(x)) | (spread_bits(cell(y)) << 1) | (spread_bits(cell(z)) << 2);
                        *item = (key, i as u32);
                    }
                }
                let mut counts = vec![0u32; DIGITS];
                for &(key, _) in items.iter() {
                    counts[digit(key, pass)] += 1;
                }
                counts
            },
        );
        let mut cursors = vec![0u32; counts.len() * DIGITS];
        let mut total = 0;
        for d in 0..DIGITS {
            for (k, counts) in counts.iter().enumerate() {
                cursors[k * DIGITS + d] = total;
                total += counts[d];
            }
        }
        let (to, order) = (SharedRows::new(&mut spare), SharedRows::new(&mut order));
        threads.for_each_piece(DIGITS, cursors.as_mut_slice(), |first, cursors| {
            for &item in &items[piece_rows(first / DIGITS, n, PIECE)] {
                let slot = &mut cursors[digit(item.0, pass)];
                // SAFETY: the counts give every item a place of its own.
                unsafe {
                    match pass {
                        2 => order.set(*slot as usize, item.1),
                        _ => to.set(*slot as usize, item),
                    }
                }
                *slot += 1;
            }
        });
        std::mem::swap(&mut items, &mut spare);
    }
    order
}

/// Vertices breadth first, each component from its smallest id.
pub(crate) fn breadth_first(offsets: &[u32], neighbours: &[u32]) -> Vec<u32> {
    let n = offsets.len() - 1;
    let mut order = Vec::with_capacity(n);
    let mut seen = vec![false; n];
    for root in 0..n {
        if seen[root] {
            continue;
        }
        seen[root] = true;
        let mut head = order.len();
        order.push(root as u32);
        while head < order.len() {
            let i = order[head] as usize;
            head += 1;
            for &j in &neighbours[offsets[i] as usize..offsets[i + 1] as usize] {
                if !std::mem::replace(&mut seen[j as usize], true) {
                    order.push(j);
                }
            }
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_visits_octants_one_after_the_other() {
        let mut points = Vec::new();
        for k in 0..512u32 {
            let c = |s: u32| ((((k * 7 + 3) % 512) >> s) & 7) as f32 / 8.0 - 0.5 + 1.0 / 32.0;
            points.push(Lanes([c(0), c(3), c(6), 0.0]));
        }
        let order = along_curve(&points, Parallelism::single_threaded());
        let octant = |i: u32| {
            points[i as usize]
                .0
                .iter()
                .take(3)
                .enumerate()
                .map(|(c, v)| usize::from(*v > 0.0) << c)
                .sum()
        };
        let octants: Vec<usize> = order.iter().map(|&i| octant(i)).collect();
        assert!(octants.is_sorted());
        let mut ids = order.clone();
        ids.sort_unstable();
        assert!(
            ids.iter().enumerate().all(|(k, &i)| k == i as usize),
            "every vertex once"
        );
    }

    #[test]
    fn equal_cells_keep_their_order() {
        assert_eq!(
            along_curve(&[Lanes::ZERO; 5], Parallelism::single_threaded()),
            [0, 1, 2, 3, 4]
        );
        assert!(along_curve(&[], Parallelism::single_threaded()).is_empty());
    }

    #[test]
    fn breadth_first_visits_every_component() {
        // 0-2, 1 alone, 3-4-5 with 4 in the middle
        assert_eq!(
            breadth_first(&[0, 1, 1, 2, 3, 5, 6], &[2, 0, 4, 3, 5, 4]),
            [0, 2, 1, 3, 4, 5]
        );
    }

    #[test]
    fn frames_survive_extreme_boxes() {
        for s in [1e-300, 1e-30, 1.0, 1e30, 1e308] {
            let frame = UnitBoxMap::around(&[[-s, 0.0, 0.0], [s, s, 0.0]]);
            let p = frame.apply([s, 0.0, 0.0]);
            assert!(p.0.iter().all(|v| v.abs() <= 1.0), "{s}: {p:?}");
        }
        assert_eq!(UnitBoxMap::around(&[[3.0; 3]; 2]).size, 1.0);
    }
}
