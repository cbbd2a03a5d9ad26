//! Where bones are in each frame, laid out for the products that the fits are made of.

use glam::{DMat3, DQuat, DVec3};

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
    pub(super) fn frame_rows(&mut self) -> std::slice::ChunksMut<'_, f64> {
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
pub(super) fn set_in_frame(rows: &mut [f64], bones: usize, bone: usize, rotation: DMat3, translation: DVec3) {
    for c in 0..3 {
        let at = 4 * (c * bones + bone);
        for d in 0..3 {
            rows[at + d] = rotation.col(d)[c];
        }
        rows[at + 3] = translation[c];
    }
}

/// Reads a bone from the numbers of a frame.
pub(super) fn get_in_frame(rows: &[f64], bones: usize, bone: usize) -> (DMat3, DVec3) {
    let entry = |c: usize, d: usize| rows[4 * (c * bones + bone) + d];
    let column = |d: usize| DVec3::new(entry(0, d), entry(1, d), entry(2, d));
    (DMat3::from_cols(column(0), column(1), column(2)), column(3))
}
