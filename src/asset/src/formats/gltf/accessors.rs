//! What an accessor's bytes mean: layout, component types, sparse overrides, dequantisation.

use super::document::{GltfDocument, ParsedDocument};
use super::schema::{BufferView, GltfAccessor, MeshPrimitive, WholeNumber};
use crate::Error;
use crate::files::within;
use glam::Vec3;

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
    /// The layout, or `None` for a component type or shape that glTF 2.0 does not know.
    fn of(accessor: &GltfAccessor, views: &[BufferView]) -> Option<Self> {
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
        let view = accessor.buffer_view.and_then(|v| views.get(v.index()));
        let stride = view.and_then(|v| v.byte_stride);
        Some(Self {
            component,
            lanes: columns * rows,
            element: ((columns - 1) * pitch + column) as u64,
            stride: stride.map_or((columns * pitch) as u64, |s| s.0),
            column: (rows, pitch),
        })
    }
}

/// Which numbers an attribute may be stored as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum ShapeAttribute {
    Position,
    Normal,
    Tangent,
    /// The rotation of a Gaussian splat.
    SplatTurn,
    /// Its standard deviations.
    SplatScale,
    /// A coefficient of its spherical harmonics, counted from the first one of degree 1.
    SplatHarmonic(u8),
}

/// The coefficients of spherical harmonics beyond degree 0, as `KHR_gaussian_splatting` names them.
const HARMONICS: [&str; 15] = [
    "KHR_gaussian_splatting:SH_DEGREE_1_COEF_0",
    "KHR_gaussian_splatting:SH_DEGREE_1_COEF_1",
    "KHR_gaussian_splatting:SH_DEGREE_1_COEF_2",
    "KHR_gaussian_splatting:SH_DEGREE_2_COEF_0",
    "KHR_gaussian_splatting:SH_DEGREE_2_COEF_1",
    "KHR_gaussian_splatting:SH_DEGREE_2_COEF_2",
    "KHR_gaussian_splatting:SH_DEGREE_2_COEF_3",
    "KHR_gaussian_splatting:SH_DEGREE_2_COEF_4",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_0",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_1",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_2",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_3",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_4",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_5",
    "KHR_gaussian_splatting:SH_DEGREE_3_COEF_6",
];

impl ShapeAttribute {
    /// All roles that a deformation of any primitive changes; those of splats beside them.
    pub(super) const ALL: [Self; 3] = [Self::Position, Self::Normal, Self::Tangent];

    /// The attribute's name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Position => "POSITION",
            Self::Normal => "NORMAL",
            Self::Tangent => "TANGENT",
            Self::SplatTurn => "KHR_gaussian_splatting:ROTATION",
            Self::SplatScale => "KHR_gaussian_splatting:SCALE",
            Self::SplatHarmonic(k) => HARMONICS[usize::from(k)],
        }
    }

    /// All roles of splats.
    pub(super) fn of_splats() -> impl Iterator<Item = Self> {
        let harmonics = (0..HARMONICS.len() as u8).map(Self::SplatHarmonic);
        [Self::SplatTurn, Self::SplatScale].into_iter().chain(harmonics)
    }

    /// The role of an attribute of that name.
    pub(super) fn of_name(name: &str) -> Option<Self> {
        let mut all = Self::ALL.into_iter().chain(Self::of_splats());
        all.find(|role| role.name() == name)
    }

    /// Numbers per vertex.
    pub(super) fn lanes(self) -> usize {
        if matches!(self, Self::Tangent | Self::SplatTurn) {
            4
        } else {
            3
        }
    }

    /// The accessor type's name.
    pub(super) fn shape(self) -> &'static str {
        if self.lanes() == 4 { "VEC4" } else { "VEC3" }
    }
}

impl ParsedDocument {
    /// How the elements of an accessor lie; `None` for a component type or shape that glTF 2.0 does not know, or where there is no such accessor.
    pub(super) fn layout(&self, index: usize) -> Option<AccessorLayout> {
        AccessorLayout::of(self.accessors.get(index)?, &self.views.values)
    }
}

impl GltfDocument<'_> {
    /// A fault of an accessor, at a place inside it.
    fn bad_accessor(&self, index: usize, inside: &str, problem: impl Into<String>) -> Error {
        self.fault.malformed(format!("accessors/{index}{inside}"), problem)
    }

    fn find_accessor(&self, index: usize) -> Result<&GltfAccessor, Error> {
        let found = self.accessors.get(index);
        found.ok_or_else(|| self.bad_accessor(index, "", "does not exist"))
    }

    fn short(&self, index: usize) -> Error {
        self.bad_accessor(index, "", "reaches past the end of its buffer view")
    }

    /// Checks that an accessor may be used in a role, and returns how it lies.
    pub(super) fn check_role(&self, index: usize, role: ShapeAttribute) -> Result<AccessorLayout, Error> {
        let accessor = self.find_accessor(index)?;
        let (name, seen, needed) = (role.name(), &accessor.shape, role.shape());
        if seen != needed {
            let problem = format!("{name} has type {seen:?}, {needed} is needed");
            return Err(self.bad_accessor(index, "/type", problem));
        }
        let component = accessor.component_type.0;
        let Some(layout) = self.layout(index) else {
            let problem = format!("{component} is not a glTF component type");
            return Err(self.bad_accessor(index, "/componentType", problem));
        };
        let quantised = match layout.component {
            ComponentType::F32 => return Ok(layout),
            ComponentType::I8 | ComponentType::I16 => role == ShapeAttribute::Position || accessor.normalized,
            ComponentType::U8 | ComponentType::U16 => role == ShapeAttribute::Position,
            ComponentType::U32 => false,
        };
        let is_of_splats = !ShapeAttribute::ALL.contains(&role) && layout.component != ComponentType::U32;
        if is_of_splats || (quantised && self.uses("KHR_mesh_quantization")) {
            return Ok(layout);
        }
        let problem = format!(
            "{name} has component type {component}; 5126 (float) is needed, or a type that KHR_mesh_quantization allows"
        );
        Err(self.bad_accessor(index, "/componentType", problem))
    }

    /// All elements of an attribute in file order, lane by lane, as floats. Normals and tangents that are stored as integers
    /// come out at unit length, which rounding to integers took from them.
    pub(super) fn read_floats(&self, index: usize, role: ShapeAttribute) -> Result<Vec<f32>, Error> {
        let layout = self.check_role(index, role)?;
        let mut values = self.read_values(index, layout)?;
        let is_direction = matches!(role, ShapeAttribute::Normal | ShapeAttribute::Tangent);
        if is_direction && layout.component != ComponentType::F32 {
            for element in values.chunks_exact_mut(layout.lanes) {
                let unit = Vec3::from_slice(element).as_dvec3().try_normalize();
                if let Some(unit) = unit {
                    element[..3].copy_from_slice(&unit.as_vec3().to_array());
                }
            }
        }
        Ok(values)
    }

    /// An attribute of a primitive as [`GltfDocument::read_floats`] gives it; `None` where the primitive has none.
    pub(super) fn read_attribute(
        &self,
        primitive: &MeshPrimitive,
        role: ShapeAttribute,
    ) -> Result<Option<Vec<f32>>, Error> {
        let accessor = primitive.attribute(role.name());
        accessor.map(|accessor| self.read_floats(accessor, role)).transpose()
    }

    /// All elements of an accessor of any kind, lane by lane, as floats.
    pub(super) fn read_values(&self, index: usize, layout: AccessorLayout) -> Result<Vec<f32>, Error> {
        let accessor = self.find_accessor(index)?;
        let count = accessor.count.index();
        let mut values = Vec::new();
        let read_run = |bytes, offset, layout, count, into: &mut Vec<f32>| {
            read_run(bytes, offset, layout, accessor.normalized, count, into).ok_or_else(|| self.short(index))
        };
        if let Some(view) = accessor.buffer_view {
            let bytes = self.view(view.index())?;
            values.reserve_exact(count.min(bytes.len()) * layout.lanes);
            read_run(bytes, accessor.offset(), layout, count, &mut values)?;
        } else {
            self.check_unbacked(index, layout)?;
            values.resize(count * layout.lanes, 0.0);
        }
        let Some(sparse) = &accessor.sparse else {
            return Ok(values);
        };
        let packed = AccessorLayout {
            stride: layout.element,
            ..layout
        };
        let (at, mut replaced) = (&sparse.values, Vec::new());
        let bytes = self.view(at.buffer_view.index())?;
        read_run(bytes, at.byte_offset.0, packed, sparse.count.index(), &mut replaced)?;
        let targets = self.sparse_indices(index)?;
        for (target, from) in targets.into_iter().zip(replaced.chunks_exact(layout.lanes)) {
            values[target * layout.lanes..][..layout.lanes].copy_from_slice(from);
        }
        Ok(values)
    }

    /// An accessor without a view costs no bytes in the file, so its count proves nothing; what it may take is bounded by
    /// the file that asks for it.
    pub(super) fn check_unbacked(&self, index: usize, layout: AccessorLayout) -> Result<(), Error> {
        let accessor = &self.accessors.values[index];
        if accessor.buffer_view.is_some() {
            return Ok(());
        }
        let limit = 1_048_576 + 64 * self.text.len() as u64;
        let seen = accessor.count.0.saturating_mul(layout.element);
        within("size in bytes of an accessor without a buffer view", seen, limit)
    }

    /// The elements that an accessor's sparse values replace, ascending; none when it is not sparse.
    pub(super) fn sparse_indices(&self, index: usize) -> Result<Vec<usize>, Error> {
        let accessor = &self.accessors.values[index];
        let Some(sparse) = &accessor.sparse else {
            return Ok(Vec::new());
        };
        let (at, count) = (&sparse.indices, sparse.count.index());
        let Some(component) = component_of(at.component_type.0) else {
            return Err(self.short(index));
        };
        let bytes = self.view(at.buffer_view.index())?;
        let indices = read_whole(bytes, at.byte_offset.0, component, component.size() as u64, count);
        let indices = indices.ok_or_else(|| self.short(index))?;
        let mut next = 0;
        for (i, &target) in indices.iter().enumerate() {
            if u64::from(target) < next || u64::from(target) >= accessor.count.0 {
                let most = accessor.count.0;
                let problem = format!("index {target} at {i}; indices must increase and stay below {most}");
                return Err(self.bad_accessor(index, "/sparse/indices", problem));
            }
            next = u64::from(target) + 1;
        }
        Ok(indices.into_iter().map(|t| t as usize).collect())
    }

    /// The indices of a primitive.
    pub(super) fn read_indices(&self, index: usize) -> Result<Vec<u32>, Error> {
        let accessor = self.find_accessor(index)?;
        let is_index = |l: &AccessorLayout| {
            let kinds = [ComponentType::U8, ComponentType::U16, ComponentType::U32];
            l.lanes == 1 && kinds.contains(&l.component) && !accessor.normalized
        };
        let Some(layout) = self.layout(index).filter(is_index) else {
            let problem = format!(
                "indices of component type {} and type {:?}; SCALAR of 5121, 5123 or 5125, not normalized, is needed",
                accessor.component_type.0, accessor.shape
            );
            return Err(self.bad_accessor(index, "", problem));
        };
        let read = |view: usize, offset: u64, stride: u64, count: usize| {
            let whole = read_whole(self.view(view)?, offset, layout.component, stride, count);
            whole.ok_or_else(|| self.short(index))
        };
        let count = accessor.count.index();
        let mut indices = match accessor.buffer_view.map(WholeNumber::index) {
            None => {
                self.check_unbacked(index, layout)?;
                vec![0; count]
            }
            Some(view) => {
                if let Some(stride) = self.views.get(view).and_then(|v| v.byte_stride)
                    && stride.0 != layout.element
                {
                    let problem = format!("a view of indices must be packed, it has a stride of {}", stride.0);
                    return Err(self.fault.malformed(format!("bufferViews/{view}/byteStride"), problem));
                }
                read(view, accessor.offset(), layout.stride, count)?
            }
        };
        if let Some(sparse) = &accessor.sparse {
            let at = &sparse.values;
            let values = read(
                at.buffer_view.index(),
                at.byte_offset.0,
                layout.element,
                sparse.count.index(),
            )?;
            for (target, value) in self.sparse_indices(index)?.into_iter().zip(values) {
                indices[target] = value;
            }
        }
        Ok(indices)
    }
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
