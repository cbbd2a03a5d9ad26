//! New accessors, each with a view of its own; equal ones are stored once.

use super::super::fault::GltfFault;
use super::super::float_json::bounds;
use crate::asset::Error;
use std::collections::BTreeMap;
use std::hash::Hasher as _;

/// How the numbers of a new accessor are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum NewAccessorKind {
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

struct NewView {
    start: usize,
    length: usize,
    target: Option<u32>,
}

struct NewAccessor {
    view: usize,
    component: u32,
    count: usize,
    shape: &'static str,
    bounds: Option<(String, String)>,
}

/// New data, to be appended to what is kept of the old.
#[derive(Default)]
pub(in super::super) struct NewAccessors {
    bytes: Vec<u8>,
    views: Vec<NewView>,
    accessors: Vec<NewAccessor>,
    known: BTreeMap<u64, Vec<usize>>,
}

impl NewAccessors {
    /// Whether nothing is new.
    pub(in super::super) fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// The bytes of all views.
    pub(in super::super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Adds an attribute of floats; its number among the new accessors.
    pub(in super::super) fn add_floats(
        &mut self,
        values: &[f32],
        lanes: usize,
        shape: &'static str,
        kind: NewAccessorKind,
    ) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let is_bounded = matches!(kind, NewAccessorKind::Positions | NewAccessorKind::Times);
        let bounds = is_bounded.then(|| bounds(values, lanes));
        self.add_accessor(&bytes, kind, values.len() / lanes.max(1), shape, bounds)
    }

    /// Adds a set of joints, in 8 bits where they fit.
    pub(in super::super) fn add_joints(&mut self, values: &[f32]) -> usize {
        let small = values.iter().all(|&v| v <= 255.0);
        let bytes: Vec<u8> = if small {
            values.iter().map(|&v| v as u8).collect()
        } else {
            values.iter().flat_map(|&v| (v as u16).to_le_bytes()).collect()
        };
        let kind = if small {
            NewAccessorKind::Joints8
        } else {
            NewAccessorKind::Joints16
        };
        self.add_accessor(&bytes, kind, values.len() / 4, "VEC4", None)
    }

    /// Adds the corners of triangles over so many vertices.
    pub(in super::super) fn add_indices(&mut self, triangles: &[[u32; 3]], vertices: usize) -> usize {
        let corners = triangles.iter().flatten();
        // The largest value of a type is the restart mark, which no index may be.
        let (bytes, kind): (Vec<u8>, _) = if vertices <= usize::from(u16::MAX) {
            (
                corners.flat_map(|&i| (i as u16).to_le_bytes()).collect(),
                NewAccessorKind::Indices16,
            )
        } else {
            (
                corners.flat_map(|&i| i.to_le_bytes()).collect(),
                NewAccessorKind::Indices32,
            )
        };
        self.add_accessor(&bytes, kind, triangles.len() * 3, "SCALAR", None)
    }

    /// Adds bytes that are no accessor; the number of their view among the new ones.
    pub(super) fn add_bytes(&mut self, bytes: &[u8]) -> usize {
        self.add_view(bytes, None)
    }

    fn add_view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(NewView {
            start: self.bytes.len(),
            length: bytes.len(),
            target,
        });
        self.bytes.extend_from_slice(bytes);
        self.views.len() - 1
    }

    fn add_accessor(
        &mut self,
        bytes: &[u8],
        kind: NewAccessorKind,
        count: usize,
        shape: &'static str,
        bounds: Option<(String, String)>,
    ) -> usize {
        let (component, target) = match kind {
            NewAccessorKind::Floats | NewAccessorKind::Positions => (5126, Some(34962)),
            NewAccessorKind::Numbers | NewAccessorKind::Times => (5126, None),
            NewAccessorKind::Joints8 => (5121, Some(34962)),
            NewAccessorKind::Joints16 => (5123, Some(34962)),
            NewAccessorKind::Indices16 => (5123, Some(34963)),
            NewAccessorKind::Indices32 => (5125, Some(34963)),
        };
        let mut hasher = std::hash::DefaultHasher::new();
        hasher.write(bytes);
        let hash = hasher.finish();
        let same = |&&i: &&usize| {
            let (old, view) = (&self.accessors[i], &self.views[self.accessors[i].view]);
            (old.component, old.count, old.shape, view.target) == (component, count, shape, target)
                && old.bounds == bounds
                && self.bytes.get(view.start..view.start + view.length) == Some(bytes)
        };
        if let Some(&found) = self.known.get(&hash).and_then(|list| list.iter().find(same)) {
            return found;
        }
        let view = self.add_view(bytes, target);
        self.accessors.push(NewAccessor {
            view,
            component,
            count,
            shape,
            bounds,
        });
        let number = self.accessors.len() - 1;
        self.known.entry(hash).or_default().push(number);
        number
    }

    /// The views as JSON, with their bytes beginning at `offset` of `buffer`.
    pub(in super::super) fn view_texts(&self, buffer: usize, offset: usize) -> Vec<String> {
        let one = |view: &NewView| {
            let target = view.target.map(|t| format!(r#","target":{t}"#)).unwrap_or_default();
            let (start, length) = (offset + view.start, view.length);
            format!(r#"{{"buffer":{buffer},"byteOffset":{start},"byteLength":{length}{target}}}"#)
        };
        self.views.iter().map(one).collect()
    }

    /// The accessors as JSON, with their views numbered from `first_view` on.
    pub(in super::super) fn accessor_texts(&self, first_view: usize) -> Vec<String> {
        let one = |accessor: &NewAccessor| {
            let bounds = accessor.bounds.as_ref();
            let bounds = bounds
                .map(|(least, most)| format!(r#","min":{least},"max":{most}"#))
                .unwrap_or_default();
            format!(
                r#"{{"bufferView":{},"componentType":{},"count":{},"type":"{}"{bounds}}}"#,
                first_view + accessor.view,
                accessor.component,
                accessor.count,
                accessor.shape
            )
        };
        self.accessors.iter().map(one).collect()
    }

    /// Refuses more than one buffer holds, `kept` bytes standing before.
    pub(in super::super) fn check_size(&self, kept: usize, fault: GltfFault) -> Result<(), Error> {
        let length = kept as u64 + self.bytes.len() as u64;
        if length > u64::from(u32::MAX) {
            return Err(fault.unwritable(format!("a buffer would have {length} bytes, 4 GiB is the most")));
        }
        Ok(())
    }
}
