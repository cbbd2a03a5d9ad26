//! Scales of local frames that change along the harmonic fields of handles.

use crate::fields::HarmonicFields;
use crate::first_pass::blend::LocalFrame;
use crate::rotation::Transform;
use pliant_exec::pool::Pool;

/// Values of a field at which there is a scale, evenly from 0 to 1: sections of what bends.
pub(crate) const SECTIONS: usize = 33;

/// Holds that move alike, and the sum of their fields.
#[derive(Debug, Clone)]
pub(crate) struct AlikeHolds(Vec<usize>);

impl AlikeHolds {
    /// Groups all holds; those without a transform do not move.
    pub fn groups(transforms: &[Transform], holds: usize) -> Vec<Self> {
        let motion = |hold: usize| transforms.get(hold).filter(|t| !t.is_identity());
        let mut groups: Vec<Self> = Vec::new();
        for hold in 0..holds {
            match groups.iter_mut().find(|group| motion(group.0[0]) == motion(hold)) {
                Some(group) => group.0.push(hold),
                None => groups.push(Self(vec![hold])),
            }
        }
        groups
    }

    /// The sum of the fields at a node, 0 to 1.
    pub fn share(&self, fields: &HarmonicFields, node: usize) -> f32 {
        let of_hold = |hold: &usize| fields.of(*hold).get(node).copied().unwrap_or(0.0);
        self.0.iter().map(of_hold).sum::<f32>().clamp(0.0, 1.0)
    }
}

/// The logarithms of the scales at the sections of the fields of holds that move alike; empty where nothing is scaled.
#[derive(Debug, Clone, Default)]
pub struct VolumeScales {
    groups: Vec<(AlikeHolds, [f64; SECTIONS])>,
}

impl VolumeScales {
    /// With these of each group.
    pub(crate) fn new(groups: Vec<AlikeHolds>, scales: Vec<[f64; SECTIONS]>) -> Self {
        Self {
            groups: groups.into_iter().zip(scales).collect(),
        }
    }

    /// Scales frames.
    pub(crate) fn apply(
        &self,
        fields: &HarmonicFields,
        frames: &mut [LocalFrame],
        pool: &Pool,
        is_open: impl Fn(usize) -> bool + Sync,
    ) {
        if self.groups.is_empty() {
            return;
        }
        let scale = |node: usize| {
            let of_group = |(holds, scales): &(AlikeHolds, [f64; SECTIONS])| {
                let u = holds.share(fields, node);
                let (below, part) = section(u);
                f64::from(u) * (scales[below] * (1.0 - part) + scales[below + 1] * part)
            };
            libm::exp(self.groups.iter().map(of_group).sum()) as f32
        };
        let scales = pool.map(frames.len(), 1024, |node| if is_open(node) { scale(node) } else { 1.0 });
        frames
            .iter_mut()
            .zip(scales)
            .for_each(|(frame, scale)| frame.iter_mut().for_each(|v| *v *= scale));
    }

    /// Whether nothing is scaled.
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let holds: usize = self.groups.iter().map(|(holds, _)| holds.0.capacity()).sum();
        holds * size_of::<usize>() + self.groups.capacity() * size_of::<(AlikeHolds, [f64; SECTIONS])>()
    }
}

/// The section below a value of a field, and which part of the way to the next one the value is.
pub(crate) fn section(u: f32) -> (usize, f64) {
    let at = f64::from(u).clamp(0.0, 1.0) * (SECTIONS - 1) as f64;
    let below = (at as usize).min(SECTIONS - 2);
    (below, at - below as f64)
}
