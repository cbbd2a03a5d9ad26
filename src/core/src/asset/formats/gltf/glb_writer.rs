//! Lays out a GLB from nothing: accessors over one buffer, and a document that its maker fills in.

use super::container;
use super::document::GLB_FORMAT;
use super::fault::GltfFault;
use crate::asset::Error;
use serde_json::{Value, json};

/// What an accessor's elements are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::asset) enum ElementShape {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    Mat4,
}

impl ElementShape {
    fn name_and_lanes(self) -> (&'static str, usize) {
        match self {
            Self::Scalar => ("SCALAR", 1),
            Self::Vec2 => ("VEC2", 2),
            Self::Vec3 => ("VEC3", 3),
            Self::Vec4 => ("VEC4", 4),
            Self::Mat4 => ("MAT4", 16),
        }
    }
}

/// The buffer of a new GLB and the accessors over it.
#[derive(Debug, Default)]
pub(in crate::asset) struct GlbWriter {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl GlbWriter {
    /// Adds floats with their bounds, as positions and times of keys must have; returns the accessor's number.
    pub(in crate::asset) fn add_bounded(&mut self, values: &[f32], shape: ElementShape) -> usize {
        let lanes = shape.name_and_lanes().1;
        let of = |pick: fn(f32, f32) -> f32, start: f32| -> Vec<f64> {
            let over = |lane: usize| values.iter().skip(lane).step_by(lanes).copied().fold(start, pick);
            (0..lanes).map(|lane| f64::from(over(lane))).collect()
        };
        let (least, most) = (of(f32::min, f32::INFINITY), of(f32::max, f32::NEG_INFINITY));
        let accessor = self.add_floats(values, shape);
        self.accessors[accessor]["min"] = json!(least);
        self.accessors[accessor]["max"] = json!(most);
        accessor
    }

    /// Adds vectors of `count` vertices that are zero but for those of `places`, which ascend; returns the accessor's number.
    pub(in crate::asset) fn add_sparse(&mut self, count: usize, places: &[u32], values: &[[f32; 3]]) -> usize {
        let mut accessor = json!({"componentType": 5126, "count": count, "type": "VEC3"});
        if !places.is_empty() {
            let bytes: Vec<u8> = places.iter().flat_map(|p| p.to_le_bytes()).collect();
            let indices = self.add_view(&bytes);
            let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
            accessor["sparse"] = json!({
                "count": places.len(),
                "indices": {"bufferView": indices, "componentType": 5125},
                "values": {"bufferView": self.add_view(&bytes)},
            });
        }
        let with_zero = |pick: fn(f32, f32) -> f32| -> Vec<f64> {
            let over = |lane: usize| values.iter().map(|v| v[lane]).fold(0.0, pick);
            (0..3).map(|lane| f64::from(over(lane))).collect()
        };
        accessor["min"] = json!(with_zero(f32::min));
        accessor["max"] = json!(with_zero(f32::max));
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds floats; returns the accessor's number.
    pub(in crate::asset) fn add_floats(&mut self, values: &[f32], shape: ElementShape) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add_accessor(&bytes, 5126, values.len(), shape)
    }

    /// Adds the numbers of the joints that hold each vertex; returns the accessor's number.
    pub(in crate::asset) fn add_joints(&mut self, joints: &[[u16; 4]]) -> usize {
        let bytes: Vec<u8> = joints.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add_accessor(&bytes, 5123, joints.len() * 4, ElementShape::Vec4)
    }

    /// Adds the corners of triangles; returns the accessor's number.
    pub(in crate::asset) fn add_triangles(&mut self, triangles: &[[u32; 3]]) -> usize {
        let corners = triangles.as_flattened();
        let bytes: Vec<u8> = corners.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add_accessor(&bytes, 5125, corners.len(), ElementShape::Scalar)
    }

    fn add_accessor(&mut self, bytes: &[u8], component: u32, numbers: usize, shape: ElementShape) -> usize {
        let (name, lanes) = shape.name_and_lanes();
        let view = self.add_view(bytes);
        self.accessors.push(json!({
            "bufferView": view,
            "componentType": component,
            "count": numbers / lanes,
            "type": name,
        }));
        self.accessors.len() - 1
    }

    /// Adds bytes as a view of their own, such as a picture; returns its number.
    pub(in crate::asset) fn add_view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bytes.len();
        self.views
            .push(json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}));
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    /// The file: `document` with the asset, the accessors and the buffer added.
    ///
    /// # Errors
    /// When it would be larger than a GLB can be.
    pub(in crate::asset) fn finish(self, mut document: Value) -> Result<Vec<u8>, Error> {
        document["asset"] = json!({"version": "2.0", "generator": "pliant"});
        document["accessors"] = Value::Array(self.accessors);
        document["bufferViews"] = Value::Array(self.views);
        document["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        container::join(&document.to_string(), Some(&self.bytes), &[], GltfFault(GLB_FORMAT))
    }
}
