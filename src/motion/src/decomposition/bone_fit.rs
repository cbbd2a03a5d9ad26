//! Motions of the bones, where the weights of all vertices are known.
//!
//! In a frame the squared error is quadratic in the bones' 3 × 4 matrices A: Σ tr(Aⱼ Pⱼₖ Aₖᵀ) − 2 Σ tr(Aⱼ Qⱼᵀ) + Σ v·v with
//! Pⱼₖ = Σ wⱼ wₖ p̃ p̃ᵀ, the same in all frames, and Qⱼ = Σ wⱼ v p̃ᵀ. One bone after the other takes the rigid motion that fits
//! what the others leave best (the paper's section 4.2), in as many sweeps as it takes, all without looking at a vertex again.
//!
//! Where bones are in each frame, laid out for the products that the fits are made of.
//!
//! What the fit of a vertex's weights needs of the bones, with the sum over all frames done beforehand.

use super::sequence::ShapeSamples;
use crate::skeleton::BoneInfluences;
use glam::{DMat3, DQuat, DVec3};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::rotation::{fit_rotation, nearest_rotation, outer_product};
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

/// A rotation R and a translation t for each bone and frame: a rest point p goes to R p + t.
#[derive(Debug, Clone)]
pub(super) struct BoneFrames {
    bones: usize,
    frames: usize,
    /// By frame, coordinate and bone: the row (R₀, R₁, R₂, t) of that coordinate.
    rows: Vec<f64>,
}

impl BoneFrames {
    /// Bones that stay in the rest pose.
    pub(super) fn at_rest(bones: usize, frames: usize) -> Self {
        let mut all = Self {
            bones,
            frames,
            rows: vec![0.0; frames * 12 * bones],
        };
        for frame in 0..frames {
            (0..bones).for_each(|bone| all.set(frame, bone, DMat3::IDENTITY, DVec3::ZERO));
        }
        all
    }

    pub(super) fn bones(&self) -> usize {
        self.bones
    }

    pub(super) fn frames(&self) -> usize {
        self.frames
    }

    /// All rows of a coordinate in a frame, four numbers a bone.
    pub(super) fn row(&self, frame: usize, coordinate: usize) -> &[f64] {
        let size = 4 * self.bones;
        let at = (3 * frame + coordinate) * size;
        &self.rows[at..at + size]
    }

    /// The numbers of each frame, to be changed frame by frame.
    fn frame_rows(&mut self) -> std::slice::ChunksMut<'_, f64> {
        self.rows.chunks_mut((12 * self.bones).max(1))
    }

    pub(super) fn set(&mut self, frame: usize, bone: usize, rotation: DMat3, translation: DVec3) {
        let size = 12 * self.bones;
        let rows = &mut self.rows[frame * size..(frame + 1) * size];
        set_in_frame(rows, self.bones, bone, rotation, translation);
    }

    pub(super) fn get(&self, frame: usize, bone: usize) -> (DMat3, DVec3) {
        let size = 12 * self.bones;
        get_in_frame(&self.rows[frame * size..(frame + 1) * size], self.bones, bone)
    }

    /// The rotation of a bone in a frame.
    pub(super) fn rotation(&self, frame: usize, bone: usize) -> DQuat {
        DQuat::from_mat3(&self.get(frame, bone).0).normalize()
    }

    /// The same with more bones at the end, in the rest pose.
    pub(super) fn with_bones(&self, bones: usize) -> Self {
        let mut all = Self::at_rest(bones, self.frames);
        for frame in 0..self.frames {
            for bone in 0..self.bones.min(bones) {
                let (rotation, translation) = self.get(frame, bone);
                all.set(frame, bone, rotation, translation);
            }
        }
        all
    }

    /// These frames and no others.
    pub(super) fn pick(&self, frames: &[usize]) -> Self {
        let mut all = Self::at_rest(self.bones, frames.len());
        for (at, &frame) in frames.iter().enumerate() {
            for bone in 0..self.bones {
                let (rotation, translation) = self.get(frame, bone);
                all.set(at, bone, rotation, translation);
            }
        }
        all
    }
}

/// Writes a bone into the numbers of a frame.
fn set_in_frame(rows: &mut [f64], bones: usize, bone: usize, rotation: DMat3, translation: DVec3) {
    for c in 0..3 {
        let at = 4 * (c * bones + bone);
        for d in 0..3 {
            rows[at + d] = rotation.col(d)[c];
        }
        rows[at + 3] = translation[c];
    }
}

/// Reads a bone from the numbers of a frame.
fn get_in_frame(rows: &[f64], bones: usize, bone: usize) -> (DMat3, DVec3) {
    let entry = |c: usize, d: usize| rows[4 * (c * bones + bone) + d];
    let column = |d: usize| DVec3::new(entry(0, d), entry(1, d), entry(2, d));
    (DMat3::from_cols(column(0), column(1), column(2)), column(3))
}

/// Added to the diagonal of Gram matrices, by frame: bones that move alike share a weight instead of dividing by nothing.
const RIDGE: f64 = 1e-15;

/// Products of all pairs of bones over all frames.
///
/// A bone takes the rest point p to A p̃ with p̃ = (p, 1), so what two bones make of it has the product p̃ᵀ (Σ Aⱼᵀ Aₖ) p̃
/// over all frames: a 4 × 4 matrix a pair serves all vertices.
pub(super) struct BoneProducts {
    bones: usize,
    frames: usize,
    /// (Σ Aᵀ A), with 4 rows and columns a bone.
    products: Vec<f64>,
}

/// A vertex's answers to the bones: what its weights are fitted to.
pub(super) struct FittedPlaces<'a> {
    /// p̃.
    point: [f64; 4],
    /// By bone: Σ Aᵀ v over all frames, four numbers each.
    pulls: &'a [f64],
    /// Σ v·v.
    square: f64,
}

impl BoneProducts {
    pub(super) fn new(bones: &BoneFrames, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let size = 4 * bones.bones();
        let mut products = vec![0.0; size * size];
        for frame in 0..bones.frames() {
            exec.check()?;
            for coordinate in 0..3 {
                let row = bones.row(frame, coordinate);
                for (a, to) in row.iter().zip(products.chunks_mut(size)) {
                    to.iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
                }
            }
        }
        Ok(Self {
            bones: bones.bones(),
            frames: bones.frames(),
            products,
        })
    }

    pub(super) fn bones(&self) -> usize {
        self.bones
    }

    /// Σ‖Aⱼ p̃ − v‖² for one bone.
    pub(super) fn own_error(&self, vertex: &FittedPlaces<'_>, bone: usize) -> f64 {
        let size = 4 * self.bones;
        let mut sum = 0.0;
        for (a, x) in vertex.point.iter().enumerate() {
            let row = &self.products[(4 * bone + a) * size + 4 * bone..][..4];
            sum += x * dot4(row, &vertex.point);
        }
        (sum - 2.0 * vertex.pull(bone) + vertex.square).max(0.0) + self.ridge()
    }

    /// A row of the Gram matrix of Aⱼ p̃ − v, for one j and all bones.
    pub(super) fn gram_row(&self, vertex: &FittedPlaces<'_>, bone: usize, to: &mut Vec<f64>) {
        let size = 4 * self.bones;
        let p = &vertex.point;
        let rows = &self.products[4 * bone * size..4 * (bone + 1) * size];
        let base = vertex.square - vertex.pull(bone);
        to.clear();
        to.extend((0..self.bones).map(|k| {
            let part = |a: usize| dot4(&rows[a * size + 4 * k..][..4], p);
            let product = p[0] * part(0) + p[1] * part(1) + p[2] * part(2) + p[3] * part(3);
            product + base - dot4(&vertex.pulls[4 * k..4 * k + 4], p)
        }));
        to[bone] = to[bone].max(0.0) + self.ridge();
    }

    fn ridge(&self) -> f64 {
        RIDGE * self.frames as f64
    }
}

impl<'a> FittedPlaces<'a> {
    pub(super) fn new(rest: DVec3, pulls: &'a [f64], square: f64) -> Self {
        Self {
            point: [rest.x, rest.y, rest.z, 1.0],
            pulls,
            square,
        }
    }

    fn pull(&self, bone: usize) -> f64 {
        dot4(&self.pulls[4 * bone..4 * bone + 4], &self.point)
    }
}

fn dot4(a: &[f64], b: &[f64; 4]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

/// Fills in Σ Aᵀ v and Σ v·v over all frames for a run of vertices; `pulls` has four numbers for each vertex and bone.
pub(super) fn gather_targets(
    samples: &ShapeSamples,
    bones: &BoneFrames,
    first: usize,
    pulls: &mut [f64],
    squares: &mut [f64],
) {
    pulls.fill(0.0);
    squares.fill(0.0);
    let size = 4 * bones.bones();
    for frame in 0..bones.frames() {
        let places = &samples.frame(frame)[3 * first..3 * (first + squares.len())];
        for coordinate in 0..3 {
            let row = bones.row(frame, coordinate);
            let runs = pulls.chunks_exact_mut(size).zip(squares.iter_mut());
            for ((to, square), place) in runs.zip(places.chunks_exact(3)) {
                let v = f64::from(place[coordinate]);
                *square += v * v;
                to.iter_mut().zip(row).for_each(|(sum, b)| *sum += v * b);
            }
        }
    }
}
