//! What an accessor's bytes mean: layout, component types, sparse overrides, dequantisation.

use super::buffers::BufferBytes;
use super::document::GltfDocument;
use super::schema::{BufferView, GltfAccessor};
use crate::Error;
use crate::files::within;
use glam::Vec3;
use std::collections::BTreeSet;

/// Type of one number, as the `gltf` crate names it.
pub(super) use gltf::json::accessor::ComponentType;

/// The type that a `componentType` number stands for.
fn component_of(code: u64) -> Option<ComponentType> {
    use gltf::json::accessor as known;
    Some(match u32::try_from(code).ok()? {
        known::BYTE => ComponentType::I8,
        known::UNSIGNED_BYTE => ComponentType::U8,
        known::SHORT => ComponentType::I16,
        known::UNSIGNED_SHORT => ComponentType::U16,
        known::UNSIGNED_INT => ComponentType::U32,
        known::FLOAT => ComponentType::F32,
        _ => return None,
    })
}

/// The number that starts `bytes`; integers are scaled to 0..1 or -1..1 when `normalized`.
fn read_number(component: ComponentType, bytes: &[u8], normalized: bool) -> Option<f32> {
    let scaled = |value: f32, largest: f32| if normalized { (value / largest).max(-1.0) } else { value };
    Some(match component {
        ComponentType::I8 => scaled(f32::from(i8::from_le_bytes(*bytes.first_chunk()?)), 127.0),
        ComponentType::U8 => scaled(f32::from(*bytes.first()?), 255.0),
        ComponentType::I16 => scaled(f32::from(i16::from_le_bytes(*bytes.first_chunk()?)), 32_767.0),
        ComponentType::U16 => scaled(f32::from(u16::from_le_bytes(*bytes.first_chunk()?)), 65_535.0),
        ComponentType::U32 => u32::from_le_bytes(*bytes.first_chunk()?) as f32,
        ComponentType::F32 => f32::from_le_bytes(*bytes.first_chunk()?),
    })
}

/// How an accessor's elements lie in its view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct AccessorLayout {
    pub(super) component: ComponentType,
    /// Numbers per element.
    pub(super) lanes: usize,
    /// Bytes of one element.
    pub(super) element: u64,
    /// Bytes from one element to the next.
    pub(super) stride: u64,
    /// Numbers per column, and bytes from one column to the next; vectors are one column.
    column: (usize, usize),
}

impl AccessorLayout {
    /// The layout of an accessor of a document; `None` as for [`AccessorLayout::of`], or where there is no such accessor.
    pub(super) fn find(doc: &GltfDocument<'_>, index: usize) -> Option<Self> {
        Self::of(doc.accessors.get(index)?, doc.views.values)
    }

    /// The layout, or `None` for a component type or shape that glTF 2.0 does not know.
    pub(super) fn of(accessor: &GltfAccessor, views: &[BufferView]) -> Option<Self> {
        let component = component_of(accessor.component_type.0)?;
        let (columns, rows) = match accessor.shape.as_str() {
            "SCALAR" => (1, 1),
            "VEC2" => (1, 2),
            "VEC3" => (1, 3),
            "VEC4" => (1, 4),
            "MAT2" => (2, 2),
            "MAT3" => (3, 3),
            "MAT4" => (4, 4),
            _ => return None,
        };
        let column = rows * component.size();
        // Columns of matrices start at multiples of four bytes; vectors are packed.
        let pitch = if columns > 1 {
            column.next_multiple_of(4)
        } else {
            column
        };
        let stride = accessor
            .buffer_view
            .and_then(|v| views.get(v.index()))
            .and_then(|v| v.byte_stride);
        Some(Self {
            component,
            lanes: columns * rows,
            element: ((columns - 1) * pitch + column) as u64,
            stride: stride.map_or((columns * pitch) as u64, |s| s.0),
            column: (rows, pitch),
        })
    }
}

/// As [`read_values`], after decompressing what the accessor needs.
pub(super) fn decode_values(
    doc: &GltfDocument<'_>,
    buffers: &mut BufferBytes,
    index: usize,
    layout: AccessorLayout,
) -> Result<Vec<f32>, Error> {
    check_unbacked(doc, index, layout)?;
    buffers.decode_for(doc, &BTreeSet::from([index]))?;
    read_values(doc, buffers, index, layout)
}

/// Which numbers an attribute may be stored as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum ShapeAttribute {
    Position,
    Normal,
    Tangent,
}

impl ShapeAttribute {
    /// All roles that a deformation changes.
    pub(super) const ALL: [Self; 3] = [Self::Position, Self::Normal, Self::Tangent];

    /// The attribute's name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Position => "POSITION",
            Self::Normal => "NORMAL",
            Self::Tangent => "TANGENT",
        }
    }

    /// Numbers per vertex.
    pub(super) fn lanes(self) -> usize {
        if self == Self::Tangent { 4 } else { 3 }
    }

    /// The accessor type's name.
    pub(super) fn shape(self) -> &'static str {
        if self == Self::Tangent { "VEC4" } else { "VEC3" }
    }
}

/// Checks that an accessor may be used in a role, and returns how it lies.
pub(super) fn check_role(doc: &GltfDocument<'_>, index: usize, role: ShapeAttribute) -> Result<AccessorLayout, Error> {
    let place = || format!("accessors/{index}");
    let Some(accessor) = doc.accessors.get(index) else {
        return Err(doc.fault.malformed(place(), "does not exist"));
    };
    if accessor.shape != role.shape() {
        let problem = format!(
            "{} has type {:?}, {} is needed",
            role.name(),
            accessor.shape,
            role.shape()
        );
        return Err(doc.fault.malformed(place() + "/type", problem));
    }
    let Some(layout) = AccessorLayout::of(accessor, doc.views.values) else {
        let problem = format!("{} is not a glTF component type", accessor.component_type.0);
        return Err(doc.fault.malformed(place() + "/componentType", problem));
    };
    let quantised = match layout.component {
        ComponentType::F32 => return Ok(layout),
        ComponentType::I8 | ComponentType::I16 => role == ShapeAttribute::Position || accessor.normalized,
        ComponentType::U8 | ComponentType::U16 => role == ShapeAttribute::Position,
        ComponentType::U32 => false,
    };
    if quantised && doc.uses("KHR_mesh_quantization") {
        return Ok(layout);
    }
    let problem = format!(
        "{} has component type {}; 5126 (float) is needed, or a type that KHR_mesh_quantization allows",
        role.name(),
        accessor.component_type.0
    );
    Err(doc.fault.malformed(place() + "/componentType", problem))
}

/// All elements of an attribute in file order, lane by lane, as floats. Compressed views must be decoded. Normals and tangents
/// that are stored as integers come out at unit length, which rounding to integers took from them.
pub(super) fn read_floats(
    doc: &GltfDocument<'_>,
    buffers: &BufferBytes,
    index: usize,
    role: ShapeAttribute,
) -> Result<Vec<f32>, Error> {
    let layout = check_role(doc, index, role)?;
    let mut values = read_values(doc, buffers, index, layout)?;
    if role != ShapeAttribute::Position && layout.component != ComponentType::F32 {
        for element in values.chunks_exact_mut(layout.lanes) {
            let unit = Vec3::from_slice(element).as_dvec3().try_normalize();
            if let Some(unit) = unit {
                element[..3].copy_from_slice(&unit.as_vec3().to_array());
            }
        }
    }
    Ok(values)
}

/// All elements of an accessor of any kind, lane by lane, as floats. Compressed views must be decoded.
pub(super) fn read_values(
    doc: &GltfDocument<'_>,
    buffers: &BufferBytes,
    index: usize,
    layout: AccessorLayout,
) -> Result<Vec<f32>, Error> {
    let Some(accessor) = doc.accessors.get(index) else {
        return Err(doc.fault.malformed(format!("accessors/{index}"), "does not exist"));
    };
    let count = accessor.count.index();
    let mut values = Vec::new();
    if let Some(view) = accessor.buffer_view {
        let bytes = buffers.view(doc, view.index())?;
        values.reserve_exact(count.min(bytes.len()) * layout.lanes);
        read_run(
            bytes,
            accessor.offset(),
            layout,
            accessor.normalized,
            count,
            &mut values,
        )
        .ok_or_else(|| short(doc, index))?;
    } else {
        check_unbacked(doc, index, layout)?;
        values.resize(count * layout.lanes, 0.0);
    }
    let Some(sparse) = &accessor.sparse else {
        return Ok(values);
    };
    let overrides = buffers.view(doc, sparse.values.buffer_view.index())?;
    let packed = AccessorLayout {
        stride: layout.element,
        ..layout
    };
    let mut replaced = Vec::new();
    read_run(
        overrides,
        sparse.values.byte_offset.0,
        packed,
        accessor.normalized,
        sparse.count.index(),
        &mut replaced,
    )
    .ok_or_else(|| short(doc, index))?;
    let targets = sparse_indices(doc, buffers, index)?;
    for (target, from) in targets.into_iter().zip(replaced.chunks_exact(layout.lanes)) {
        values[target * layout.lanes..][..layout.lanes].copy_from_slice(from);
    }
    Ok(values)
}

/// An accessor without a view costs no bytes in the file, so its count proves nothing; what it may take is bounded by
/// the file that asks for it.
pub(super) fn check_unbacked(doc: &GltfDocument<'_>, index: usize, layout: AccessorLayout) -> Result<(), Error> {
    let accessor = &doc.accessors.values[index];
    if accessor.buffer_view.is_some() {
        return Ok(());
    }
    let limit = 1_048_576 + 64 * doc.text.len() as u64;
    let seen = accessor.count.0.saturating_mul(layout.element);
    within("size in bytes of an accessor without a buffer view", seen, limit)
}

/// The elements that an accessor's sparse values replace, ascending; none when it is not sparse. Compressed views must be
/// decoded.
pub(super) fn sparse_indices(doc: &GltfDocument<'_>, buffers: &BufferBytes, index: usize) -> Result<Vec<usize>, Error> {
    let accessor = &doc.accessors.values[index];
    let Some(sparse) = &accessor.sparse else {
        return Ok(Vec::new());
    };
    let Some(component) = component_of(sparse.indices.component_type.0) else {
        return Err(short(doc, index));
    };
    let bytes = buffers.view(doc, sparse.indices.buffer_view.index())?;
    let indices = read_whole(
        bytes,
        sparse.indices.byte_offset.0,
        component,
        component.size() as u64,
        sparse.count.index(),
    )
    .ok_or_else(|| short(doc, index))?;
    let mut next = 0;
    for (i, &target) in indices.iter().enumerate() {
        if u64::from(target) < next || u64::from(target) >= accessor.count.0 {
            let problem = format!(
                "index {target} at {i}; indices must increase and stay below {}",
                accessor.count.0
            );
            return Err(doc
                .fault
                .malformed(format!("accessors/{index}/sparse/indices"), problem));
        }
        next = u64::from(target) + 1;
    }
    Ok(indices.into_iter().map(|t| t as usize).collect())
}

/// The indices of a primitive. Compressed views must be decoded.
pub(super) fn read_indices(doc: &GltfDocument<'_>, buffers: &BufferBytes, index: usize) -> Result<Vec<u32>, Error> {
    let place = || format!("accessors/{index}");
    let Some(accessor) = doc.accessors.get(index) else {
        return Err(doc.fault.malformed(place(), "does not exist"));
    };
    let layout = AccessorLayout::of(accessor, doc.views.values)
        .filter(|l| l.lanes == 1 && matches!(l.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32));
    let Some(layout) = layout.filter(|_| !accessor.normalized) else {
        let problem = format!(
            "indices of component type {} and type {:?}; SCALAR of 5121, 5123 or 5125, not normalized, is needed",
            accessor.component_type.0, accessor.shape
        );
        return Err(doc.fault.malformed(place(), problem));
    };
    let Some(view) = accessor.buffer_view else {
        check_unbacked(doc, index, layout)?;
        let mut indices = vec![0; accessor.count.index()];
        return apply_sparse_indices(doc, buffers, index, layout, &mut indices).map(|()| indices);
    };
    if let Some(stride) = doc.views.get(view.index()).and_then(|v| v.byte_stride)
        && stride.0 != layout.element
    {
        let problem = format!("a view of indices must be packed, it has a stride of {}", stride.0);
        return Err(doc
            .fault
            .malformed(format!("bufferViews/{}/byteStride", view.0), problem));
    }
    let bytes = buffers.view(doc, view.index())?;
    let mut indices = read_whole(
        bytes,
        accessor.offset(),
        layout.component,
        layout.stride,
        accessor.count.index(),
    )
    .ok_or_else(|| short(doc, index))?;
    apply_sparse_indices(doc, buffers, index, layout, &mut indices).map(|()| indices)
}

fn apply_sparse_indices(
    doc: &GltfDocument<'_>,
    buffers: &BufferBytes,
    index: usize,
    layout: AccessorLayout,
    indices: &mut [u32],
) -> Result<(), Error> {
    let Some(sparse) = &doc.accessors.values[index].sparse else {
        return Ok(());
    };
    let bytes = buffers.view(doc, sparse.values.buffer_view.index())?;
    let values = read_whole(
        bytes,
        sparse.values.byte_offset.0,
        layout.component,
        layout.element,
        sparse.count.index(),
    )
    .ok_or_else(|| short(doc, index))?;
    for (target, value) in sparse_indices(doc, buffers, index)?.into_iter().zip(values) {
        indices[target] = value;
    }
    Ok(())
}

fn short(doc: &GltfDocument<'_>, index: usize) -> Error {
    doc.fault
        .malformed(format!("accessors/{index}"), "reaches past the end of its buffer view")
}

fn read_run(
    bytes: &[u8],
    offset: u64,
    layout: AccessorLayout,
    normalized: bool,
    count: usize,
    into: &mut Vec<f32>,
) -> Option<()> {
    let (mut at, stride) = (usize::try_from(offset).ok()?, usize::try_from(layout.stride).ok()?);
    for _ in 0..count {
        let element = bytes.get(at..)?;
        for lane in 0..layout.lanes {
            let (column, row) = (lane / layout.column.0, lane % layout.column.0);
            let number = element.get(column * layout.column.1 + row * layout.component.size()..)?;
            into.push(read_number(layout.component, number, normalized)?);
        }
        at = at.checked_add(stride)?;
    }
    Some(())
}

fn read_whole(bytes: &[u8], offset: u64, component: ComponentType, stride: u64, count: usize) -> Option<Vec<u32>> {
    let (mut at, stride) = (usize::try_from(offset).ok()?, usize::try_from(stride).ok()?);
    let mut out = Vec::with_capacity(count.min(bytes.len()));
    for _ in 0..count {
        let element = bytes.get(at..)?;
        out.push(match component {
            ComponentType::U8 => u32::from(*element.first()?),
            ComponentType::U16 => u32::from(u16::from_le_bytes(*element.first_chunk()?)),
            ComponentType::U32 => u32::from_le_bytes(*element.first_chunk()?),
            _ => return None,
        });
        at = at.checked_add(stride)?;
    }
    Some(out)
}
