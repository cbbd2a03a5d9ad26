//! What the fit of a vertex's weights needs of the bones, with the sum over all frames done beforehand.

use super::bone_frames::BoneFrames;
use super::sequence::ShapeSamples;
use crate::exec::Exec;
use crate::progress::Cancelled;
use glam::DVec3;

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
pub(super) struct VertexTargets<'a> {
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
    pub(super) fn own_error(&self, vertex: &VertexTargets<'_>, bone: usize) -> f64 {
        let size = 4 * self.bones;
        let mut sum = 0.0;
        for (a, x) in vertex.point.iter().enumerate() {
            let row = &self.products[(4 * bone + a) * size + 4 * bone..][..4];
            sum += x * dot4(row, &vertex.point);
        }
        (sum - 2.0 * vertex.pull(bone) + vertex.square).max(0.0) + self.ridge()
    }

    /// A row of the Gram matrix of Aⱼ p̃ − v, for one j and all bones.
    pub(super) fn gram_row(&self, vertex: &VertexTargets<'_>, bone: usize, to: &mut Vec<f64>) {
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

impl<'a> VertexTargets<'a> {
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
