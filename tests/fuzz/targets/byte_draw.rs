//! Choices and numbers taken from arbitrary bytes, so that a small change of the bytes is a small change of what they say.

use glam::DVec3;

/// Draws from bytes; zeros when they have ended.
pub struct ByteDraw<'a>(pub &'a [u8]);

impl ByteDraw<'_> {
    /// Whether all bytes are drawn.
    pub fn is_done(&self) -> bool {
        self.0.is_empty()
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        first
    }

    /// A whole number below `count`, at most 256.
    pub fn below(&mut self, count: usize) -> usize {
        usize::from(self.byte()) % count.max(1)
    }

    /// Yes or no.
    pub fn flag(&mut self) -> bool {
        self.byte() & 1 == 1
    }

    /// A number between -1 and 1; one time in sixteen one that nobody expects.
    pub fn number(&mut self) -> f64 {
        let (high, low) = (self.byte(), self.byte());
        if high >= 0xf0 {
            let odd = [0.0, -0.0, 1.0, -1.0, 1e-300, 1e-12, 1e9, -1e9, 1e300, f64::MIN_POSITIVE];
            return odd[usize::from(low) % odd.len()];
        }
        f64::from(i16::from_be_bytes([high, low])) / 32768.0
    }

    /// Three numbers.
    pub fn vector(&mut self) -> DVec3 {
        DVec3::new(self.number(), self.number(), self.number())
    }
}
