//! Correctives: rest shapes with which skinning plays solved frames (pose space deformation, Lewis et al. 2000).
//!
//! For chosen frames, the difference between the solved frame and the rest shape skinned by bones and weights alone is
//! mapped back to the rest pose, vertex by vertex, so that skinning the corrected rest shape gives the frame. Frames in
//! between blend correctives by weights from 0 to 1 that come nearest to the solved frame.

use crate::rig::RigidMotion;
use crate::skeleton::BoneInfluences;
use glam::{DMat3, DVec3, Vec3};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use rayon::prelude::*;

/// Vertices between two looks at the progress: each costs as much as all pairs of correctives.
const RUN: usize = 64;
/// A blend of rotations that shrinks space to less than this share has no way back that is worth following.
const FLAT: f64 = 0.05;
/// How much of space is kept then.
const DAMPING: f64 = 0.05;
/// Sweeps over the weights of a frame.
const SWEEPS: usize = 200;

/// An animation of bones, and the frames that it ought to play.
#[derive(Debug, Clone, Copy)]
pub struct SkinnedFrames<'a> {
    /// The rest shape.
    pub rest: &'a [DVec3],
    /// By vertex, the bones that it follows.
    pub influences: &'a [BoneInfluences],
    /// By frame and bone, the motion from the rest pose.
    pub motions: &'a [Vec<RigidMotion>],
    /// By frame and vertex, where it ought to be.
    pub wanted: &'a [Vec<Vec3>],
}

/// Correctives, and by how much of each a frame is corrected.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CorrectiveShapes {
    /// The frames whose difference each corrective is.
    pub frames: Vec<usize>,
    /// By corrective, how far it moves each rest position.
    pub shifts: Vec<Vec<DVec3>>,
    /// By frame and corrective, 0 to 1.
    pub weights: Vec<Vec<f64>>,
    /// Root mean square and largest distance from what was wanted, without correctives.
    pub before: [f64; 2],
    /// With them.
    pub after: [f64; 2],
}

/// What the bones of a frame do, as matrices.
struct PosedBones(Vec<(DMat3, DVec3)>);

impl PosedBones {
    fn of_motions(motions: &[RigidMotion]) -> Self {
        let bone = |motion: &RigidMotion| {
            let turn = DMat3::from_quat(motion.rotation);
            (turn, motion.to - turn * motion.from)
        };
        Self(motions.iter().map(bone).collect())
    }

    fn turn(&self, own: &BoneInfluences) -> DMat3 {
        let turns = own.iter().map(|(bone, weight)| self.0[bone].0 * weight);
        turns.fold(DMat3::ZERO, |a, b| a + b)
    }

    fn place(&self, own: &BoneInfluences, p: DVec3) -> DVec3 {
        own.blend(|bone| self.0[bone].0 * p + self.0[bone].1)
    }
}

/// How a frame is best corrected, and what is left.
struct CorrectedFrame {
    weights: Vec<f64>,
    square: f64,
    largest: f64,
}

/// Finds up to `most` correctives, each at the frame with the largest error left.
///
/// # Errors
/// [`Cancelled`] when the caller cancels.
///
/// # Panics
/// When the fields of `skinned` differ in the number of frames or vertices.
pub fn fit_correctives(
    skinned: &SkinnedFrames<'_>,
    most: usize,
    exec: &Exec<'_>,
) -> Result<CorrectiveShapes, Cancelled> {
    assert_eq!(skinned.rest.len(), skinned.influences.len(), "influences by vertex");
    assert_eq!(skinned.motions.len(), skinned.wanted.len(), "motions by frame");
    let posed: Vec<PosedBones> = skinned.motions.iter().map(|m| PosedBones::of_motions(m)).collect();
    let all = (skinned.rest.len() * posed.len()).max(1) as f64;
    let mut found = CorrectiveShapes::default();
    loop {
        let frames: Vec<CorrectedFrame> = exec.pool.install(|| {
            let frames = posed.par_iter().enumerate();
            frames
                .map(|(frame, bones)| corrected(skinned, frame, bones, &found, exec))
                .collect::<Result<_, Cancelled>>()
        })?;
        let square: f64 = frames.iter().map(|f| f.square).sum();
        let largest = frames.iter().map(|f| f.largest).fold(0.0, f64::max);
        let left = [(square / all).sqrt(), largest];
        if found.frames.is_empty() {
            found.before = left;
        }
        found.after = left;
        let others = (0..frames.len()).filter(|f| !found.frames.contains(f));
        let worst = others.max_by(|a, b| frames[*a].square.total_cmp(&frames[*b].square).then(b.cmp(a)));
        found.weights = frames.iter().map(|f| f.weights.clone()).collect();
        let Some(worst) = worst.filter(|f| found.frames.len() < most && frames[*f].square > 0.0) else {
            return Ok(found);
        };
        found.frames.push(worst);
        found.shifts.push(shift_at_rest(skinned, worst, &posed[worst]));
    }
}

/// How far each rest position has to move so that the vertex is at its wanted position in a frame.
fn shift_at_rest(skinned: &SkinnedFrames<'_>, frame: usize, bones: &PosedBones) -> Vec<DVec3> {
    let vertices = skinned.rest.iter().zip(skinned.influences).zip(&skinned.wanted[frame]);
    vertices
        .map(|((p, own), wanted)| {
            let off = wanted.as_dvec3() - bones.place(own, *p);
            let turn = bones.turn(own);
            if turn.determinant().abs() > FLAT {
                return turn.inverse() * off;
            }
            let back = turn.transpose();
            back * ((turn * back + DMat3::IDENTITY * DAMPING).inverse() * off)
        })
        .collect()
}

fn corrected(
    skinned: &SkinnedFrames<'_>,
    frame: usize,
    bones: &PosedBones,
    found: &CorrectiveShapes,
    exec: &Exec<'_>,
) -> Result<CorrectedFrame, Cancelled> {
    let shifts = &found.shifts;
    let count = shifts.len();
    let mut gram = vec![0.0; count * count];
    let mut pull = vec![0.0; count];
    let mut moved = vec![DVec3::ZERO; count];
    let wanted = &skinned.wanted[frame];
    let off = |v: usize| wanted[v].as_dvec3() - bones.place(&skinned.influences[v], skinned.rest[v]);
    for v in 0..skinned.rest.len() {
        if v % RUN == 0 {
            exec.check()?;
        }
        let (turn, off) = (bones.turn(&skinned.influences[v]), off(v));
        for (moved, shift) in moved.iter_mut().zip(shifts) {
            *moved = turn * shift[v];
        }
        for k in 0..count {
            pull[k] += moved[k].dot(off);
            for j in 0..=k {
                gram[k * count + j] += moved[k].dot(moved[j]);
            }
        }
    }
    // A frame whose own corrective there is has all of it and no other, which leaves nothing where there was a way back.
    let own = found.frames.iter().map(|f| if *f == frame { 1.0 } else { 0.0 });
    let weights = weights_within_one(&mut gram, &pull, own.collect());
    let (mut square, mut largest) = (0.0, 0.0f64);
    for v in 0..skinned.rest.len() {
        if v % RUN == 0 {
            exec.check()?;
        }
        let shift: DVec3 = weights.iter().zip(shifts).map(|(w, shift)| shift[v] * *w).sum();
        let left = (off(v) - bones.turn(&skinned.influences[v]) * shift).length_squared();
        square += left;
        largest = largest.max(left);
    }
    Ok(CorrectedFrame {
        weights,
        square,
        largest: largest.sqrt(),
    })
}

/// The least squares from 0 to 1, by sweeps over one weight after the other from where they are. The lower half of the matrix is
/// given.
fn weights_within_one(gram: &mut [f64], pull: &[f64], mut weights: Vec<f64>) -> Vec<f64> {
    let count = pull.len();
    for k in 0..count {
        for j in 0..k {
            gram[j * count + k] = gram[k * count + j];
        }
    }
    for _ in 0..SWEEPS {
        for k in 0..count {
            let own = gram[k * count + k];
            let others: f64 = (0..count)
                .filter(|j| *j != k)
                .map(|j| gram[k * count + j] * weights[j])
                .sum();
            weights[k] = if own > 0.0 {
                ((pull[k] - others) / own).clamp(0.0, 1.0)
            } else {
                0.0
            };
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    #[test]
    fn a_corrected_rest_shape_is_skinned_to_the_frame_that_was_wanted() {
        let rest: Vec<DVec3> = (0..40)
            .map(|k| DVec3::new(f64::from(k) * 0.1, f64::from(k % 4), 0.3))
            .collect();
        let influences: Vec<BoneInfluences> = (0..40u32)
            .map(|k| {
                let share = f64::from(k) / 39.0;
                BoneInfluences::from_pairs(&mut [(0, 1.0 - share), (1, share)]).expect("weights")
            })
            .collect();
        let bend = |angle: f64| {
            let turn = RigidMotion {
                rotation: DQuat::from_rotation_z(angle),
                from: DVec3::X * 2.0,
                to: DVec3::X * 2.0,
            };
            vec![RigidMotion::IDENTITY, turn]
        };
        let motions: Vec<Vec<RigidMotion>> = [0.0, 0.5, 1.0, 1.5].map(bend).to_vec();
        let swollen = |frame: usize| -> Vec<Vec3> {
            let bones = PosedBones::of_motions(&motions[frame]);
            let bulge = DVec3::new(0.0, 0.1, 0.05) * frame as f64;
            rest.iter()
                .zip(&influences)
                .map(|(p, own)| (bones.place(own, *p) + bulge).as_vec3())
                .collect()
        };
        let wanted: Vec<Vec<Vec3>> = (0..4).map(swollen).collect();
        let skinned = SkinnedFrames {
            rest: &rest,
            influences: &influences,
            motions: &motions,
            wanted: &wanted,
        };
        let pool = Pool::new(2).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let one = fit_correctives(&skinned, 1, &exec).expect("correctives");
        assert_eq!(one.frames, [3], "the frame that is farthest off");
        assert!((one.weights[3][0] - 1.0).abs() < 1e-9 && one.weights[0][0] < 1e-6);
        let bones = PosedBones::of_motions(&motions[3]);
        for (v, p) in rest.iter().enumerate() {
            let placed = bones.place(&influences[v], *p + one.shifts[0][v]);
            assert!(placed.distance(wanted[3][v].as_dvec3()) < 1e-6);
        }
        assert!(one.after[0] < 0.3 * one.before[0], "{:?} {:?}", one.before, one.after);
        let more = fit_correctives(&skinned, 9, &exec).expect("correctives");
        assert!(more.after[1] < 1e-6 && more.frames.len() <= 4, "{:?}", more.after);
        assert_eq!(fit_correctives(&skinned, 0, &exec).expect("none").after, one.before);
    }
}
