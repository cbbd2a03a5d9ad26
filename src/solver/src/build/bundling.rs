//! The order of rows inside a block: colours, and bundles of four rows with nearly equal numbers of neighbours.

use crate::build::draft::{LevelDraft, RowBlocks};
use crate::lanes::SLICE_ROWS;

/// Largest colour inside a block; rows that would need a higher one are bundled one by one.
const LAST_COLOUR: u8 = 62;
/// Rows of a block at most. Arrays of this size need no checks of indices that are cut to it.
const MOST_ROWS: usize = 512;
/// Not coloured yet, or in another block.
const NO_COLOUR: u8 = 63;
/// Bundles of left-over rows that another left-over row is tried with.
const OPEN_BUNDLES: usize = 16;

/// What rows of a block are sorted by.
#[derive(Debug, Clone, Copy, Default)]
struct SliceKey {
    class: u16,
    before: u8,
    after: u8,
    row: u16,
}

/// Numbers of neighbours above this one count as equal in the sort.
const WIDEST: u32 = 255;

/// Neighbours of a row that come before it in its block are read in runs of this length, filled up with [`PADDING`]: how many
/// there are need not be guessed, for most rows have one run.
const RUN: usize = 8;
/// Stands for no row: it has no colour and comes before none.
const PADDING: u16 = MOST_ROWS as u16;
/// Length of arrays by row and padding; indices are cut to it, which needs no check.
const ROOM: usize = 2 * MOST_ROWS;

/// Scratch for ordering the rows of one block. Rows are numbered from the first of the block.
pub(crate) struct SlicePlanner {
    /// Neighbours inside the block with a smaller number, row by row in whole runs. In a symmetric graph that is every edge once.
    smaller: Vec<[u16; RUN]>,
    /// Where the runs of each row begin, and their number.
    runs: Vec<u32>,
    /// A bit for the colour of each row; none for rows without one, and for padding.
    colour_bits: [u64; ROOM],
    colours: [u8; MOST_ROWS],
    /// Classes are swept one after the other; rows of one class are not adjacent.
    classes: [u16; ROOM],
    /// Neighbours of each row that are swept before it, at first only those in blocks before this one.
    before: [u32; ROOM],
    /// Rows of the block.
    rows: usize,
    /// Left-over rows in bundles of their own.
    rest: Vec<[u16; SLICE_ROWS]>,
    stamps: [u16; ROOM],
    keys: Vec<SliceKey>,
    spare: Vec<SliceKey>,
    tally: Vec<u16>,
    counts: [u16; LAST_COLOUR as usize + 1],
}

/// No row in this place of a bundle.
const EMPTY: u16 = u16::MAX;

/// A row or padding as an index into arrays of [`ROOM`].
#[inline(always)]
fn at(j: u16) -> usize {
    usize::from(j) % ROOM
}

impl SlicePlanner {
    pub(crate) fn new() -> SlicePlanner {
        SlicePlanner {
            smaller: Vec::new(),
            runs: Vec::new(),
            colour_bits: [0; ROOM],
            colours: [NO_COLOUR; MOST_ROWS],
            classes: [0; ROOM],
            before: [0; ROOM],
            rows: 0,
            rest: Vec::new(),
            stamps: [EMPTY; ROOM],
            keys: Vec::new(),
            spare: Vec::new(),
            tally: Vec::new(),
            counts: [0; LAST_COLOUR as usize + 1],
        }
    }

    /// Orders the rows of block `b`; `places` says when each block is swept. Writes the place of each row in the block to `slots`; returns, bundle by bundle,
    /// the largest number of neighbours of its rows before and after them.
    pub(crate) fn plan_slices(
        &mut self,
        draft: &LevelDraft,
        blocks: &RowBlocks,
        places: &[u32],
        b: usize,
        slots: &mut [u32],
    ) -> Vec<[u32; 2]> {
        let range = blocks.range(b);
        self.split_neighbours(draft, blocks, places, b);
        self.colour();
        self.bundle_rest(
            &draft.offsets[range.start..=range.end],
            &draft.neighbours,
            range.start as u32,
        );
        self.count_before();

        // Inside a class, rows with equal numbers of neighbours before and after them come together; every second
        // group runs backwards, so that its neighbours in the list are alike too.
        self.keys.clear();
        let lengths = draft.offsets[range.start..=range.end].windows(2).map(|w| w[1] - w[0]);
        for ((k, length), (&class, &before)) in (0..).zip(lengths).zip(self.classes.iter().zip(&self.before)) {
            // As many as there are, where the graph is symmetric as promised.
            let after = length.saturating_sub(before);
            let (before, after) = (before.min(WIDEST), after.min(WIDEST));
            let after = if before % 2 == 1 { WIDEST - after } else { after };
            self.keys.push(SliceKey {
                class,
                before: before as u8,
                after: after as u8,
                row: k,
            });
        }
        self.sort_keys();
        let mut widths: Vec<[u32; 2]> = Vec::with_capacity(range.len().div_ceil(SLICE_ROWS) + self.rest.len());
        let (mut filled, mut last) = (SLICE_ROWS, u16::MAX);
        for &SliceKey { class, row: k, .. } in &self.keys {
            let k = usize::from(k);
            if filled == SLICE_ROWS || class != last {
                widths.push([0; 2]);
                (filled, last) = (0, class);
            }
            slots[k] = ((widths.len() - 1) * SLICE_ROWS + filled) as u32;
            filled += 1;
            let before = self.before[k];
            let after = (draft.row(range.start + k).len() as u32).saturating_sub(before);
            if let Some(width) = widths.last_mut() {
                *width = [width[0].max(before), width[1].max(after)];
            }
        }
        widths
    }

    /// Writes down the neighbours inside block `b` that come before each row, and counts those in blocks before it.
    fn split_neighbours(&mut self, draft: &LevelDraft, blocks: &RowBlocks, places: &[u32], b: usize) {
        let range = blocks.range(b);
        let shift = blocks.size.trailing_zeros();
        let (first, here) = (range.start as u32, places[b]);
        self.rows = range.len();
        let entries = draft.offsets[range.start] as usize..draft.offsets[range.end] as usize;
        // A run more than each row needs, since rows that do not count are written too.
        let most = entries.len() / RUN + 2 * range.len();
        if self.smaller.len() < most {
            self.smaller.resize(most, [PADDING; RUN]);
        }
        self.runs.clear();
        let mut used = 0;
        for (k, i) in (0..).zip(range) {
            let row = draft.row(i);
            let smaller = self.smaller[used..].as_flattened_mut();
            let (mut count, mut before) = (0, 0);
            for &j in row {
                let local = j.wrapping_sub(first);
                smaller[count] = local as u16;
                count += usize::from(local < k);
                before += u32::from(places[(j >> shift) as usize] < here);
            }
            smaller[count..count + RUN].fill(PADDING);
            self.runs.push(used as u32);
            self.before[at(k as u16)] = before;
            used += count.div_ceil(RUN);
        }
        self.runs.push(used as u32);
    }

    /// Adds to the neighbours before each row those inside the block, which are of smaller classes.
    fn count_before(&mut self) {
        for k in 0..self.rows {
            let class = u32::from(self.classes[at(k as u16)]);
            let mut before = 0;
            for run in &self.smaller[self.runs[k] as usize..self.runs[k + 1] as usize] {
                for &j in run {
                    // The sign of the difference, and no question. Padding is of the largest class.
                    let other = u32::from(self.classes[at(j)]);
                    before += other.wrapping_sub(class) >> 31;
                    self.before[at(j)] += class.wrapping_sub(other) >> 31;
                }
            }
            self.before[at(k as u16)] += before;
        }
    }

    /// Sorts by class, then by neighbours before, then by neighbours after; equal keys keep their order.
    fn sort_keys(&mut self) {
        fn pass(
            from: &[SliceKey],
            to: &mut Vec<SliceKey>,
            counts: &mut Vec<u16>,
            digits: usize,
            digit: impl Fn(&SliceKey) -> usize,
        ) {
            counts.clear();
            counts.resize(digits + 1, 0);
            for key in from {
                counts[digit(key) + 1] += 1;
            }
            for d in 1..counts.len() {
                counts[d] += counts[d - 1];
            }
            to.clear();
            to.resize(from.len(), SliceKey::default());
            for key in from {
                let slot = &mut counts[digit(key)];
                to[usize::from(*slot)] = *key;
                *slot += 1;
            }
        }
        const WIDTHS: usize = WIDEST as usize + 1;
        let classes = 1 + usize::from(NO_COLOUR) + self.rest.len();
        pass(&self.keys, &mut self.spare, &mut self.tally, WIDTHS, |k| {
            usize::from(k.after)
        });
        pass(&self.spare, &mut self.keys, &mut self.tally, WIDTHS, |k| {
            usize::from(k.before)
        });
        pass(&self.keys, &mut self.spare, &mut self.tally, classes, |k| {
            usize::from(k.class)
        });
        std::mem::swap(&mut self.keys, &mut self.spare);
    }

    /// Colours the rows greedily in their order.
    fn colour(&mut self) {
        self.colour_bits.fill(0);
        self.counts.fill(0);
        for k in 0..self.rows {
            let runs = &self.smaller[self.runs[k] as usize..self.runs[k + 1] as usize];
            let bits =
                |taken: u64, run: &[u16; RUN]| run.map(|j| self.colour_bits[at(j)]).iter().fold(taken, |a, b| a | b);
            let taken = runs.iter().fold(0, bits);
            let colour = ((!taken).trailing_zeros() as u8).min(LAST_COLOUR);
            self.colour_bits[k % MOST_ROWS] = 1 << colour;
            self.colours[k % MOST_ROWS] = colour;
            self.counts[usize::from(colour)] += 1;
        }
    }

    /// Takes out of each colour what does not fill a bundle and bundles these rows as far as they are not adjacent.
    /// Every such bundle becomes a class of its own after all colours.
    fn bundle_rest(&mut self, offsets: &[u32], neighbours: &[u32], first: u32) {
        let rows = self.rows;
        for (colour, count) in self.counts.iter_mut().enumerate() {
            if colour != usize::from(LAST_COLOUR) {
                *count %= SLICE_ROWS as u16;
            }
        }
        self.classes.fill(u16::MAX);
        for (class, &colour) in self.classes.iter_mut().zip(&self.colours[..rows]) {
            *class = u16::from(colour);
        }
        self.rest.clear();
        self.stamps.fill(EMPTY);
        for k in (0..rows).rev() {
            let count = &mut self.counts[usize::from(self.colours[k])];
            if *count == 0 {
                continue;
            }
            *count -= 1;
            for &j in &neighbours[offsets[k] as usize..offsets[k + 1] as usize] {
                // Those outside the block are no row of it.
                let local = j.wrapping_sub(first).min(u32::from(PADDING));
                self.stamps[at(local as u16)] = k as u16;
            }
            let latest = self.rest.len().saturating_sub(OPEN_BUNDLES);
            let fits = |bundle: &[u16; SLICE_ROWS]| {
                let apart = |&m: &u16| m == EMPTY || self.stamps[at(m)] != k as u16;
                bundle[SLICE_ROWS - 1] == EMPTY && bundle.iter().all(apart)
            };
            let open = self.rest[latest..].iter().position(fits).map(|open| latest + open);
            let open = open.unwrap_or_else(|| {
                self.rest.push([EMPTY; SLICE_ROWS]);
                self.rest.len() - 1
            });
            if let Some(place) = self.rest[open].iter_mut().find(|m| **m == EMPTY) {
                *place = k as u16;
            }
            self.classes[k] = (usize::from(NO_COLOUR) + 1 + open) as u16;
        }
    }
}
