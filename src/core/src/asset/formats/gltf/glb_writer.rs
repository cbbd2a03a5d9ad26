//! Lays out a GLB from nothing: accessors over one buffer, and a document that its maker fills in.

use super::builder::{BufferBuilder, NewAccessor, NewSparse};
use super::container;
use super::document::GLB_FORMAT;
use super::fault::GltfFault;
use crate::asset::Error;
use serde_json::{Value, json};
use std::collections::BTreeMap;

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
#[derive(Default)]
pub(in crate::asset) struct GlbWriter {
    data: BufferBuilder,
    /// The least and the largest value of each lane, by accessor.
    bounds: BTreeMap<usize, [Vec<f64>; 2]>,
}

impl GlbWriter {
    /// Adds floats with their bounds, as positions and times of keys must have; returns the accessor's number.
    pub(in crate::asset) fn add_bounded(&mut self, values: &[f32], shape: ElementShape) -> usize {
        let lanes = shape.name_and_lanes().1;
        let of = |pick: fn(f32, f32) -> f32, start: f32| -> Vec<f64> {
            let over = |lane: usize| values.iter().skip(lane).step_by(lanes).copied().fold(start, pick);
            (0..lanes).map(|lane| f64::from(over(lane))).collect()
        };
        let bounds = [of(f32::min, f32::INFINITY), of(f32::max, f32::NEG_INFINITY)];
        let accessor = self.add_floats(values, shape);
        self.bounds.insert(accessor, bounds);
        accessor
    }

    /// Adds vectors of `count` vertices that are zero but for those of `places`, which ascend; returns the accessor's number.
    pub(in crate::asset) fn add_sparse(&mut self, count: usize, places: &[u32], values: &[[f32; 3]]) -> usize {
        let sparse = (!places.is_empty()).then(|| {
            let indices: Vec<u8> = places.iter().flat_map(|p| p.to_le_bytes()).collect();
            let numbers: Vec<u8> = values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
            NewSparse {
                count: places.len(),
                indices: self.add_view(&indices),
                values: self.add_view(&numbers),
            }
        });
        let with_zero = |pick: fn(f32, f32) -> f32| -> Vec<f64> {
            let over = |lane: usize| values.iter().map(|v| v[lane]).fold(0.0, pick);
            (0..3).map(|lane| f64::from(over(lane))).collect()
        };
        let accessor = self.data.push_accessor(NewAccessor {
            view: None,
            component: 5126,
            count,
            shape: "VEC3",
            bounds: None,
            sparse,
        });
        let bounds = [with_zero(f32::min), with_zero(f32::max)];
        self.bounds.insert(accessor, bounds);
        accessor
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
        let (shape, lanes) = shape.name_and_lanes();
        let view = self.add_view(bytes);
        self.data.push_accessor(NewAccessor {
            view: Some(view),
            component,
            count: numbers / lanes,
            shape,
            bounds: None,
            sparse: None,
        })
    }

    /// Adds bytes as a view of their own, such as a picture; returns its number.
    pub(in crate::asset) fn add_view(&mut self, bytes: &[u8]) -> usize {
        self.data.add_view(bytes, None)
    }

    /// The file: `document` with the asset, the accessors and the buffer added.
    ///
    /// # Errors
    /// When it would be larger than a GLB can be.
    pub(in crate::asset) fn finish(self, mut document: Value) -> Result<Vec<u8>, Error> {
        let mut bytes = self.data.bytes().to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        let values = |texts: Vec<String>| -> Vec<Value> {
            let parsed = texts.iter().map(|text| serde_json::from_str(text));
            parsed.map(Result::unwrap_or_default).collect()
        };
        let mut accessors = values(self.data.accessor_texts(0));
        for (accessor, [least, most]) in self.bounds {
            accessors[accessor]["min"] = json!(least);
            accessors[accessor]["max"] = json!(most);
        }
        document["asset"] = json!({"version": "2.0", "generator": "pliant"});
        document["accessors"] = Value::Array(accessors);
        document["bufferViews"] = Value::Array(values(self.data.view_texts(0, 0)));
        document["buffers"] = json!([{"byteLength": bytes.len()}]);
        container::join(&document.to_string(), Some(&bytes), &[], GltfFault(GLB_FORMAT))
    }
}
