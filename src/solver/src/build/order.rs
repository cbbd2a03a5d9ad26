//! Sequences of vertices: along a space-filling curve, or breadth first where no positions are known.

use crate::lanes::{Lanes, SharedRows};
use crate::threads::{Parallelism, piece_rows};

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
