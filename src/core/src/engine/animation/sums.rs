//! Sums over the frames of an animation.

use crate::engine::facts::QualityReport;

/// Sums over the frames of an animation, added one by one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FrameSums {
    /// How many frames.
    pub frames: usize,
    volume_change: f64,
    flipped_triangles: f64,
    edge_rms: f64,
    /// The change of volume that is farthest from none.
    pub volume_change_worst: f64,
    /// Most triangles that are turned over in one frame.
    pub flipped_triangles_worst: u32,
    /// The largest stretch in any frame.
    pub max_stretch: f64,
}

impl FrameSums {
    /// Adds a frame.
    pub fn add(&mut self, quality: &QualityReport) {
        self.frames += 1;
        self.volume_change += quality.volume_change;
        self.flipped_triangles += f64::from(quality.flipped_triangles);
        self.edge_rms += quality.edge_rms;
        if quality.volume_change.abs() > self.volume_change_worst.abs() {
            self.volume_change_worst = quality.volume_change;
        }
        self.flipped_triangles_worst = self.flipped_triangles_worst.max(quality.flipped_triangles);
        self.max_stretch = self.max_stretch.max(quality.max_stretch);
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.frames.max(1) as f64
    }

    /// Mean of the changes of volume.
    pub fn volume_change_mean(&self) -> f64 {
        self.mean(self.volume_change)
    }

    /// Mean number of triangles that are turned over.
    pub fn flipped_triangles_mean(&self) -> f64 {
        self.mean(self.flipped_triangles)
    }

    /// Mean of the edges' root mean squares.
    pub fn edge_rms_mean(&self) -> f64 {
        self.mean(self.edge_rms)
    }
}
