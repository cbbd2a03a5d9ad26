//! First-pass fields after an edit begin where those before it ended.

use super::{Body, Fields, Rigging};
use crate::mesh::NONE;
use crate::pool::Pool;
use rayon::prelude::*;
use std::sync::Arc;

/// The fields of a rig, to begin those of another one from.
#[derive(Debug, Clone)]
pub struct KeptFields {
    pub(super) rotation: Arc<Fields>,
    pub(super) scale: Option<Arc<Fields>>,
    pub(super) rigging: Arc<Rigging>,
}

impl KeptFields {
    /// What the rig was built from.
    pub fn rigging(&self) -> &Rigging {
        &self.rigging
    }

    /// Bytes held on the heap; the rig that they come from holds the same ones.
    pub fn bytes(&self) -> usize {
        self.rotation.bytes() + self.scale.as_ref().map_or(0, |f| f.bytes())
    }
}

/// Where the fields of a rig with the same holds begin, on a body that an edit has made of another one.
#[derive(Debug, Clone, Copy)]
pub struct Restart<'a> {
    /// The fields before the edit.
    pub before: &'a KeptFields,
    /// For each node its number before the edit, or `u32::MAX`.
    pub old_from_new: &'a [u32],
    /// Nodes that are new, or have other neighbours than before; rising.
    pub touched: &'a [u32],
}

/// So many rings of nodes around those that changed are relaxed together with them,
const RINGS: usize = 6;
/// in so many rounds of successive over-relaxation,
const ROUNDS: usize = 48;
/// with this factor: what is best for a lump of some ten nodes across.
const OVER: f64 = 1.6;

impl Restart<'_> {
    /// Fills free rows of `x`, one column for each of the holds `columns`, from the fields before; what changed is relaxed
    /// with its surroundings. False when the fields before do not fit.
    pub(super) fn guess(
        &self,
        body: &Body,
        before: &Fields,
        columns: &[usize],
        fixed: &[bool],
        x: &mut [f64],
        pool: &Pool,
    ) -> bool {
        let old: Vec<&[f32]> = columns.iter().map(|&k| before.of(k)).collect();
        let nodes = self.old_from_new.len();
        if nodes != body.nodes() || old.iter().any(|f| f.is_empty()) {
            return false;
        }
        pool.install(|| {
            x.par_chunks_mut(columns.len())
                .zip(self.old_from_new)
                .zip(fixed)
                .filter(|((_, was), fixed)| **was != NONE && !**fixed)
                .for_each(|((row, &was), _)| {
                    for (value, field) in row.iter_mut().zip(&old) {
                        *value = field.get(was as usize).copied().unwrap_or(0.0).into();
                    }
                });
        });
        let mut known: Vec<bool> = self
            .old_from_new
            .iter()
            .zip(fixed)
            .map(|(&o, &f)| o != NONE || f)
            .collect();
        let lump = self.lump(body, fixed);
        let width = columns.len();
        let mut mean = vec![0.0; width];
        for _ in 0..ROUNDS {
            for &i in &lump {
                let i = i as usize;
                mean.fill(0.0);
                let mut weight = 0.0;
                for (j, w) in body.edges(i).filter(|&(j, _)| known[j]) {
                    let row = &x[j * width..(j + 1) * width];
                    mean.iter_mut().zip(row).for_each(|(m, v)| *m += w * v);
                    weight += w;
                }
                if weight > 0.0 {
                    // The first value of a new node is no less than the mean itself.
                    let over = if known[i] { OVER } else { 1.0 };
                    let row = &mut x[i * width..(i + 1) * width];
                    row.iter_mut()
                        .zip(&mean)
                        .for_each(|(v, m)| *v += over * (m / weight - *v));
                    known[i] = true;
                }
            }
        }
        true
    }

    /// Free nodes that changed, and those around them; rising.
    fn lump(&self, body: &Body, fixed: &[bool]) -> Vec<u32> {
        let mut inside = vec![false; fixed.len()];
        let mut lump: Vec<u32> = Vec::new();
        let mut ring: Vec<u32> = self.touched.to_vec();
        for _ in 0..=RINGS {
            ring.retain(|&n| !fixed[n as usize] && !std::mem::replace(&mut inside[n as usize], true));
            lump.extend(&ring);
            let around = ring.iter().flat_map(|&n| body.graph.row(n).iter().copied());
            ring = around.filter(|&j| !inside[j as usize]).collect();
        }
        lump.sort_unstable();
        lump
    }
}
