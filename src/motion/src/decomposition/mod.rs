//! Skinning decomposition: a few rigid bones and at most four weights a vertex that play a whole animation (smooth skinning
//! decomposition with rigid bones, Le and Deng 2012).
//!
//! A [`ShapeSequence`] takes the frames; [`decompose`] finds bones, their motions and the weights together, and
//! [`fit_weights`] finds weights alone where the bones' motions are given, such as those of a skeleton.
//!
//! The paper alternates between two fits, and so does this. What makes it quick here is that both are quadratic in affine
//! functions of the rest position: the products of all bones over all frames (`bone_products`) and the moments of all pairs
//! of bones over all vertices (`bone_fit`) are formed once, and then neither the weights of a vertex nor a further sweep over
//! the bones of a frame costs anything that grows with the number of frames or vertices. So the sets of four bones are
//! searched, where the paper cuts a fit of all bones down to four, and bones are swept until they stand still. Most of the work
//! is done on a sample of vertices and frames (`decompose`), as a bone's motion is known well from a few hundred vertices.

mod bone_fit;
mod clusters;
mod joined;
mod sequence;
mod weight_fit;

use super::rig::RigidMotion;
use super::skeleton::BoneInfluences;
use bone_fit::{BoneFrames, fit_bones};
use clusters::{FittedSkin, cluster_bones, move_bones};
use glam::{DMat3, DVec3};
pub(crate) use joined::JoinedVertices;
use joined::MeanWeights;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use sequence::ShapeSamples;
pub use sequence::{DecompositionError, ShapeSequence};
use weight_fit::{fit_influences, fit_near_means};

/// How an animation is decomposed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DecompositionOptions {
    /// Bones, 1 to 256.
    pub bones: usize,
    /// Bones that a vertex follows at most, 1 to 4.
    pub influences: usize,
    /// Times that bones and weights are fitted in turn on a sample.
    pub iterations: usize,
}

impl Default for DecompositionOptions {
    fn default() -> Self {
        Self {
            bones: 40,
            influences: 4,
            iterations: 40,
        }
    }
}

impl DecompositionOptions {
    /// The most bones.
    pub const MOST_BONES: usize = 256;
    /// The most bones that a vertex follows.
    pub const MOST_INFLUENCES: usize = 4;

    fn check(&self) -> Result<(), DecompositionError> {
        let refuse = |option, seen, most: usize| {
            let allowed = format!("1 to {most}");
            Err(DecompositionError::Option { option, seen, allowed })
        };
        if !(1..=Self::MOST_BONES).contains(&self.bones) {
            return refuse("bones", self.bones, Self::MOST_BONES);
        }
        if !(1..=Self::MOST_INFLUENCES).contains(&self.influences) {
            return refuse("influences", self.influences, Self::MOST_INFLUENCES);
        }
        Ok(())
    }
}

/// Bones, their motions and weights that play an animation.
#[derive(Debug, Clone, PartialEq)]
pub struct SkinDecomposition {
    /// By bone: the mean rest position of its vertices by weight. It turns about this point.
    pub centres: Vec<DVec3>,
    /// By frame and bone: the motion from the rest pose.
    pub motions: Vec<Vec<RigidMotion>>,
    /// By vertex.
    pub influences: Vec<BoneInfluences>,
    /// Root of the mean squared distance between played and given positions, in model units.
    pub rms: f64,
    /// The largest of these distances.
    pub max: f64,
}

/// Vertices of the sample for each bone, and at least.
const SAMPLE_A_BONE: usize = 160;
const SMALLEST_SAMPLE: usize = 4000;
/// Frames of the sample at most.
const SAMPLE_FRAMES: usize = 64;
/// Sweeps over the bones between two fits of weights.
const SWEEPS: usize = 6;
/// Fits in turn with all vertices, and with all frames.
const LAST_ITERATIONS: usize = 6;
/// How strongly weights are drawn to the means around them, in units of the error that bones and weights leave, and at most and at
/// least as a part of the shape's size.
const DRAWN: f64 = 1.0;
const DRAWN_WITHIN: [f64; 2] = [1e-6, 3e-3];
/// Next to jumps, up to how strongly.
const MOST_DRAWN: f64 = 3e-2;
/// By how much more strongly in each round.
const STRONGER: f64 = 2.0;
/// The largest difference of a weight across an edge that is left alone.
const JUMP: f64 = 0.45;
/// Times that vertices take the mean of what is around them where weights are drawn to it.
const MEAN_SWEEPS: usize = 12;
/// How many edges away from a jump vertices are fitted again.
const RINGS: usize = 3;
/// Times that bones and weights are fitted in turn once weights do not jump.
const SMOOTH_ROUNDS: usize = 5;
/// Times that weights are drawn to the means around them where the bones' motions are given.
const DRAWN_ROUNDS: usize = 3;
/// Rounds after which bones that hardly matter are moved.
const MOVE_EVERY: usize = 5;

/// Finds bones and weights together.
///
/// # Errors
/// [`DecompositionError`] for options out of range, a sequence without a frame, and when the caller cancels.
pub fn decompose(
    sequence: &ShapeSequence,
    options: &DecompositionOptions,
    exec: &Exec<'_>,
) -> Result<SkinDecomposition, DecompositionError> {
    options.check()?;
    if sequence.frames() == 0 {
        return Err(DecompositionError::Option {
            option: "frames",
            seen: 0,
            allowed: "1 and more".into(),
        });
    }
    let all = &sequence.samples;
    let count = options.bones.min(all.vertices());
    let most = options.influences;
    let vertices = spread(all.vertices(), (SAMPLE_A_BONE * count).max(SMALLEST_SAMPLE));
    let frames = spread(all.frames(), SAMPLE_FRAMES);
    let frames: Vec<usize> = frames.into_iter().map(|f| f as usize).collect();
    let sample = all.pick(&vertices, &frames);
    let bones = cluster_bones(&sample, count, exec)?;
    let (influences, errors) = fit_influences(&sample, &bones, most, None, exec)?;
    let mut skin = FittedSkin {
        bones,
        influences,
        errors,
    };
    improve(&sample, options, &mut skin, exec)?;
    let mut bones = skin.bones;
    let mut influences: Option<Vec<BoneInfluences>> = None;
    let mut drawn = 0.0;
    for frames_of_all in [false, true] {
        let (samples, picked);
        if frames_of_all {
            samples = all;
            bones = unpick(&bones, &frames, all.frames());
        } else {
            let whole: Vec<u32> = (0..all.vertices() as u32).collect();
            picked = all.pick(&whole, &frames);
            samples = &picked;
        }
        if frames_of_all && frames.len() == all.frames() {
            break;
        }
        if let Some(influences) = &influences {
            fit_bones(samples, influences, 3 * SWEEPS, &mut bones, exec)?;
        }
        for _ in 0..if frames_of_all { 2 } else { LAST_ITERATIONS } {
            let found = match &influences {
                Some(before) if !sequence.joined.is_empty() => {
                    let means = sequence.joined.means(before, MEAN_SWEEPS, exec)?;
                    fit_near_means(samples, &bones, most, &means, drawn, exec)?
                }
                before => {
                    let (found, errors) = fit_influences(samples, &bones, most, before.as_deref(), exec)?;
                    drawn = strength_for(&errors, samples.frames());
                    found
                }
            };
            fit_bones(samples, &found, SWEEPS, &mut bones, exec)?;
            influences = Some(found);
        }
    }
    let mut influences = influences.unwrap_or_default();
    if !sequence.joined.is_empty() {
        smooth_jumps(sequence, &bones, drawn, &mut influences, exec)?;
        for _ in 0..SMOOTH_ROUNDS {
            // Bones that follow weights without jumps leave less for the weights to do.
            fit_bones(all, &influences, 3 * SWEEPS, &mut bones, exec)?;
            let means = sequence.joined.means(&influences, MEAN_SWEEPS, exec)?;
            influences = fit_near_means(all, &bones, most, &means, drawn, exec)?;
            smooth_jumps(sequence, &bones, drawn, &mut influences, exec)?;
        }
        fit_bones(all, &influences, 3 * SWEEPS, &mut bones, exec)?;
    }
    Ok(in_model_units(sequence, &bones, influences, exec)?)
}

/// Bones and weights in turn, with bones moved to where they are missed as long as that helps.
fn improve(
    samples: &ShapeSamples,
    options: &DecompositionOptions,
    skin: &mut FittedSkin,
    exec: &Exec<'_>,
) -> Result<(), DecompositionError> {
    let most = options.influences;
    let mut moves = (skin.bones.bones() / 8).max(1);
    let mut best: Option<FittedSkin> = None;
    for round in 0..options.iterations {
        skin.alternate(samples, most, SWEEPS, exec)?;
        if round % MOVE_EVERY != MOVE_EVERY - 1 || moves == 0 {
            continue;
        }
        if let Some(before) = best.take_if(|b| b.total() <= skin.total()) {
            *skin = before;
            moves /= 2;
        }
        best = Some(skin.clone());
        if moves > 0 && round + 2 * MOVE_EVERY < options.iterations {
            *skin = move_bones(samples, skin, moves, most, exec)?;
        } else {
            moves = 0;
        }
    }
    if let Some(before) = best.filter(|b| b.total() < skin.total()) {
        *skin = before;
    }
    Ok(())
}

/// Fits weights where the bones' motions are given: by frame and bone, in model units. At most `most` bones a vertex.
///
/// # Errors
/// [`DecompositionError`] for options out of range, frames without all bones, and when the caller cancels.
pub fn fit_weights(
    sequence: &ShapeSequence,
    motions: &[Vec<RigidMotion>],
    most: usize,
    exec: &Exec<'_>,
) -> Result<SkinDecomposition, DecompositionError> {
    let count = motions.first().map_or(0, Vec::len);
    let options = DecompositionOptions {
        bones: count,
        influences: most,
        iterations: 0,
    };
    options.check()?;
    if motions.len() != sequence.frames() {
        return Err(DecompositionError::Option {
            option: "frames of motions",
            seen: motions.len(),
            allowed: format!("as many as shapes, {}", sequence.frames()),
        });
    }
    let mut bones = BoneFrames::at_rest(count, sequence.frames());
    for (frame, (own, carried)) in motions.iter().zip(&sequence.carried).enumerate() {
        if own.len() != count {
            return Err(DecompositionError::Option {
                option: "bones of a frame",
                seen: own.len(),
                allowed: format!("as many as in the first, {count}"),
            });
        }
        for (bone, motion) in own.iter().enumerate() {
            let seen = motion.seen_from(carried);
            let at = (seen.place(sequence.centre) - sequence.centre) / sequence.diagonal;
            bones.set(frame, bone, DMat3::from_quat(seen.rotation), at);
        }
    }
    let (mut influences, errors) = fit_influences(&sequence.samples, &bones, most, None, exec)?;
    if !sequence.joined.is_empty() {
        let drawn = strength_for(&errors, sequence.frames());
        for _ in 0..DRAWN_ROUNDS {
            let means = sequence.joined.means(&influences, MEAN_SWEEPS, exec)?;
            influences = fit_near_means(&sequence.samples, &bones, most, &means, drawn, exec)?;
        }
        smooth_jumps(sequence, &bones, drawn, &mut influences, exec)?;
    }
    Ok(in_model_units(sequence, &bones, influences, exec)?)
}

/// How strongly weights are drawn to means where the fit leaves these squared errors, summed over so many frames.
fn strength_for(errors: &[f64], frames: usize) -> f64 {
    let [least, most] = DRAWN_WITHIN;
    let mean = errors.iter().sum::<f64>() / (errors.len() * frames).max(1) as f64;
    (DRAWN * mean.sqrt()).clamp(least, most)
}

/// Fits weights again, more and more strongly drawn to the means around them, where they jump from a vertex to the next one.
fn smooth_jumps(
    sequence: &ShapeSequence,
    bones: &BoneFrames,
    drawn: f64,
    influences: &mut [BoneInfluences],
    exec: &Exec<'_>,
) -> Result<(), Cancelled> {
    let frames: Vec<usize> = (0..sequence.frames()).collect();
    let most = influences.iter().map(|own| own.iter().count()).max().unwrap_or(1);
    let mut drawn = drawn * STRONGER;
    while drawn <= MOST_DRAWN {
        let chosen = sequence.joined.beside_jumps(influences, JUMP, RINGS);
        if chosen.is_empty() {
            break;
        }
        let all = sequence.joined.means(influences, MEAN_SWEEPS, exec)?;
        let means: Vec<MeanWeights> = chosen.iter().map(|v| all[*v as usize].clone()).collect();
        let samples = sequence.samples.pick(&chosen, &frames);
        let found = fit_near_means(&samples, bones, most, &means, drawn, exec)?;
        for (vertex, own) in chosen.iter().zip(found) {
            influences[*vertex as usize] = own;
        }
        drawn *= STRONGER;
    }
    Ok(())
}

/// At most `most` of `count` numbers, spread evenly but not regularly, in rising order.
fn spread(count: usize, most: usize) -> Vec<u32> {
    if count <= most {
        return (0..count as u32).collect();
    }
    let mut seed = 0x9e37_79b9_7f4a_7c15u64;
    let mut next = || {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize
    };
    let picked = (0..most).map(|k| {
        let (low, high) = (k * count / most, (k + 1) * count / most);
        (low + next() % (high - low)) as u32
    });
    picked.collect()
}

/// Bones in all frames, those in frames that were not picked as in the nearest that was.
fn unpick(bones: &BoneFrames, picked: &[usize], frames: usize) -> BoneFrames {
    let mut nearest = Vec::with_capacity(frames);
    let mut at = 0;
    for frame in 0..frames {
        while at + 1 < picked.len() && picked[at + 1].abs_diff(frame) <= picked[at].abs_diff(frame) {
            at += 1;
        }
        nearest.push(at);
    }
    bones.pick(&nearest)
}

/// The result in model units.
fn in_model_units(
    sequence: &ShapeSequence,
    bones: &BoneFrames,
    influences: Vec<BoneInfluences>,
    exec: &Exec<'_>,
) -> Result<SkinDecomposition, Cancelled> {
    let samples = &sequence.samples;
    let count = bones.bones();
    let mut sums = vec![(DVec3::ZERO, 0.0); count];
    for (p, vertex) in samples.rest.iter().zip(&influences) {
        for (bone, w) in vertex.iter() {
            sums[bone].0 += *p * w;
            sums[bone].1 += w;
        }
    }
    let centres: Vec<DVec3> = sums
        .iter()
        .map(|(sum, w)| if *w > 0.0 { *sum / *w } else { DVec3::ZERO })
        .collect();
    let to_model = |p: DVec3| p * sequence.diagonal + sequence.centre;
    let mut motions: Vec<Vec<RigidMotion>> = Vec::with_capacity(bones.frames());
    let (mut square, mut largest) = (0.0f64, 0.0f64);
    for (frame, carried) in sequence.carried.iter().enumerate() {
        exec.check()?;
        let placed: Vec<_> = (0..count).map(|b| bones.get(frame, b)).collect();
        let before = motions.last();
        let moved = (0..count).map(|bone| {
            let (rotation, translation) = placed[bone];
            let turn = (carried.rotation * bones.rotation(frame, bone)).normalize();
            let near = before.is_none_or(|b: &Vec<RigidMotion>| b[bone].rotation.dot(turn) >= 0.0);
            RigidMotion {
                rotation: if near { turn } else { -turn },
                from: to_model(centres[bone]),
                to: carried.place(to_model(rotation * centres[bone] + translation)),
            }
        });
        let moved = moved.collect();
        motions.push(moved);
        for ((p, vertex), v) in samples
            .rest
            .iter()
            .zip(&influences)
            .zip(samples.frame(frame).chunks_exact(3))
        {
            let v = DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]));
            let off = (vertex.blend(|b| placed[b].0 * *p + placed[b].1) - v).length_squared();
            square += off;
            largest = largest.max(off);
        }
    }
    let all = (samples.vertices() * samples.frames()).max(1) as f64;
    Ok(SkinDecomposition {
        centres: centres.into_iter().map(to_model).collect(),
        motions,
        influences,
        rms: (square / all).sqrt() * sequence.diagonal,
        max: largest.sqrt() * sequence.diagonal,
    })
}
