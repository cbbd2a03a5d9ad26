//! Scales of local frames that change along the harmonic fields of handles.

use crate::fields::HarmonicFields;
use crate::first_pass::blend::LocalFrame;
use pliant_exec::pool::Pool;

/// Values of a field at which there is a scale, evenly from 0 to 1: sections of what bends.
pub(crate) const SECTIONS: usize = 33;

/// By hold, the logarithms of the scales at the sections of its field; empty where nothing is scaled.
#[derive(Debug, Clone, Default)]
pub(crate) struct VolumeScales {
    of_hold: Vec<[f64; SECTIONS]>,
}

impl VolumeScales {
    /// With these of each hold.
    pub fn new(of_hold: Vec<[f64; SECTIONS]>) -> Self {
        Self { of_hold }
    }

    /// Scales frames.
    pub fn apply(
        &self,
        fields: &HarmonicFields,
        frames: &mut [LocalFrame],
        pool: &Pool,
        is_open: impl Fn(usize) -> bool + Sync,
    ) {
        if self.of_hold.is_empty() {
            return;
        }
        let scale = |node: usize| {
            let mut sum = 0.0;
            for (scales, field) in self.of_hold.iter().zip(fields.all()) {
                if let Some(&u) = field.get(node).filter(|u| **u > 0.0) {
                    let (below, share) = section(u);
                    sum += f64::from(u) * (scales[below] * (1.0 - share) + scales[below + 1] * share);
                }
            }
            libm::exp(sum) as f32
        };
        let scales = pool.map(frames.len(), 1024, |node| if is_open(node) { scale(node) } else { 1.0 });
        frames
            .iter_mut()
            .zip(scales)
            .for_each(|(frame, scale)| frame.iter_mut().for_each(|v| *v *= scale));
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.of_hold.capacity() * size_of::<[f64; SECTIONS]>()
    }
}

/// The section below a value of a field, and which part of the way to the next one the value is.
pub(crate) fn section(u: f32) -> (usize, f64) {
    let at = f64::from(u).clamp(0.0, 1.0) * (SECTIONS - 1) as f64;
    let below = (at as usize).min(SECTIONS - 2);
    (below, at - below as f64)
}
