//! Bringing a graph into sweep order: blocks, their colours, and bundles of rows inside each block.
//!
//! A sweep over irregular rows is bound by mispredicted branches and by waiting, not by arithmetic. Here the rows of a
//! block are coloured in turn, and four rows of one colour with (nearly) equal numbers of neighbours before and after
//! them make a *bundle*: one loop serves four rows, and four independent sums are under way at any time.

use super::draft::{Blocks, Draft};
use super::lanes::{Lanes, Shared};
use super::level::{BUNDLE, Level};
use super::threads::{Threads, piece, pieces};

/// Rows that one piece of work handles where there are no blocks.
const PIECE: usize = 4096;

/// Largest colour inside a block; rows that would need a higher one are bundled one by one.
const LAST_COLOUR: u8 = 62;
/// Rows of a block at most. Arrays of this size need no checks of indices that are cut to it.
const MOST_ROWS: usize = 512;
/// Not coloured yet, or in another block.
const NO_COLOUR: u8 = 63;
/// Bundles of left-over rows that another left-over row is tried with.
const OPEN_BUNDLES: usize = 16;

/// Brings `draft` into sweep order. Returns the level, without aggregates, and the row that each row of the draft has
/// become.
pub(crate) fn arrange(draft: &Draft, blocks: &Blocks, threads: Threads) -> (Level, Vec<u32>) {
    let n = draft.rows();
    let threads = threads.for_rows(n);
    let (block, by_colour) = (blocks.size, &blocks.by_colour);
    let mut places = vec![0u32; by_colour.len()];
    for (place, &b) in by_colour.iter().enumerate() {
        places[b as usize] = place as u32;
    }

    let mut ranks = vec![0u32; n];
    let shared = Shared::new(&mut ranks);
    let plans = threads.map(0..by_colour.len(), Scratch::new, |scratch, b| {
        let range = blocks.range(b);
        // SAFETY: blocks hold disjoint rows and each is visited once.
        let slots = unsafe { shared.rows(range.clone()) };
        scratch.plan(draft, &places, b, range, block, slots)
    });

    // Rows and entries block by block in the order of colours.
    let mut block_rows = Vec::with_capacity(by_colour.len() + 1);
    let mut bases = vec![0u32; by_colour.len()];
    let bundles: usize = plans.iter().map(Vec::len).sum();
    let (mut offsets, mut middles) = (Vec::with_capacity(bundles + 2), Vec::with_capacity(bundles + 1));
    let mut total = 0u32;
    for &b in by_colour {
        let base = (offsets.len() * BUNDLE) as u32;
        block_rows.push(base);
        bases[b as usize] = base;
        for &[before, after] in &plans[b as usize] {
            offsets.push(total);
            middles.push(total + BUNDLE as u32 * before);
            total += BUNDLE as u32 * (before + after);
        }
    }
    drop(plans);
    block_rows.push((offsets.len() * BUNDLE) as u32);
    // One bundle of nothing but filling, which no block holds: see `Level::filling`.
    offsets.extend([total, total]);
    middles.push(total);
    let padded = middles.len() * BUNDLE;

    let shift = block.trailing_zeros();
    let placed = !draft.positions.is_empty();
    let mut positions = vec![Lanes::ZERO; if placed { padded } else { 0 }];
    let (ranks_out, positions_out) = (Shared::new(&mut ranks), Shared::new(&mut positions));
    threads.each(0..pieces(n, PIECE), |k| {
        for k in piece(k, n, PIECE) {
            // SAFETY: every row of the draft has its own row of the level; each is visited once.
            unsafe {
                let row = bases[k >> shift] + ranks_out.get(k);
                ranks_out.set(k, row);
                if placed {
                    positions_out.set(row as usize, draft.positions[k]);
                }
            }
        }
    });

    let mut level = Level {
        neighbours: vec![0; total as usize],
        weights: draft.weights.as_ref().map(|_| vec![0.0; total as usize]),
        diagonal: vec![0.0; padded],
        positions,
        occupied: n,
        offsets,
        middles,
        blocks: block_rows,
        colours: blocks.colours.clone(),
        ..Level::default()
    };
    fill(&mut level, draft, blocks, &ranks, threads);
    (level, ranks)
}

/// Copies the draft block by block into bundles, renames neighbours and puts those before each row first.
fn fill(level: &mut Level, draft: &Draft, blocks: &Blocks, ranks: &[u32], threads: Threads) {
    let filling = level.filling();
    let (offsets, middles, block_rows) = (&level.offsets, &level.middles, &level.blocks);
    let diagonal = Shared::new(&mut level.diagonal);
    let neighbours = Shared::new(&mut level.neighbours);
    let weights = level.weights.as_mut().map(|w| Shared::new(w));
    threads.each(0..blocks.by_colour.len(), |k| {
        let rows = block_rows[k] as usize..block_rows[k + 1] as usize;
        let bundles = rows.start / BUNDLE..rows.end / BUNDLE;
        let entries = offsets[bundles.start] as usize..offsets[bundles.end] as usize;
        // SAFETY: blocks hold disjoint rows, and rows disjoint entries; each block is visited once.
        let (diagonal, out) = unsafe { (diagonal.rows(rows.clone()), neighbours.rows(entries.clone())) };
        // SAFETY: as above.
        let mut out_weights = weights.map(|w| unsafe { w.rows(entries.clone()) });
        out.fill(filling);
        for from in blocks.range(blocks.by_colour[k] as usize) {
            let rank = ranks[from];
            let i = rank as usize;
            let source = draft.entries(from);
            let (bundle, lane) = (i / BUNDLE, i % BUNDLE);
            // From both ends: every entry is written at both, and the end that does not advance is written again.
            let mut low = offsets[bundle] as usize - entries.start + lane;
            let mut high = offsets[bundle + 1] as usize - entries.start + lane;
            let mut sum = 0.0f64;
            match (out_weights.as_deref_mut(), &draft.weights) {
                (Some(out_weights), Some(w)) => {
                    for s in source.clone() {
                        let j = ranks[draft.neighbours[s] as usize];
                        let before = usize::from(j < rank);
                        out[low] = j;
                        out[high - BUNDLE] = j;
                        out_weights[low] = w[s];
                        out_weights[high - BUNDLE] = w[s];
                        sum += f64::from(w[s]);
                        low += BUNDLE * before;
                        high -= BUNDLE * (1 - before);
                    }
                    for e in (low..high).step_by(BUNDLE) {
                        out_weights[e] = 0.0;
                    }
                }
                _ => {
                    for &s in &draft.neighbours[source.clone()] {
                        let j = ranks[s as usize];
                        let before = usize::from(j < rank);
                        out[low] = j;
                        out[high - BUNDLE] = j;
                        low += BUNDLE * before;
                        high -= BUNDLE * (1 - before);
                    }
                    sum = source.len() as f64;
                }
            }
            for e in (low..high).step_by(BUNDLE) {
                out[e] = filling;
            }
            debug_assert!(low <= middles[bundle] as usize - entries.start + lane);
            diagonal[i - rows.start] = sum as f32;
        }
    });
}

/// What rows of a block are sorted by.
#[derive(Debug, Clone, Copy, Default)]
struct Key {
    class: u16,
    before: u8,
    after: u8,
    row: u16,
}

/// Numbers of neighbours above this one count as equal in the sort.
const WIDEST: u32 = 255;

/// Scratch for ordering the rows of one block. Rows are numbered from the first of the block.
struct Scratch {
    colours: [u8; MOST_ROWS],
    /// Classes are swept one after the other; rows of one class are not adjacent.
    classes: [u16; MOST_ROWS],
    /// Neighbours of each row that are swept before it, at first only those in blocks before this one.
    before: Vec<u32>,
    /// Left-over rows in bundles of their own.
    rest: Vec<[u16; BUNDLE]>,
    stamps: Vec<u16>,
    keys: Vec<Key>,
    spare: Vec<Key>,
    tally: Vec<u16>,
    counts: [u16; LAST_COLOUR as usize + 1],
}

/// No row in this place of a bundle.
const EMPTY: u16 = u16::MAX;

impl Scratch {
    fn new() -> Scratch {
        Scratch {
            colours: [NO_COLOUR; MOST_ROWS],
            classes: [0; MOST_ROWS],
            before: Vec::new(),
            rest: Vec::new(),
            stamps: Vec::new(),
            keys: Vec::new(),
            spare: Vec::new(),
            tally: Vec::new(),
            counts: [0; LAST_COLOUR as usize + 1],
        }
    }

    /// Orders the rows of block `b`. Writes the place of each row in the block to `slots`; returns, bundle by bundle,
    /// the largest number of neighbours of its rows before and after them.
    fn plan(
        &mut self,
        draft: &Draft,
        places: &[u32],
        b: usize,
        range: std::ops::Range<usize>,
        block: usize,
        slots: &mut [u32],
    ) -> Vec<[u32; 2]> {
        let shift = block.trailing_zeros();
        let (mask, own) = (block as u32 - 1, b as u32);
        let row = |k: usize| draft.row(range.start + k);
        let inside = |j: u32| (j >> shift == own, (j & mask) as usize % MOST_ROWS);
        let here = places[b];
        let outer = |j: u32| u32::from(places[(j >> shift) as usize] < here);
        self.colour(row, range.len(), inside, outer);
        self.bundle_rest(row, range.len(), inside);

        // Inside a class, rows with equal numbers of neighbours before and after them come together; every second
        // group runs backwards, so that its neighbours in the list are alike too.
        self.keys.clear();
        for k in 0..range.len() {
            let class = self.classes[k];
            let earlier = |&j: &u32| {
                let (inside, j) = inside(j);
                u32::from(inside & (self.classes[j] < class))
            };
            let before = self.before[k] + row(k).iter().map(earlier).sum::<u32>();
            let after = row(k).len() as u32 - before;
            self.before[k] = before;
            let (before, after) = (before.min(WIDEST), after.min(WIDEST));
            let after = if before % 2 == 1 { WIDEST - after } else { after };
            self.keys.push(Key {
                class,
                before: before as u8,
                after: after as u8,
                row: k as u16,
            });
        }
        self.sort_keys();
        let mut widths: Vec<[u32; 2]> = Vec::with_capacity(range.len().div_ceil(BUNDLE) + self.rest.len());
        let (mut filled, mut last) = (BUNDLE, u16::MAX);
        for &Key { class, row: k, .. } in &self.keys {
            let k = usize::from(k);
            if filled == BUNDLE || class != last {
                widths.push([0; 2]);
                (filled, last) = (0, class);
            }
            slots[k] = ((widths.len() - 1) * BUNDLE + filled) as u32;
            filled += 1;
            let before = self.before[k];
            let after = row(k).len() as u32 - before;
            if let Some(width) = widths.last_mut() {
                *width = [width[0].max(before), width[1].max(after)];
            }
        }
        widths
    }

    /// Sorts by class, then by neighbours before, then by neighbours after; equal keys keep their order.
    fn sort_keys(&mut self) {
        let pass = |from: &[Key], to: &mut Vec<Key>, counts: &mut Vec<u16>, digit: &dyn Fn(&Key) -> usize| {
            counts.clear();
            for key in from {
                let d = digit(key);
                if counts.len() <= d + 1 {
                    counts.resize(d + 2, 0);
                }
                counts[d + 1] += 1;
            }
            for d in 1..counts.len() {
                counts[d] += counts[d - 1];
            }
            to.clear();
            to.resize(from.len(), Key::default());
            for key in from {
                let slot = &mut counts[digit(key)];
                to[usize::from(*slot)] = *key;
                *slot += 1;
            }
        };
        pass(&self.keys, &mut self.spare, &mut self.tally, &|k| usize::from(k.after));
        pass(&self.spare, &mut self.keys, &mut self.tally, &|k| usize::from(k.before));
        pass(&self.keys, &mut self.spare, &mut self.tally, &|k| usize::from(k.class));
        std::mem::swap(&mut self.keys, &mut self.spare);
    }

    /// Colours the rows greedily in their order, and counts neighbours that `outer` says are in blocks before this one.
    fn colour<'r>(
        &mut self,
        row: impl Fn(usize) -> &'r [u32],
        rows: usize,
        inside: impl Fn(u32) -> (bool, usize),
        outer: impl Fn(u32) -> u32,
    ) {
        self.before.clear();
        self.colours.fill(NO_COLOUR);
        self.counts.fill(0);
        for k in 0..rows {
            let mut taken = 0u64;
            let mut before = 0;
            for &j in row(k) {
                before += outer(j);
                let (inside, j) = inside(j);
                taken |= 1 << if inside { self.colours[j] } else { NO_COLOUR };
            }
            self.before.push(before);
            let colour = ((!taken).trailing_zeros() as u8).min(LAST_COLOUR);
            self.colours[k] = colour;
            self.counts[usize::from(colour)] += 1;
        }
    }

    /// Takes out of each colour what does not fill a bundle and bundles these rows as far as they are not adjacent.
    /// Every such bundle becomes a class of its own after all colours.
    fn bundle_rest<'r>(
        &mut self,
        row: impl Fn(usize) -> &'r [u32],
        rows: usize,
        inside: impl Fn(u32) -> (bool, usize),
    ) {
        for (colour, count) in self.counts.iter_mut().enumerate() {
            if colour != usize::from(LAST_COLOUR) {
                *count %= BUNDLE as u16;
            }
        }
        self.classes = self.colours.map(u16::from);
        self.rest.clear();
        self.stamps.clear();
        self.stamps.resize(rows, EMPTY);
        for k in (0..rows).rev() {
            let count = &mut self.counts[usize::from(self.colours[k])];
            if *count == 0 {
                continue;
            }
            *count -= 1;
            for (_, j) in row(k).iter().map(|&j| inside(j)).filter(|(inside, _)| *inside) {
                self.stamps[j] = k as u16;
            }
            let first = self.rest.len().saturating_sub(OPEN_BUNDLES);
            let fits = |bundle: &[u16; BUNDLE]| {
                let apart = |&m: &u16| m == EMPTY || self.stamps[usize::from(m)] != k as u16;
                bundle[BUNDLE - 1] == EMPTY && bundle.iter().all(apart)
            };
            let at = self.rest[first..].iter().position(fits).map(|at| first + at);
            let at = at.unwrap_or_else(|| {
                self.rest.push([EMPTY; BUNDLE]);
                self.rest.len() - 1
            });
            if let Some(place) = self.rest[at].iter_mut().find(|m| **m == EMPTY) {
                *place = k as u16;
            }
            self.classes[k] = (usize::from(NO_COLOUR) + 1 + at) as u16;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::level::NONE;
    use super::super::testing::Block;
    use super::*;

    #[test]
    fn arranging_keeps_the_graph() {
        let block = Block::new(9, 8, 7).weighted();
        let hierarchy = block.hierarchy(1);
        let level = &hierarchy.levels[0];
        let mut ranks = vec![0; block.positions.len()];
        for (row, &vertex) in hierarchy.order.iter().enumerate().filter(|o| *o.1 != NONE) {
            ranks[vertex as usize] = row as u32;
        }
        let mut filling = 0;
        for (row, &vertex) in hierarchy.order.iter().enumerate() {
            if vertex == NONE {
                filling += 1;
                assert_eq!(level.row(row).count(), 0);
                assert_eq!(level.diagonal[row], 0.0);
                continue;
            }
            let vertex = vertex as usize;
            let source = block.offsets[vertex] as usize..block.offsets[vertex + 1] as usize;
            let weights = block.weights.as_ref().unwrap();
            let scale = hierarchy.weight_scale as f32;
            let mut want: Vec<(u32, f32)> = source
                .map(|e| (ranks[block.neighbours[e] as usize], weights[e] * scale))
                .collect();
            let mut seen: Vec<(u32, f32)> = level.row(row).map(|(j, w)| (j as u32, w)).collect();
            want.sort_by_key(|w| w.0);
            seen.sort_by_key(|w| w.0);
            assert_eq!(seen, want);
            let (begin, middle, end) = level.bundle(row / BUNDLE);
            for e in (begin + row % BUNDLE..end).step_by(BUNDLE) {
                let j = level.neighbours[e] as usize;
                assert!(j == level.filling() as usize || (j < row) == (e < middle));
            }
            let sum: f32 = want.iter().map(|w| w.1).sum();
            assert!((sum - level.diagonal[row]).abs() < 1e-4 * sum);
        }
        assert!(filling < level.rows() / 10, "{filling} of {}", level.rows());
    }

    /// The promise on which parallel sweeps and their unsafe code rest, and that of sweeping four rows at a time.
    #[test]
    fn blocks_of_one_colour_and_rows_of_one_bundle_do_not_touch() {
        let block = Block::new(14, 13, 12);
        let hierarchy = block.hierarchy(1);
        for level in &hierarchy.levels {
            assert_eq!(level.blocks.first(), Some(&0));
            assert_eq!(*level.blocks.last().unwrap() as usize + BUNDLE, level.rows());
            assert_eq!(*level.colours.last().unwrap() as usize, level.blocks.len() - 1);
            let block_of = |row: usize| level.blocks.partition_point(|&b| b as usize <= row) - 1;
            let colour_of = |row: usize| level.colours.partition_point(|&c| c as usize <= block_of(row)) - 1;
            for row in 0..level.rows() {
                for (j, _) in level.row(row) {
                    assert!(block_of(row) == block_of(j) || colour_of(row) != colour_of(j));
                    assert_ne!(row / BUNDLE, j / BUNDLE, "rows {row} and {j} are adjacent");
                }
            }
        }
        assert!(hierarchy.levels[0].colours.len() > 2 && hierarchy.levels.len() > 2);
    }

    #[test]
    fn graphs_without_independent_rows_are_bundled_one_by_one() {
        // A complete graph: no two rows can share a bundle.
        let n = 70u32;
        let offsets: Vec<u32> = (0..=n).map(|i| i * (n - 1)).collect();
        let neighbours: Vec<u32> = (0..n).flat_map(|i| (0..n).filter(move |&j| j != i)).collect();
        let draft = Draft {
            offsets,
            neighbours,
            ..Draft::default()
        };
        let threads = Threads::of(&super::super::testing::pool());
        let (level, mut ranks) = arrange(&draft, &Blocks::new(&draft, 64, threads), threads);
        ranks.sort_unstable();
        ranks.dedup();
        assert_eq!(ranks.len(), 70);
        let filled = (0..level.rows()).filter(|&i| level.diagonal[i] == 69.0).count();
        assert_eq!(filled, 70);
    }
}
