//! What every reader hands back: the mesh that the file describes, free of its format.
//!
//! Point caches: where the vertices of a model are, frame by frame, without the model. Modelling programs play them on it.
//!
//! Both kinds are a header and then, frame after frame, three 32-bit floats for each vertex.

use super::{Error, Format, Limits};
use glam::{DVec3, Vec3, Vec4};
use pliant_mesh::shading;
use std::ops::Range;

/// One run of render vertices: a glTF primitive under one node, or the whole of any other format.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Primitive {
    /// Index of the node that places it; 0 without nodes.
    pub node: u32,
    /// Index of its mesh in the file; 0 without meshes.
    pub mesh: u32,
    /// Index inside that mesh.
    pub primitive: u32,
    /// Name of the node, else of the mesh, else empty.
    pub name: String,
    /// Its first render vertex.
    pub first_vertex: u32,
    /// Number of its render vertices.
    pub vertex_count: u32,
    /// Number of its triangle-corner indices after conversion to triangles (three per triangle).
    pub index_count: u32,
    /// Whether the model gives normals for it.
    pub has_normals: bool,
    /// Whether the model gives tangents for it.
    pub has_tangents: bool,
    /// Whether it is not solved, but follows the solved surface. Points and lines always do.
    pub is_passenger: bool,
}

impl Primitive {
    /// Its render vertices.
    pub fn vertices(&self) -> Range<usize> {
        let first = self.first_vertex as usize;
        first..first.saturating_add(self.vertex_count as usize)
    }
}

/// Render vertices, triangles and primitives of a model, whatever format they came in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Geometry {
    /// Render vertices in model (world) space, in the order of `primitives`.
    pub positions: Vec<DVec3>,
    /// Authored unit normals in model space, one per render vertex (zero where a primitive has none); empty when no
    /// primitive has any.
    pub normals: Vec<Vec3>,
    /// Authored tangents (xyz unit, w handedness) in model space; as `normals`.
    pub tangents: Vec<Vec4>,
    /// Triangles over render vertices, in file order; polygons, strips and fans are converted.
    pub triangles: Vec<[u32; 3]>,
    /// The runs of render vertices.
    pub primitives: Vec<Primitive>,
    /// Places where the reader had to choose: (code, message, where). None is fatal.
    pub warnings: Vec<(String, String, String)>,
}

impl Geometry {
    /// The geometry of a format that knows one mesh only: a single primitive with all vertices. `normals` is empty or
    /// has one per position.
    pub(super) fn from_one_mesh(positions: Vec<DVec3>, normals: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Self {
        let primitive = Primitive {
            vertex_count: positions.len() as u32,
            index_count: (triangles.len() * 3) as u32,
            has_normals: !normals.is_empty(),
            ..Primitive::default()
        };
        Self {
            positions,
            normals,
            triangles,
            primitives: vec![primitive],
            ..Self::default()
        }
    }

    pub(super) fn warn(&mut self, code: &str, message: impl Into<String>, place: impl Into<String>) {
        self.warnings.push((code.into(), message.into(), place.into()));
    }

    /// Warns of concave polygons that were cut into a plain fan.
    pub(super) fn warn_about_crude_polygons(&mut self, count: usize) {
        if count > 0 {
            self.warn(
                "polygon-too-large",
                format!("{count} polygons are too large to cut into triangles well"),
                "",
            );
        }
    }

    /// What every reader promises, checked once for all of them.
    pub(super) fn check(&self, format: Format, limits: &Limits) -> Result<(), Error> {
        let count = self.positions.len();
        limits.check_vertices(count as u64)?;
        limits.check_triangles(self.triangles.len() as u64)?;
        let malformed = |place, problem| Err(Error::Malformed { format, place, problem });
        if let Some(i) = self.positions.iter().position(|p| !p.is_finite()) {
            let problem = format!("the position is {}; finite coordinates are needed", self.positions[i]);
            return malformed(format!("vertex {i}"), problem);
        }
        if let Some(i) = self
            .triangles
            .iter()
            .position(|t| t.iter().any(|&v| v as usize >= count))
        {
            let problem = format!("vertices {:?} are named, there are {count}", self.triangles[i]);
            return malformed(format!("triangle {i}"), problem);
        }
        Ok(())
    }

    /// Refuses what has no triangle, and so nothing that could be deformed.
    pub(super) fn require_triangles(&self, format: Format) -> Result<(), Error> {
        if !self.triangles.is_empty() {
            return Ok(());
        }
        let problem = format!("{} vertices and no triangle", self.positions.len());
        Err(Error::NoMesh { format, problem })
    }

    /// The same geometry at new positions, one for each vertex; normals and tangents turn with the shape, as in a file that is written.
    ///
    /// # Panics
    /// When there are more positions than vertices, or fewer.
    pub fn deformed(&self, positions: &[DVec3]) -> Self {
        let mut moved = self.clone();
        moved.positions.copy_from_slice(positions);
        if !self.normals.is_empty() {
            let triangles = &self.triangles;
            let all = 0..positions.len();
            let gradients = shading::gradients_of_all(&self.positions, positions, triangles, all);
            for (i, gradient) in gradients.iter().enumerate() {
                let Some(gradient) = gradient else { continue };
                moved.normals[i] = shading::carry_normal(gradient, self.normals[i]);
                if let Some(tangent) = moved.tangents.get_mut(i) {
                    *tangent = shading::carry_tangent(gradient, *tangent, moved.normals[i]);
                }
            }
        }
        moved
    }

    /// About how many bytes it holds in memory.
    pub fn bytes_held(&self) -> u64 {
        let arrays = size_of_val(self.positions.as_slice())
            + size_of_val(self.normals.as_slice())
            + size_of_val(self.tangents.as_slice())
            + size_of_val(self.triangles.as_slice())
            + size_of_val(self.primitives.as_slice());
        arrays as u64
    }

    /// The runs of triangles that belong to each primitive, in order.
    pub fn triangles_of_primitives(&self) -> impl Iterator<Item = (&Primitive, &[[u32; 3]])> {
        let mut rest = self.triangles.as_slice();
        self.primitives.iter().map(move |primitive| {
            let (run, after) = rest.split_at((primitive.index_count as usize / 3).min(rest.len()));
            rest = after;
            (primitive, run)
        })
    }

    /// Whether every render vertex that a triangle uses has a normal, so that a format with one flag for all can hold them.
    pub(super) fn all_have_normals(&self) -> bool {
        self.normals.len() == self.positions.len()
            && self.primitives.iter().all(|p| p.has_normals || p.vertex_count == 0)
    }
}

/// A normal of unit length; zero for one that is zero or not finite, which stands for none.
pub(super) fn unit_or_zero(normal: DVec3) -> Vec3 {
    let size = normal.abs().max_element();
    let scaled = if size > 0.0 && size.is_finite() {
        normal / size
    } else {
        return Vec3::ZERO;
    };
    scaled.try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3())
}

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
    /// use pliant_asset::VertexCache;
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
    /// use pliant_asset::VertexCache;
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
/// Places in a list by the vertex that each names, in order.
#[derive(Debug)]
pub(super) struct PlacesByVertex {
    /// For each vertex where its places begin; one more than there are vertices.
    starts: Vec<u32>,
    places: Vec<u32>,
}

impl PlacesByVertex {
    /// The places of a list that names so many vertices.
    pub(super) fn of(vertices: usize, named: &[u32]) -> Self {
        let mut starts = vec![0u32; vertices + 1];
        for &vertex in named {
            starts[vertex as usize + 1] += 1;
        }
        for i in 0..vertices {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut places = vec![0; named.len()];
        for (&vertex, place) in named.iter().zip(0..) {
            let at = &mut next[vertex as usize];
            places[*at as usize] = place;
            *at += 1;
        }
        Self { starts, places }
    }

    /// The places of a vertex; none of one that does not exist.
    pub(super) fn at(&self, vertex: u32) -> &[u32] {
        match self.starts.get(vertex as usize..vertex as usize + 2) {
            Some(&[from, to]) => &self.places[from as usize..to as usize],
            _ => &[],
        }
    }
}
