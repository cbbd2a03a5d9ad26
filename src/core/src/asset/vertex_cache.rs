//! Point caches: where the vertices of a model are, frame by frame, without the model. Modelling programs play them on it.
//!
//! Both kinds are a header and then, frame after frame, three 32-bit floats for each vertex.

use glam::Vec3;

/// A kind of point cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VertexCache {
    /// PointCache2, little-endian, frames counted from 0, one sample a frame.
    Pc2,
    /// MDD of LightWave, big-endian, with the time of each frame in seconds.
    Mdd,
}

impl VertexCache {
    /// The kind that a file name's extension asks for, in capitals or not.
    ///
    /// ```
    /// use pliant_core::asset::VertexCache;
    /// assert_eq!(VertexCache::from_file_name("walk.PC2"), Some(VertexCache::Pc2));
    /// assert_eq!(VertexCache::from_file_name("mdd"), None);
    /// ```
    pub fn from_file_name(name: &str) -> Option<Self> {
        let (_, extension) = name.rsplit_once('.')?;
        match extension.to_ascii_lowercase().as_str() {
            "pc2" => Some(Self::Pc2),
            "mdd" => Some(Self::Mdd),
            _ => None,
        }
    }

    /// What stands before the first frame. `seconds`: when each frame is, counted from the first.
    ///
    /// PC2 (3ds Max SDK, "PointCache2"): the mark, version 1, points, first frame, frames a sample, samples. MDD: frames,
    /// points, times.
    ///
    /// ```
    /// use pliant_core::asset::VertexCache;
    /// let header = VertexCache::Pc2.header(3, &[0.0, 0.5]);
    /// assert_eq!(header.len(), 32);
    /// assert_eq!(header[..12], *b"POINTCACHE2\0");
    /// assert_eq!(VertexCache::Mdd.header(3, &[0.0, 0.5])[..8], [0, 0, 0, 2, 0, 0, 0, 3]);
    /// ```
    pub fn header(self, vertices: u32, seconds: &[f64]) -> Vec<u8> {
        let frames = u32::try_from(seconds.len()).unwrap_or(u32::MAX);
        match self {
            Self::Pc2 => {
                let mut bytes = b"POINTCACHE2\0".to_vec();
                bytes.extend(1_u32.to_le_bytes());
                bytes.extend(vertices.to_le_bytes());
                bytes.extend(0.0_f32.to_le_bytes());
                bytes.extend(1.0_f32.to_le_bytes());
                bytes.extend(frames.to_le_bytes());
                bytes
            }
            Self::Mdd => {
                let mut bytes = frames.to_be_bytes().to_vec();
                bytes.extend(vertices.to_be_bytes());
                bytes.extend(seconds.iter().flat_map(|s| (*s as f32).to_be_bytes()));
                bytes
            }
        }
    }

    /// A frame. `positions`: one per vertex, in the order of the model's render vertices.
    pub fn frame(self, positions: &[Vec3]) -> Vec<u8> {
        let numbers = positions.iter().flat_map(|p| p.to_array());
        match self {
            Self::Pc2 => numbers.flat_map(f32::to_le_bytes).collect(),
            Self::Mdd => numbers.flat_map(f32::to_be_bytes).collect(),
        }
    }
}
