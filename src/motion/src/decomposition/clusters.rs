//! The bones to begin with: vertices that move alike are one cluster (section 4.3 of the paper), found by splitting the
//! worst clusters where a vertex far from the middle of its cluster fits worst.
//!
//! Bones that hardly matter go where they are missed.

use super::bone_fit::{BoneFrames, fit_bones};
use super::sequence::ShapeSamples;
use super::weight_fit::{best_bones, fit_influences};
use crate::skeleton::BoneInfluences;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// Times that vertices choose clusters after a split, and after the last one.
const ROUNDS: usize = 4;
const LAST_ROUNDS: usize = 8;
/// A new cluster begins with this share of the one that it is split from.
const SHARE: usize = 12;
/// … and with at least this many vertices.
const FEWEST: usize = 6;

/// Finds bones, each with a cluster of vertices that it takes along best.
pub(super) fn cluster_bones(samples: &ShapeSamples, count: usize, exec: &Exec<'_>) -> Result<BoneFrames, Cancelled> {
    let mut bones = BoneFrames::at_rest(1, samples.frames());
    loop {
        let last = bones.bones() == count;
        let mut found = best_bones(samples, &bones, exec)?;
        for _ in 0..if last { LAST_ROUNDS } else { ROUNDS } {
            fit_bones(samples, &found.0, 1, &mut bones, exec)?;
            found = best_bones(samples, &bones, exec)?;
        }
        if last {
            return Ok(bones);
        }
        let (labels, errors) = found;
        let more = (2 * bones.bones()).min(count) - bones.bones();
        let clusters = worst_clusters(&labels, &errors, bones.bones(), more);
        let first = bones.bones();
        bones = bones.with_bones(first + more);
        let mut labels = labels;
        for (k, &cluster) in clusters.iter().enumerate() {
            let members: Vec<usize> = (0..labels.len()).filter(|&v| labels[v].bones[0] == cluster).collect();
            begin_cluster(samples, &members, &errors, (first + k) as u16, &mut labels);
        }
        fit_bones(samples, &labels, 1, &mut bones, exec)?;
    }
}

/// The clusters with most error, worst first.
fn worst_clusters(labels: &[BoneInfluences], errors: &[f64], bones: usize, most: usize) -> Vec<u16> {
    let mut sums = vec![0.0; bones];
    for (label, error) in labels.iter().zip(errors) {
        sums[usize::from(label.bones[0])] += error;
    }
    let mut order: Vec<u16> = (0..bones as u16).collect();
    order.sort_by(|a, b| sums[usize::from(*b)].total_cmp(&sums[usize::from(*a)]).then(a.cmp(b)));
    order.truncate(most);
    order
}

/// Gives the surroundings of the member that fits worst to a new bone.
fn begin_cluster(samples: &ShapeSamples, members: &[usize], errors: &[f64], bone: u16, labels: &mut [BoneInfluences]) {
    let middle = members.iter().map(|&v| samples.rest[v]).sum::<DVec3>() / members.len().max(1) as f64;
    let mut seed = None;
    let mut most = -1.0;
    for &v in members {
        let far = errors[v] * samples.rest[v].distance_squared(middle);
        if far > most {
            (most, seed) = (far, Some(v));
        }
    }
    let Some(seed) = seed else { return };
    let at = samples.rest[seed];
    let mut near: Vec<(f64, usize)> = (members.iter().map(|&v| (samples.rest[v].distance_squared(at), v))).collect();
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let size = (members.len() / SHARE).max(FEWEST);
    for (_, v) in near.iter().take(size) {
        labels[*v] = BoneInfluences::one(bone);
    }
}

/// Weights and bones that go together, and what they leave.
#[derive(Clone)]
pub(super) struct FittedSkin {
    pub(super) bones: BoneFrames,
    pub(super) influences: Vec<BoneInfluences>,
    /// By vertex: its squared error, summed over all frames.
    pub(super) errors: Vec<f64>,
}

impl FittedSkin {
    pub(super) fn total(&self) -> f64 {
        self.errors.iter().sum()
    }

    /// Fits bones, then weights.
    pub(super) fn alternate(
        &mut self,
        samples: &ShapeSamples,
        most: usize,
        sweeps: usize,
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        fit_bones(samples, &self.influences, sweeps, &mut self.bones, exec)?;
        (self.influences, self.errors) = fit_influences(samples, &self.bones, most, Some(&self.influences), exec)?;
        Ok(())
    }
}

/// By bone: by how much the squared error would grow at most if it were not there. A vertex that leans on it has its
/// weight shared out among its other bones.
fn losses(samples: &ShapeSamples, skin: &FittedSkin, exec: &Exec<'_>) -> Result<Vec<f64>, Cancelled> {
    let count = skin.bones.bones();
    let mut losses = vec![0.0; count];
    // What a bone gives a vertex, seen from what all give it: Σ over frames of w² ‖x − mean‖² / (1 − w)².
    for frame in 0..skin.bones.frames() {
        exec.check()?;
        let placed: Vec<_> = (0..count).map(|b| skin.bones.get(frame, b)).collect();
        for (p, vertex) in samples.rest.iter().zip(&skin.influences) {
            let place = |b: usize| placed[b].0 * *p + placed[b].1;
            let mean = vertex.blend(place);
            for (bone, w) in vertex.iter() {
                let share = w / (1.0 - w).max(0.05);
                losses[bone] += (share * (place(bone) - mean).length())
                    .powi(2)
                    .max(if w > 0.95 { 1e-3 } else { 0.0 });
            }
        }
    }
    Ok(losses)
}

/// Moves the bones that are missed least, `moves` of them, to where the error is largest. Their old vertices keep the other
/// bones that they follow.
pub(super) fn move_bones(
    samples: &ShapeSamples,
    skin: &FittedSkin,
    moves: usize,
    most: usize,
    exec: &Exec<'_>,
) -> Result<FittedSkin, Cancelled> {
    let count = skin.bones.bones();
    let losses = losses(samples, skin, exec)?;
    let mut least: Vec<usize> = (0..count).collect();
    least.sort_by(|a, b| losses[*a].total_cmp(&losses[*b]).then(a.cmp(b)));
    least.truncate(moves);
    let mut sums = vec![0.0; count];
    for (vertex, error) in skin.influences.iter().zip(&skin.errors) {
        sums[usize::from(vertex.bones[0])] += error;
    }
    let mut worst: Vec<usize> = (0..count).filter(|b| !least.contains(b)).collect();
    worst.sort_by(|a, b| sums[*b].total_cmp(&sums[*a]).then(a.cmp(b)));
    let mut moved = skin.clone();
    let mut labels = skin.influences.clone();
    for (&bone, &cluster) in least.iter().zip(&worst) {
        let members: Vec<usize> = (0..labels.len())
            .filter(|&v| usize::from(skin.influences[v].bones[0]) == cluster)
            .collect();
        begin_cluster(samples, &members, &skin.errors, bone as u16, &mut labels);
    }
    // The moved bones are fitted to their new vertices alone.
    let alone: Vec<BoneInfluences> = (labels.iter().zip(&skin.influences))
        .map(|(new, old)| match new == old {
            true => BoneInfluences::default(),
            false => *new,
        })
        .collect();
    fit_bones(samples, &alone, 1, &mut moved.bones, exec)?;
    (moved.influences, moved.errors) = fit_influences(samples, &moved.bones, most, None, exec)?;
    Ok(moved)
}
