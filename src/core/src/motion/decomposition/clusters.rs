//! The bones to begin with: vertices that move alike are one cluster (section 4.3 of the paper), found by splitting the
//! worst clusters where a vertex far from the middle of its cluster fits worst.

use super::bone_fit::fit_bones;
use super::bone_frames::BoneFrames;
use super::sequence::ShapeSamples;
use super::weight_fit::best_bones;
use crate::exec::Exec;
use crate::motion::influences::BoneInfluences;
use crate::progress::Cancelled;
use glam::DVec3;

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
pub(super) fn begin_cluster(
    samples: &ShapeSamples,
    members: &[usize],
    errors: &[f64],
    bone: u16,
    labels: &mut [BoneInfluences],
) {
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
