//! Numbers drawn from a seed, the same everywhere.

use glam::DVec3;

/// SplitMix64 (Steele, Lea and Flood 2014): the same numbers everywhere.
pub struct Draw(pub u64);

impl Draw {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// A whole number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count.max(1) as u64) as usize
    }

    /// A number from `low` to `high`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A direction.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let [x, y, z] = [0; 3].map(|_| self.within(-1.0, 1.0));
            let v = DVec3::new(x, y, z);
            if (0.01..1.0).contains(&v.length()) {
                return v.normalize();
            }
        }
    }
}
