//! Bones that hardly matter go where they are missed.

use super::bone_fit::fit_bones;
use super::bone_frames::BoneFrames;
use super::clusters::begin_cluster;
use super::sequence::ShapeSamples;
use super::weight_fit::fit_influences;
use crate::exec::Exec;
use crate::motion::influences::BoneInfluences;
use crate::progress::Cancelled;

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
