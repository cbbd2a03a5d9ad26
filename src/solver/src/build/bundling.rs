//! The order of rows inside a block: colours, and bundles of four rows with nearly equal numbers of neighbours.

use crate::build::draft::{LevelDraft, RowBlocks};
use crate::storage::SLICE_ROWS;

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

/// Scratch for ordering the rows of one block. Rows are numbered from the first of the block.
pub(crate) struct SlicePlanner {
    colours: [u8; MOST_ROWS],
    /// Classes are swept one after the other; rows of one class are not adjacent.
    classes: [u16; MOST_ROWS],
    /// Neighbours of each row that are swept before it, at first only those in blocks before this one.
    before: Vec<u32>,
    /// Left-over rows in bundles of their own.
    rest: Vec<[u16; SLICE_ROWS]>,
    stamps: Vec<u16>,
    keys: Vec<SliceKey>,
    spare: Vec<SliceKey>,
    tally: Vec<u16>,
    counts: [u16; LAST_COLOUR as usize + 1],
}

/// No row in this place of a bundle.
const EMPTY: u16 = u16::MAX;

impl SlicePlanner {
    pub(crate) fn new() -> SlicePlanner {
        SlicePlanner {
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
        let shift = blocks.size.trailing_zeros();
        let (mask, own) = (blocks.size as u32 - 1, b as u32);
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
            self.keys.push(SliceKey {
                class,
                before: before as u8,
                after: after as u8,
                row: k as u16,
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
            let after = row(k).len() as u32 - before;
            if let Some(width) = widths.last_mut() {
                *width = [width[0].max(before), width[1].max(after)];
            }
        }
        widths
    }

    /// Sorts by class, then by neighbours before, then by neighbours after; equal keys keep their order.
    fn sort_keys(&mut self) {
        let pass =
            |from: &[SliceKey], to: &mut Vec<SliceKey>, counts: &mut Vec<u16>, digit: &dyn Fn(&SliceKey) -> usize| {
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
                to.resize(from.len(), SliceKey::default());
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
                *count %= SLICE_ROWS as u16;
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
            let fits = |bundle: &[u16; SLICE_ROWS]| {
                let apart = |&m: &u16| m == EMPTY || self.stamps[usize::from(m)] != k as u16;
                bundle[SLICE_ROWS - 1] == EMPTY && bundle.iter().all(apart)
            };
            let at = self.rest[first..].iter().position(fits).map(|at| first + at);
            let at = at.unwrap_or_else(|| {
                self.rest.push([EMPTY; SLICE_ROWS]);
                self.rest.len() - 1
            });
            if let Some(place) = self.rest[at].iter_mut().find(|m| **m == EMPTY) {
                *place = k as u16;
            }
            self.classes[k] = (usize::from(NO_COLOUR) + 1 + at) as u16;
        }
    }
}
