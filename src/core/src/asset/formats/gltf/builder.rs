//! New accessors, buffer views and their bytes: the only place that writes them as JSON.

use super::buffers::BufferBytes;
use super::container::{self, GltfFault};
use super::document::{GLB_FORMAT, GltfDocument, PatchedDocument};
use super::text::{json_array, json_object, quoted};
use super::uri;
use crate::asset::Error;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::hash::Hasher as _;

/// `target` of a view of vertex attributes.
pub(super) const VERTICES: u32 = 34962;
/// `target` of a view of indices.
pub(super) const INDICES: u32 = 34963;

/// How the numbers of a new accessor are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AccessorKind {
    /// A vertex attribute of 32-bit floats.
    Floats,
    /// The same with the bounds that positions must have.
    Positions,
    /// 32-bit floats that are no attribute of vertices.
    Numbers,
    /// The same with the bounds that times of clips must have.
    Times,
    /// Four joints in 8 or 16 bits.
    Joints8,
    Joints16,
    /// Indices in 16 or 32 bits.
    Indices16,
    Indices32,
}

/// A view over the new bytes.
struct NewView {
    start: usize,
    length: usize,
    stride: Option<usize>,
    target: Option<u32>,
}

/// A new accessor.
#[derive(Debug, PartialEq)]
pub(super) struct NewAccessor {
    /// Its view among the new ones; `None` for zeros.
    pub(super) view: Option<usize>,
    /// Type of one number.
    pub(super) component: u32,
    pub(super) count: usize,
    /// How many numbers make an element: SCALAR, VEC2, …
    pub(super) shape: &'static str,
    /// The least and the largest value of each lane as JSON.
    pub(super) bounds: Option<(String, String)>,
    /// Elements that other values replace.
    pub(super) sparse: Option<NewSparse>,
}

/// Elements of an accessor that other values replace; both views are among the new ones.
#[derive(Debug, PartialEq)]
pub(super) struct NewSparse {
    pub(super) count: usize,
    /// 32-bit indices.
    pub(super) indices: usize,
    pub(super) values: usize,
}

/// New data, to be appended to what stays of a document. Numbers of views and accessors count from its first ones.
#[derive(Default)]
pub(super) struct BufferBuilder {
    bytes: Vec<u8>,
    views: Vec<NewView>,
    accessors: Vec<NewAccessor>,
    /// Accessors that equal ones may share, by a hash of their bytes.
    known: BTreeMap<u64, Vec<usize>>,
}

impl BufferBuilder {
    /// Whether nothing is new.
    pub(super) fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// The bytes of all views.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// How many views there are.
    pub(super) fn view_count(&self) -> usize {
        self.views.len()
    }

    /// Adds an attribute of floats; its number among the new accessors.
    pub(super) fn add_floats(
        &mut self,
        values: &[f32],
        lanes: usize,
        shape: &'static str,
        kind: AccessorKind,
    ) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let is_bounded = matches!(kind, AccessorKind::Positions | AccessorKind::Times);
        let bounds = is_bounded.then(|| bounds(values, lanes));
        self.add_accessor(&bytes, kind, values.len() / lanes.max(1), shape, bounds)
    }

    /// Adds a set of joints, in 8 bits where they fit.
    pub(super) fn add_joints(&mut self, values: &[f32]) -> usize {
        let small = values.iter().all(|&v| v <= 255.0);
        let bytes: Vec<u8> = if small {
            values.iter().map(|&v| v as u8).collect()
        } else {
            values.iter().flat_map(|&v| (v as u16).to_le_bytes()).collect()
        };
        let kind = if small {
            AccessorKind::Joints8
        } else {
            AccessorKind::Joints16
        };
        self.add_accessor(&bytes, kind, values.len() / 4, "VEC4", None)
    }

    /// Adds the corners of triangles over so many vertices.
    pub(super) fn add_indices(&mut self, triangles: &[[u32; 3]], vertices: usize) -> usize {
        let (bytes, component) = index_bytes(triangles.as_flattened(), vertices);
        let kind = match component {
            5123 => AccessorKind::Indices16,
            _ => AccessorKind::Indices32,
        };
        self.add_accessor(&bytes, kind, triangles.len() * 3, "SCALAR", None)
    }

    /// Adds bytes as a view of their own; its number.
    pub(super) fn add_view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.add_strided_view(bytes, None, target)
    }

    /// Adds bytes as a view of their own, whose elements begin at every `stride` bytes; its number.
    pub(super) fn add_strided_view(&mut self, bytes: &[u8], stride: Option<usize>, target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(NewView {
            start: self.bytes.len(),
            length: bytes.len(),
            stride,
            target,
        });
        self.bytes.extend_from_slice(bytes);
        self.views.len() - 1
    }

    /// Adds an accessor over views that have been added; its number.
    pub(super) fn push_accessor(&mut self, accessor: NewAccessor) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds an accessor with a view of its own, or finds one that is equal.
    fn add_accessor(
        &mut self,
        bytes: &[u8],
        kind: AccessorKind,
        count: usize,
        shape: &'static str,
        bounds: Option<(String, String)>,
    ) -> usize {
        let (component, target) = match kind {
            AccessorKind::Floats | AccessorKind::Positions => (5126, Some(VERTICES)),
            AccessorKind::Numbers | AccessorKind::Times => (5126, None),
            AccessorKind::Joints8 => (5121, Some(VERTICES)),
            AccessorKind::Joints16 => (5123, Some(VERTICES)),
            AccessorKind::Indices16 => (5123, Some(INDICES)),
            AccessorKind::Indices32 => (5125, Some(INDICES)),
        };
        let mut accessor = NewAccessor {
            view: None,
            component,
            count,
            shape,
            bounds,
            sparse: None,
        };
        let mut hasher = std::hash::DefaultHasher::new();
        hasher.write(bytes);
        let hash = hasher.finish();
        for &old in self.known.get(&hash).into_iter().flatten() {
            accessor.view = self.accessors[old].view;
            let view = accessor.view.map(|view| &self.views[view]);
            let has_same_bytes = view.is_some_and(|view| {
                view.target == target && self.bytes.get(view.start..view.start + view.length) == Some(bytes)
            });
            if has_same_bytes && self.accessors[old] == accessor {
                return old;
            }
        }
        accessor.view = Some(self.add_view(bytes, target));
        let number = self.push_accessor(accessor);
        self.known.entry(hash).or_default().push(number);
        number
    }

    /// The views as JSON, with their bytes beginning at `offset` of `buffer`.
    pub(super) fn view_texts(&self, buffer: usize, offset: usize) -> Vec<String> {
        let one = |view: &NewView| {
            let place = [
                ("buffer", buffer),
                ("byteOffset", offset + view.start),
                ("byteLength", view.length),
            ];
            let stride = view.stride.map(|stride| ("byteStride", stride));
            let target = view.target.map(|target| ("target", target as usize));
            json_object(place.into_iter().chain(stride).chain(target))
        };
        self.views.iter().map(one).collect()
    }

    /// The accessors as JSON, with their views numbered from `first_view` on.
    pub(super) fn accessor_texts(&self, first_view: usize) -> Vec<String> {
        let one = |accessor: &NewAccessor| {
            let number = |key, number: usize| (key, number.to_string());
            let mut text: Vec<(&str, String)> = Vec::new();
            text.extend(accessor.view.map(|view| number("bufferView", first_view + view)));
            text.push(number("componentType", accessor.component as usize));
            text.push(number("count", accessor.count));
            text.push(("type", quoted(accessor.shape)));
            if let Some((least, most)) = accessor.bounds.clone() {
                text.extend([("min", least), ("max", most)]);
            }
            if let Some(sparse) = &accessor.sparse {
                let indices = [("bufferView", first_view + sparse.indices), ("componentType", 5125)];
                let parts = [
                    number("count", sparse.count),
                    ("indices", json_object(indices)),
                    ("values", json_object([("bufferView", first_view + sparse.values)])),
                ];
                text.push(("sparse", json_object(parts)));
            }
            json_object(text)
        };
        self.accessors.iter().map(one).collect()
    }

    /// Refuses more than one buffer holds, `kept` bytes standing before. `buffer` names it.
    pub(super) fn check_size(&self, kept: usize, buffer: &str, fault: GltfFault) -> Result<(), Error> {
        let length = kept as u64 + self.bytes.len() as u64;
        if length > u64::from(u32::MAX) {
            return Err(fault.unwritable(format!("{buffer} would have {length} bytes, 4 GiB is the most")));
        }
        Ok(())
    }

    /// Adds everything to the end of the first buffer of a document that takes more, or to a new one.
    pub(super) fn append_to<'a>(
        &self,
        doc: &GltfDocument<'a>,
        stored: &BufferBytes<'_>,
        patched: &mut PatchedDocument<'a>,
    ) -> Result<(), Error> {
        if self.is_empty() {
            return Ok(());
        }
        let target = stored.growing_buffer(doc);
        let mut bytes = target.map_or_else(Vec::new, |i| {
            let stored = || stored.stored[i].bytes.as_ref().map(|b| b.to_vec());
            patched.buffers.remove(&i).or_else(stored).unwrap_or_default()
        });
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        self.check_size(bytes.len(), "a buffer", doc.fault)?;
        let views = self.view_texts(target.unwrap_or(doc.buffers.len()), bytes.len());
        let accessors = self.accessor_texts(doc.views.len());
        bytes.extend_from_slice(&self.bytes);
        patched
            .edits
            .push_or_set(doc.text, "bufferViews", doc.views.text, &views);
        patched
            .edits
            .push_or_set(doc.text, "accessors", doc.accessors.text, &accessors);
        match target {
            Some(i) => {
                let length = bytes.len().to_string();
                patched.edits.set(doc.buffers.items[i], "byteLength", &length);
                patched.buffers.insert(i, bytes);
            }
            None => patched.added_buffer = Some(bytes),
        }
        Ok(())
    }
}

/// A buffer as JSON that holds its bytes itself.
pub(super) fn embedded_buffer_text(bytes: &[u8]) -> String {
    let data = quoted(&uri::embed(bytes));
    format!(r#"{{"byteLength":{},"uri":{data}}}"#, bytes.len())
}

/// Indices over so many vertices in 16 bits where they fit, else in 32, and the type of one number.
pub(super) fn index_bytes(indices: &[u32], vertices: usize) -> (Vec<u8>, u32) {
    // The largest value of a type is the restart mark, which no index may be.
    if vertices <= usize::from(u16::MAX) {
        (indices.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect(), 5123)
    } else {
        (indices.iter().flat_map(|i| i.to_le_bytes()).collect(), 5125)
    }
}

/// The least and the largest value of each lane as JSON, which read back as exactly the same floats.
pub(super) fn bounds(values: &[f32], lanes: usize) -> (String, String) {
    let mut least = vec![f32::INFINITY; lanes];
    let mut most = vec![f32::NEG_INFINITY; lanes];
    for element in values.chunks_exact(lanes) {
        for (lane, &v) in element.iter().enumerate() {
            least[lane] = least[lane].min(v);
            most[lane] = most[lane].max(v);
        }
    }
    (json_floats(&least), json_floats(&most))
}

/// As doubles: readers of doubles and of floats get the same number.
pub(super) fn json_floats(values: &[f32]) -> String {
    json_array(values.iter().map(|&v| format!("{:?}", f64::from(v))))
}

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
