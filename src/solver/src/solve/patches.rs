//! The original equations on one level, whose rows carry their members along as affine patches.

use crate::lanes::{Lanes, prefetch};
use crate::storage::resize_untouched;

/// A linear map by its columns.
pub(crate) type PatchMap = [Lanes; 3];

/// The original equations on one level.
#[derive(Debug, Default)]
pub(crate) struct AffinePatches {
    /// F of each row, or empty.
    pub(crate) maps: Vec<PatchMap>,
    pub(crate) positions: Vec<Lanes>,
    /// β of equation (12).
    pub(crate) beta: Vec<Lanes>,
    /// Given values on masked rows, the solution on free ones.
    pub(crate) x: Vec<Lanes>,
}

impl AffinePatches {
    pub(crate) fn byte_size(&self) -> usize {
        48 * self.maps.capacity() + 16 * (self.positions.capacity() + self.beta.capacity() + self.x.capacity())
    }

    pub(crate) fn resize(&mut self, rows: usize, mapped: bool) {
        let mapped = if mapped { rows } else { 0 };
        resize_untouched(&mut self.maps, mapped);
        resize_untouched(&mut self.positions, mapped);
        resize_untouched(&mut self.beta, rows);
        resize_untouched(&mut self.x, rows);
    }

    /// Asks memory for these rows.
    #[inline(always)]
    pub(crate) fn prefetch(&self, rows: &[u32]) {
        for i in rows.iter().map(|&i| i as usize) {
            if !self.maps.is_empty() {
                prefetch(&self.maps, i);
                prefetch(&self.positions, i);
            }
            prefetch(&self.beta, i);
            prefetch(&self.x, i);
        }
    }

    /// map · (p − centre) for a row's position p.
    #[inline(always)]
    pub(crate) fn offset(&self, map: &PatchMap, row: usize, centre: Lanes) -> Lanes {
        times(map, self.positions[row] - centre)
    }

    /// d_ij = ½ (F_i + F_j) (p_i − p_j), 0 without maps.
    #[inline(always)]
    pub(crate) fn edge(&self, i: usize, j: usize) -> Lanes {
        if self.maps.is_empty() {
            return Lanes::ZERO;
        }
        let (a, b) = (&self.maps[i], &self.maps[j]);
        let sum = [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        times(&sum, self.positions[i] - self.positions[j]) * 0.5
    }
}

#[inline(always)]
pub(crate) fn times(map: &PatchMap, v: Lanes) -> Lanes {
    map[0] * v.0[0] + map[1] * v.0[1] + map[2] * v.0[2]
}
