//! New accessors, buffer views and their bytes: the only place that writes them as JSON. New GLBs are written by it as well.

use super::buffers;
use super::container::{self, GltfFault};
use super::document::{GLB_FORMAT, GltfDocument};
use super::text::{json_array, json_object, quoted};
use crate::files::ReadWatch;
use crate::{Error, Format};
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

impl NewAccessor {
    /// An accessor of these numbers, without a view, bounds or replaced elements.
    pub(super) fn of(component: u32, count: usize, shape: &'static str) -> Self {
        Self {
            view: None,
            component,
            count,
            shape,
            bounds: None,
            sparse: None,
        }
    }
}

/// Elements of an accessor that other values replace; both views are among the new ones.
#[derive(Debug, PartialEq)]
pub(super) struct NewSparse {
    pub(super) count: usize,
    /// 32-bit indices.
    pub(super) indices: usize,
    pub(super) values: usize,
}

/// New data, to be appended to what stays of a document. Numbers of views count from its first one.
#[derive(Default)]
pub(super) struct BufferBuilder {
    /// The number of its first accessor.
    first: usize,
    bytes: Vec<u8>,
    views: Vec<NewView>,
    accessors: Vec<NewAccessor>,
    /// Accessors that equal ones may share, counted from the first, by a hash of their bytes.
    known: BTreeMap<u64, Vec<usize>>,
}

impl BufferBuilder {
    /// Nothing yet; new accessors are numbered behind those of a document.
    pub(super) fn behind(doc: &GltfDocument<'_>) -> Self {
        Self {
            first: doc.accessors.len(),
            ..Self::default()
        }
    }

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

    /// Adds an attribute of floats; its number.
    pub(super) fn add_floats(&mut self, values: &[f32], shape: &'static str, kind: AccessorKind) -> usize {
        let (bytes, lanes) = (float_bytes(values), lanes_of(shape));
        let is_bounded = matches!(kind, AccessorKind::Positions | AccessorKind::Times);
        let bounds = is_bounded.then(|| bounds(values, lanes));
        self.add_accessor(&bytes, kind, values.len() / lanes, shape, bounds)
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
        self.add_numbers_of_vertices(triangles.as_flattened(), vertices)
    }

    /// Adds numbers of so many vertices.
    pub(super) fn add_numbers_of_vertices(&mut self, numbers: &[u32], vertices: usize) -> usize {
        let (bytes, component) = index_bytes(numbers, vertices);
        let kind = match component {
            5123 => AccessorKind::Indices16,
            _ => AccessorKind::Indices32,
        };
        self.add_accessor(&bytes, kind, numbers.len(), "SCALAR", None)
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
        self.first + self.accessors.len() - 1
    }

    /// Adds an accessor with a view of its own, which no other accessor shares; its number.
    pub(super) fn push_packed(&mut self, bytes: &[u8], target: Option<u32>, accessor: NewAccessor) -> usize {
        let view = Some(self.add_view(bytes, target));
        self.push_accessor(NewAccessor { view, ..accessor })
    }

    /// Adds floats with a view of their own, which no other accessor shares; the number of their accessor.
    pub(super) fn push_floats(
        &mut self,
        values: &[f32],
        shape: &'static str,
        target: Option<u32>,
        bounds: Option<(String, String)>,
    ) -> usize {
        let accessor = NewAccessor {
            bounds,
            ..NewAccessor::of(5126, values.len() / lanes_of(shape), shape)
        };
        self.push_packed(&float_bytes(values), target, accessor)
    }

    /// Adds displacements of `count` vertices of which those of `places` (ascending) are not zero; the number of their accessor.
    pub(super) fn push_displacements(
        &mut self,
        count: usize,
        places: &[u32],
        values: &[[f32; 3]],
        bounds: Option<(String, String)>,
    ) -> usize {
        let sparse = (!places.is_empty()).then(|| NewSparse {
            count: places.len(),
            indices: self.add_view(&index_bytes(places, usize::MAX).0, None),
            values: self.add_view(&float_bytes(values.as_flattened()), None),
        });
        self.push_accessor(NewAccessor {
            sparse,
            bounds,
            ..NewAccessor::of(5126, count, "VEC3")
        })
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
            bounds,
            ..NewAccessor::of(component, count, shape)
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
                return self.first + old;
            }
        }
        accessor.view = Some(self.add_view(bytes, target));
        self.known.entry(hash).or_default().push(self.accessors.len());
        self.push_accessor(accessor)
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

    /// Adds the bytes of all views to those that buffer number `buffer` has; returns the views as JSON. `name` is what the
    /// error calls the buffer.
    ///
    /// # Errors
    /// When that is more than a buffer holds.
    pub(super) fn append_bytes(
        &self,
        kept: &mut Vec<u8>,
        buffer: usize,
        name: &str,
        fault: GltfFault,
    ) -> Result<Vec<String>, Error> {
        kept.resize(kept.len().next_multiple_of(4), 0);
        let length = kept.len() as u64 + self.bytes.len() as u64;
        if length > u64::from(u32::MAX) {
            let problem = format!("{name} would have {length} bytes, 4 GiB is the most");
            return Err(fault.unwritable(problem));
        }
        let views = self.view_texts(buffer, kept.len());
        kept.extend_from_slice(&self.bytes);
        Ok(views)
    }
}

/// How many numbers an element of a shape has.
fn lanes_of(shape: &str) -> usize {
    match shape {
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" | "MAT2" => 4,
        "MAT3" => 9,
        "MAT4" => 16,
        _ => 1,
    }
}

/// A buffer as JSON that holds its bytes itself.
pub(super) fn embedded_buffer_text(bytes: &[u8]) -> String {
    let data = quoted(&buffers::embed(bytes));
    format!(r#"{{"byteLength":{},"uri":{data}}}"#, bytes.len())
}

/// Floats as they are stored.
pub(super) fn float_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
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

/// How often the numbers of an accessor are in memory at most: as they are, as bytes, and in the buffer as it grows.
const COPIES: u64 = 3;

/// The buffer of a new GLB, and the accessors over it. It refuses numbers that are not finite, and reserves what it is about
/// to hold.
pub(in crate::formats) struct GlbWriter<'a> {
    data: BufferBuilder,
    /// The least and the largest value of each lane, by accessor.
    bounds: BTreeMap<usize, [Vec<f64>; 2]>,
    watch: ReadWatch<'a>,
    /// The format that the numbers come from.
    source: Format,
}

impl<'a> GlbWriter<'a> {
    /// An empty buffer for numbers of a file in the format `source`.
    pub(in crate::formats) fn new(source: Format, watch: &ReadWatch<'a>) -> Self {
        Self {
            data: BufferBuilder::default(),
            bounds: BTreeMap::new(),
            watch: watch.clone(),
            source,
        }
    }

    fn make_room(&self, bytes: usize) -> Result<(), Error> {
        self.watch.reserve(COPIES * bytes as u64)
    }

    /// Makes room for elements, every one of which has to be finite; `place` says whose they are.
    fn check<const N: usize>(&self, values: &[[f32; N]], place: &str) -> Result<(), Error> {
        self.make_room(size_of_val(values))?;
        match values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
            Some(i) => {
                let problem = format!("value {i} is {:?}, not finite in 32 bits", values[i]);
                Err(Error::malformed(self.source, place, problem))
            }
            None => Ok(()),
        }
    }

    fn push_floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let shape = match N {
            1 => "SCALAR",
            2 => "VEC2",
            3 => "VEC3",
            4 => "VEC4",
            _ => "MAT4",
        };
        self.data.push_floats(values.as_flattened(), shape, None, None)
    }

    /// Adds bytes as a view of their own, such as a picture; returns its number.
    pub(in crate::formats) fn add_view(&mut self, bytes: &[u8]) -> Result<usize, Error> {
        self.make_room(bytes.len())?;
        Ok(self.data.add_view(bytes, None))
    }

    /// Adds elements of N numbers each; returns the accessor's number. `place` says whose they are.
    pub(in crate::formats) fn add_floats<const N: usize>(
        &mut self,
        values: &[[f32; N]],
        place: &str,
    ) -> Result<usize, Error> {
        self.check(values, place)?;
        Ok(self.push_floats(values))
    }

    /// As [`GlbWriter::add_floats`], with the bounds that positions and times must have.
    pub(in crate::formats) fn add_bounded<const N: usize>(
        &mut self,
        values: &[[f32; N]],
        place: &str,
    ) -> Result<usize, Error> {
        self.check(values, place)?;
        let accessor = self.push_floats(values);
        let bounds = [
            folded(values, f32::INFINITY, f32::min),
            folded(values, f32::NEG_INFINITY, f32::max),
        ];
        self.bounds.insert(accessor, bounds);
        Ok(accessor)
    }

    /// Adds displacements of `count` vertices of which those of `places` (ascending) are not zero.
    pub(in crate::formats) fn add_displacements(
        &mut self,
        count: usize,
        places: &[u32],
        values: &[[f32; 3]],
        place: &str,
    ) -> Result<usize, Error> {
        if places.len() >= count / 4 * 3 {
            let bytes = 12 * count as u64;
            self.watch.reserve(bytes)?;
            let mut all = vec![[0.0; 3]; count];
            for (&at, value) in places.iter().zip(values) {
                all[at as usize] = *value;
            }
            let added = self.add_bounded(&all, place);
            self.watch.release(bytes);
            return added;
        }
        self.make_room(16 * places.len())?;
        self.check(values, place)?;
        let accessor = self.data.push_displacements(count, places, values, None);
        let bounds = [folded(values, 0.0, f32::min), folded(values, 0.0, f32::max)];
        self.bounds.insert(accessor, bounds);
        Ok(accessor)
    }

    /// Adds the joints of vertices, four each; returns the accessor's number.
    pub(in crate::formats) fn add_joints(&mut self, joints: &[[u16; 4]]) -> Result<usize, Error> {
        self.make_room(size_of_val(joints))?;
        let bytes: Vec<u8> = joints.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let accessor = NewAccessor::of(5123, joints.len(), "VEC4");
        Ok(self.data.push_packed(&bytes, None, accessor))
    }

    /// Adds the corners of triangles; returns the accessor's number.
    pub(in crate::formats) fn add_triangles(&mut self, triangles: &[[u32; 3]]) -> Result<usize, Error> {
        self.make_room(size_of_val(triangles))?;
        let (bytes, component) = index_bytes(triangles.as_flattened(), usize::MAX);
        let accessor = NewAccessor::of(component, 3 * triangles.len(), "SCALAR");
        Ok(self.data.push_packed(&bytes, None, accessor))
    }

    /// The file: `document` with the asset, the accessors and the buffer added.
    ///
    /// # Errors
    /// When it would be larger than a GLB can be.
    pub(in crate::formats) fn finish(self, mut document: Value) -> Result<Vec<u8>, Error> {
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

/// For each lane of some elements what `pick` makes of its numbers, from `start` on.
fn folded<const N: usize>(values: &[[f32; N]], start: f32, pick: fn(f32, f32) -> f32) -> Vec<f64> {
    let of_lane = |lane: usize| values.iter().map(|v| v[lane]).fold(start, pick);
    (0..N).map(|lane| f64::from(of_lane(lane))).collect()
}
