//! Scales of local frames that change along the harmonic fields of handles.

use crate::fields::HarmonicFields;
use crate::first_pass::blend::LocalFrame;
use crate::rotation::Transform;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Values of a field at which there is a scale, evenly from 0 to 1: sections of what bends.
pub(crate) const SECTIONS: usize = 33;

/// Holds in groups that move alike.
#[derive(Debug, Clone, Default)]
pub(crate) struct AlikeHolds {
    groups: Vec<Vec<usize>>,
    /// By hold: its group.
    group_of: Vec<usize>,
}

impl AlikeHolds {
    /// Groups all holds; those without a transform do not move.
    pub fn groups(transforms: &[Transform], holds: usize) -> Self {
        let motion = |hold: usize| transforms.get(hold).filter(|t| !t.is_identity());
        let mut all = Self::default();
        for hold in 0..holds {
            let alike = |group: &Vec<usize>| motion(group[0]) == motion(hold);
            let group = all.groups.iter().position(alike).unwrap_or(all.groups.len());
            all.groups.resize(all.groups.len().max(group + 1), Vec::new());
            all.groups[group].push(hold);
            all.group_of.push(group);
        }
        all
    }

    /// How many groups there are.
    pub fn count(&self) -> usize {
        self.groups.len()
    }

    /// Calls `each` with the groups that may have a say at a node, rising, and the sum of their fields there, 0 to 1; `scratch` is
    /// memory.
    pub fn each_share(
        &self,
        fields: &HarmonicFields,
        node: usize,
        scratch: &mut Vec<(usize, f32)>,
        mut each: impl FnMut(usize, f32),
    ) {
        if fields.sparse().is_none() {
            for (group, holds) in self.groups.iter().enumerate() {
                let sum = holds.iter().map(|hold| fields.at(*hold, node)).sum::<f32>();
                each(group, sum.clamp(0.0, 1.0));
            }
            return;
        }
        scratch.clear();
        fields.each_at(node, |hold, u| scratch.push((self.group_of[hold], u)));
        scratch.sort_by_key(|s| s.0);
        for group in scratch.chunk_by(|a, b| a.0 == b.0) {
            let sum = group.iter().map(|s| s.1).sum::<f32>();
            each(group[0].0, sum.clamp(0.0, 1.0));
        }
    }
}

/// The logarithms of the scales at the sections of the fields of holds that move alike; empty where nothing is scaled.
#[derive(Debug, Clone, Default)]
pub struct VolumeScales {
    holds: AlikeHolds,
    /// By group.
    scales: Vec<[f64; SECTIONS]>,
}

impl VolumeScales {
    /// With these of each group.
    pub(crate) fn new(holds: AlikeHolds, scales: Vec<[f64; SECTIONS]>) -> Self {
        Self { holds, scales }
    }

    /// Scales frames.
    pub(crate) fn apply(
        &self,
        fields: &HarmonicFields,
        frames: &mut [LocalFrame],
        pool: &Pool,
        is_open: impl Fn(usize) -> bool + Sync,
    ) {
        if self.scales.is_empty() {
            return;
        }
        let scale = |node: usize, scratch: &mut Vec<(usize, f32)>| {
            let mut sum = 0.0;
            self.holds.each_share(fields, node, scratch, |group, u| {
                let (scales, (below, part)) = (&self.scales[group], section(u));
                sum += f64::from(u) * (scales[below] * (1.0 - part) + scales[below + 1] * part);
            });
            libm::exp(sum) as f32
        };
        pool.install(|| {
            let frames = frames.par_iter_mut().with_min_len(1024).enumerate();
            frames.for_each_init(Vec::new, |scratch, (node, frame)| {
                if is_open(node) {
                    let scale = scale(node, scratch);
                    frame.iter_mut().for_each(|v| *v *= scale);
                }
            });
        });
    }

    /// Whether nothing is scaled.
    pub fn is_empty(&self) -> bool {
        self.scales.is_empty()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let holds: usize = self.holds.groups.iter().map(Vec::capacity).sum();
        (holds + self.holds.group_of.capacity()) * size_of::<usize>()
            + self.holds.groups.capacity() * size_of::<Vec<usize>>()
            + self.scales.capacity() * size_of::<[f64; SECTIONS]>()
    }
}

/// The section below a value of a field, and which part of the way to the next one the value is.
pub(crate) fn section(u: f32) -> (usize, f64) {
    let at = f64::from(u).clamp(0.0, 1.0) * (SECTIONS - 1) as f64;
    let below = (at as usize).min(SECTIONS - 2);
    (below, at - below as f64)
}
