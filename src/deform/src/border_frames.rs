//! Corrections of local frames at the edges of hard handles.

use crate::first_pass::blend::LocalFrame;
use glam::{DMat3, Mat3};

/// By node what its frame is multiplied with from the right, for nodes at the edges of hard handles alone.
#[derive(Debug, Clone, Default)]
pub(crate) struct BorderFrames(Vec<(u32, DMat3)>);

impl BorderFrames {
    /// With these, one a node.
    pub fn new(corrections: Vec<(u32, DMat3)>) -> Self {
        Self(corrections)
    }

    /// Whether nothing is corrected.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Corrects frames; returns those that they replace, in the order of nodes here.
    pub fn put_into(&self, frames: &mut [LocalFrame]) -> Vec<LocalFrame> {
        let put = |&(node, by): &(u32, DMat3)| {
            let frame = &mut frames[node as usize];
            let corrected = (linear(frame) * by).as_mat3().to_cols_array();
            std::mem::replace(frame, corrected)
        };
        self.0.iter().map(put).collect()
    }

    /// Takes corrections back.
    pub fn take_back(&self, before: Vec<LocalFrame>, frames: &mut [LocalFrame]) {
        let nodes = self.0.iter().zip(before);
        nodes.for_each(|(&(node, _), frame)| frames[node as usize] = frame);
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.0.capacity() * size_of::<(u32, DMat3)>()
    }
}

/// The linear map of a frame.
pub(crate) fn linear(frame: &LocalFrame) -> DMat3 {
    Mat3::from_cols_array(frame).as_dmat3()
}
