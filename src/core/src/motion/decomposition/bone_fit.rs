//! Motions of the bones, where the weights of all vertices are known.
//!
//! In a frame the squared error is quadratic in the bones' 3 × 4 matrices A: Σ tr(Aⱼ Pⱼₖ Aₖᵀ) − 2 Σ tr(Aⱼ Qⱼᵀ) + Σ v·v with
//! Pⱼₖ = Σ wⱼ wₖ p̃ p̃ᵀ, the same in all frames, and Qⱼ = Σ wⱼ v p̃ᵀ. One bone after the other takes the rigid motion that fits
//! what the others leave best (the paper's section 4.2), in as many sweeps as it takes, all without looking at a vertex again.

use super::bone_frames::{BoneFrames, get_in_frame, set_in_frame};
use super::sequence::ShapeSamples;
use crate::exec::Exec;
use crate::mesh::rotation::{fit_rotation, nearest_rotation, outer_product};
use crate::motion::influences::BoneInfluences;
use crate::progress::Cancelled;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// Vertices between two looks at the progress.
const RUN: usize = 4096;
/// A bone with less than this weight (the sum of squares) stays where it is.
const LEAST_WEIGHT: f64 = 1e-9;
/// Sweeps end when no bone moves by more than this, in units of the shape's size.
const STILL: f64 = 1e-7;

/// Σ wⱼ wₖ p̃ p̃ᵀ of a pair of bones: its symmetric part over p, the sum of p, and that of 1.
#[derive(Debug, Clone, Copy)]
struct PairMoments {
    other: usize,
    square: DMat3,
    sum: DVec3,
    weight: f64,
}

/// Those of all pairs of bones that share vertices.
struct BoneMoments {
    /// By bone: its own.
    own: Vec<PairMoments>,
    /// By bone: those shared with others, in rising order.
    shared: Vec<Vec<PairMoments>>,
}

impl BoneMoments {
    fn new(rest: &[DVec3], influences: &[BoneInfluences], bones: usize, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let none = |other| PairMoments {
            other,
            square: DMat3::ZERO,
            sum: DVec3::ZERO,
            weight: 0.0,
        };
        let mut all = Self {
            own: (0..bones).map(none).collect(),
            shared: vec![Vec::new(); bones],
        };
        for (v, (p, vertex)) in rest.iter().zip(influences).enumerate() {
            if v % RUN == 0 {
                exec.check()?;
            }
            let square = outer_product(*p, *p);
            for (j, a) in vertex.iter() {
                for (k, b) in vertex.iter() {
                    let to = if j == k {
                        &mut all.own[j]
                    } else {
                        let row = &mut all.shared[j];
                        let at = match row.binary_search_by_key(&k, |m| m.other) {
                            Ok(at) => at,
                            Err(at) => {
                                row.insert(at, none(k));
                                at
                            }
                        };
                        &mut row[at]
                    };
                    to.square += square * (a * b);
                    to.sum += *p * (a * b);
                    to.weight += a * b;
                }
            }
        }
        Ok(all)
    }
}

/// Fits all bones in all frames, beginning with where they are. Bones that have no vertex stay.
pub(super) fn fit_bones(
    samples: &ShapeSamples,
    influences: &[BoneInfluences],
    sweeps: usize,
    bones: &mut BoneFrames,
    exec: &Exec<'_>,
) -> Result<(), Cancelled> {
    let count = bones.bones();
    let moments = BoneMoments::new(&samples.rest, influences, count, exec)?;
    let mut frames: Vec<(usize, &mut [f64])> = bones.frame_rows().enumerate().collect();
    exec.pool.install(|| {
        frames.par_iter_mut().try_for_each(|(frame, rows)| {
            let pulls = gather_pulls(samples, influences, *frame, count, exec)?;
            for _ in 0..sweeps {
                exec.check()?;
                if sweep(&moments, &pulls, rows) < STILL {
                    break;
                }
            }
            Ok(())
        })
    })
}

/// By bone: Σ w v pᵀ and Σ w v in a frame.
fn gather_pulls(
    samples: &ShapeSamples,
    influences: &[BoneInfluences],
    frame: usize,
    bones: usize,
    exec: &Exec<'_>,
) -> Result<Vec<(DMat3, DVec3)>, Cancelled> {
    let mut pulls = vec![(DMat3::ZERO, DVec3::ZERO); bones];
    let places = samples.frame(frame).chunks_exact(3);
    for (k, ((place, p), vertex)) in places.zip(&samples.rest).zip(influences).enumerate() {
        if k % RUN == 0 {
            exec.check()?;
        }
        let v = DVec3::new(f64::from(place[0]), f64::from(place[1]), f64::from(place[2]));
        for (bone, w) in vertex.iter() {
            let to = &mut pulls[bone];
            let weighted = v * w;
            to.0 += outer_product(weighted, *p);
            to.1 += weighted;
        }
    }
    Ok(pulls)
}

/// One bone after the other, there and back; answers by how much any one moved at most.
fn sweep(moments: &BoneMoments, pulls: &[(DMat3, DVec3)], rows: &mut [f64]) -> f64 {
    let count = pulls.len();
    let mut moved = 0.0f64;
    let forth = 0..count;
    for bone in forth.clone().chain(forth.rev().skip(1)) {
        let own = &moments.own[bone];
        if own.weight < LEAST_WEIGHT {
            continue;
        }
        let (mut linear, mut constant) = pulls[bone];
        for pair in &moments.shared[bone] {
            let (r, t) = get_in_frame(rows, count, pair.other);
            linear -= r * pair.square + outer_product(t, pair.sum);
            constant -= r * pair.sum + t * pair.weight;
        }
        let mean = own.sum / own.weight;
        let covariance = linear - outer_product(constant, mean);
        let (before, shift) = get_in_frame(rows, count, bone);
        let rotation = rotation_near(covariance, before);
        let translation = constant / own.weight - rotation * mean;
        let turned = (0..3).map(|c| (rotation.col(c) - before.col(c)).length()).sum::<f64>();
        moved = moved.max(turned).max((translation - shift).length());
        set_in_frame(rows, count, bone, rotation, translation);
    }
    moved
}

/// The rotation that fits a covariance best. What it leaves open (a line, a single point) stays as it was.
fn rotation_near(covariance: DMat3, before: DMat3) -> DMat3 {
    let start = DQuat::from_mat3(&before).normalize();
    let near = nearest_rotation(covariance, start);
    let far = fit_rotation(covariance);
    let reached = |q: DQuat| {
        let r = DMat3::from_quat(q);
        (0..3).map(|c| r.col(c).dot(covariance.col(c))).sum::<f64>()
    };
    // A step at a time leads to the nearest optimum alone; the other way leads to the best.
    let best = if reached(far) > reached(near) * (1.0 + 1e-9) {
        far
    } else {
        near
    };
    DMat3::from_quat(best)
}
