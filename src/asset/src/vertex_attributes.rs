//! What a file gives to render vertices beside positions, to find those at one place that are alike.
//!
//! Many files repeat a vertex for every triangle around it. Such copies are one vertex to an edit, unless an attribute
//! differs: there the file has a seam. Values are compared by hashes of 64 bits; equal hashes of different values are
//! practically impossible.

use super::{Error, Geometry};
use glam::{DVec3, Vec3};
use pliant_exec::progress::{Progress, check};
use pliant_mesh::mix_bits;

/// Numbers that are read of one file for a comparison. Morph targets may be sparse or share their numbers, so that their
/// number is not bounded by the file's size.
const MOST_NUMBERS: u64 = 1 << 28;

/// What a hash begins with.
const FIRST: u64 = 0x9e37_79b9_7f4a_7c15;

/// A facet normal is within the angle with this cosine (about 1°) of its triangle's own: normals in bytes are no better.
const FACET: f64 = 0.999_84;

/// The attributes of all vertices of a model but their positions, as far as they are needed to compare them.
#[derive(Debug, Clone, Default)]
pub struct VertexAttributes {
    /// A hash for each vertex of all but its normal; empty where all vertices have the same.
    keys: Vec<u64>,
    /// Whether the vertex only has the normal of the triangles around it; empty where none has.
    facets: Vec<bool>,
    /// No two vertices are alike: what the file gives them cannot be read.
    differ: bool,
}

impl VertexAttributes {
    /// What stands for the attributes of a vertex but its normal: equal where they are.
    pub fn key(&self, vertex: u32) -> u64 {
        match self.differ {
            true => mix_bits(1, u64::from(vertex)),
            false => self.keys.get(vertex as usize).copied().unwrap_or(0),
        }
    }

    /// Whether the normal of a vertex is that of every triangle around it and says no more than they do.
    pub fn has_facet_normal(&self, vertex: u32) -> bool {
        self.facets.get(vertex as usize).copied().unwrap_or(false)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> u64 {
        (8 * self.keys.capacity() + self.facets.capacity()) as u64
    }

    /// Takes them from `distinguish_vertices`; where that fails, no two vertices are alike.
    pub(super) fn gather(
        geometry: &Geometry,
        distinguish_vertices: impl FnOnce(&mut AttributeKeys<'_>) -> Result<(), Error>,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let mut keys = AttributeKeys::new(geometry.positions.len(), progress);
        let differ = match distinguish_vertices(&mut keys) {
            Ok(()) => false,
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            Err(_) => true,
        };
        keys.add_tangents(geometry);
        check(progress).map_err(|_| Error::Cancelled)?;
        Ok(Self {
            keys: if differ { Vec::new() } else { keys.finish() },
            facets: find_facets(geometry),
            differ,
        })
    }
}

/// A normal to be compared: those that differ by rounding only are the same.
pub fn normal_key(normal: Vec3) -> u64 {
    rounded(normal.to_array())
}

/// Stands for some bytes.
pub(super) fn hash_bytes(bytes: &[u8]) -> u64 {
    bytes.iter().fold(FIRST, |hash, &byte| mix_bits(hash, u64::from(byte)))
}

/// Stands for some numbers; 0 and -0 are the same.
pub(super) fn hash_numbers(numbers: &[f64]) -> u64 {
    numbers
        .iter()
        .fold(FIRST, |hash, v| mix_bits(hash, (v + 0.0).to_bits()))
}

fn rounded<const N: usize>(values: [f32; N]) -> u64 {
    const STEPS: f32 = 1024.0;
    let whole = values.map(|v| (v * STEPS).round() as i32);
    whole.iter().fold(FIRST, |key, &v| mix_bits(key, u64::from(v as u32)))
}

/// Takes the attributes of vertices, one after the other.
pub(super) struct AttributeKeys<'a> {
    progress: &'a dyn Progress,
    keys: Vec<u64>,
    /// What the faces around each vertex give to it, 0 where none has; empty until a face gives something.
    of_corners: Vec<u64>,
    left: u64,
}

impl<'a> AttributeKeys<'a> {
    fn new(vertices: usize, progress: &'a dyn Progress) -> Self {
        Self {
            progress,
            keys: vec![FIRST; vertices],
            of_corners: Vec::new(),
            left: MOST_NUMBERS,
        }
    }

    /// Notes numbers that are about to be read.
    ///
    /// # Errors
    /// [`Error::TooLarge`] when one file has too many of them, [`Error::Cancelled`].
    pub fn spend(&mut self, numbers: u64) -> Result<(), Error> {
        check(self.progress).map_err(|_| Error::Cancelled)?;
        let too_many = Error::TooLarge {
            what: "number of vertex attributes to compare",
            seen: numbers,
            limit: self.left,
        };
        self.left = self.left.checked_sub(numbers).ok_or(too_many)?;
        Ok(())
    }

    /// Adds the next attribute of all vertices from `first` on: `lanes` numbers for each.
    pub fn add_values(&mut self, first: usize, lanes: usize, values: &[f32]) {
        for (i, values) in values.chunks_exact(lanes.max(1)).enumerate() {
            values
                .iter()
                .for_each(|v| self.add(first + i, u64::from((v + 0.0).to_bits())));
        }
    }

    /// Adds one more attribute of a vertex.
    pub fn add(&mut self, vertex: usize, bits: u64) {
        if let Some(key) = self.keys.get_mut(vertex) {
            *key = mix_bits(*key, bits);
        }
    }

    /// Adds what a face gives to a corner of it. A vertex to which two faces give different things is like no other.
    pub fn add_of_corner(&mut self, vertex: u32, bits: u64) {
        self.of_corners.resize(self.keys.len(), 0);
        let Some(known) = self.of_corners.get_mut(vertex as usize) else {
            return;
        };
        let bits = bits | 1;
        *known = match *known {
            0 => bits,
            same if same == bits => bits,
            // Even, so that no face gives the same.
            _ => mix_bits(2, u64::from(vertex)) & !1 | 2,
        };
    }

    fn add_tangents(&mut self, geometry: &Geometry) {
        let with_tangents = geometry.primitives.iter().filter(|p| p.has_tangents);
        for v in with_tangents.flat_map(|p| p.vertices()) {
            if let Some(tangent) = geometry.tangents.get(v) {
                self.add(v, rounded(tangent.to_array()));
            }
        }
    }

    fn finish(mut self) -> Vec<u64> {
        for v in 0..self.of_corners.len() {
            self.add(v, self.of_corners[v]);
        }
        if self.keys.windows(2).all(|pair| pair[0] == pair[1]) {
            self.keys = Vec::new();
        }
        self.keys
    }
}

/// Which vertices only have the normal of the triangles around them; empty when none has.
fn find_facets(geometry: &Geometry) -> Vec<bool> {
    if !geometry.primitives.iter().any(|p| p.has_normals) {
        return Vec::new();
    }
    let mut facets = vec![false; geometry.positions.len()];
    for (primitive, triangles) in geometry.triangles_of_primitives().filter(|(p, _)| p.has_normals) {
        facets[primitive.vertices()].fill(true);
        for t in triangles {
            let normal = facet_normal(t.map(|v| geometry.positions[v as usize]));
            for &v in t {
                facets[v as usize] &= agrees_with_facet(normal, geometry.normals[v as usize]);
            }
        }
    }
    if facets.contains(&true) { facets } else { Vec::new() }
}

/// The unit normal of a triangle; `None` where rounding decides it.
pub fn facet_normal([a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    const FLAT: f64 = 1e-6;
    let normal = (b - a).cross(c - a);
    let longest = (b - a)
        .length_squared()
        .max((c - b).length_squared())
        .max((a - c).length_squared());
    normal.try_normalize().filter(|_| normal.length() > FLAT * longest)
}

/// Whether a vertex normal says no more than the normal of a triangle.
pub fn agrees_with_facet(facet: Option<DVec3>, normal: Vec3) -> bool {
    facet.is_none_or(|facet| normal == Vec3::ZERO || facet.dot(normal.as_dvec3()) >= FACET)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FileSet, Limits, Model};
    use pliant_exec::progress::Silent;

    fn attributes(name: &str, text: &str) -> (Model, VertexAttributes) {
        let files = FileSet::single(name, text.as_bytes().to_vec());
        let model = Model::read(files, None, &Limits::default()).expect("a model");
        let read = model.vertex_attributes(&Silent).expect("readable").clone();
        (model, read)
    }

    #[test]
    fn equal_values_have_equal_keys_however_they_are_numbered() {
        let (_, plain) = attributes(
            "a.off",
            "OFF\n6 2 0\n0 0 0\n1 0 0\n0 1 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 3 4 5\n",
        );
        assert_eq!((plain.key(1), plain.byte_size()), (plain.key(3), 0));
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1.0 0\nvt 1 1\nvt .5 1\n\
            f 1/1 2/2 3/3\nf 4/4 5/5 6/6\n";
        let (_, mapped) = attributes("a.obj", text);
        assert_eq!(mapped.key(1), mapped.key(3), "1 and 1.0 are one coordinate");
        assert_ne!(mapped.key(2), mapped.key(5), "a seam of the texture");
        let material = text.replace("f 4", "usemtl other\nf 4");
        let (_, parted) = attributes("a.obj", &material);
        assert_ne!(parted.key(1), parted.key(3), "another material");
    }

    #[test]
    fn a_vertex_that_two_faces_give_different_things_is_like_no_other() {
        let (_, read) = attributes(
            "a.off",
            "OFF\n7 3 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n1 0 0\n0 1 0\n2 2 0\n3 0 1 2 255 0 0\n3 1 3 2 0 255 0\n3 4 6 5 255 0 0\n",
        );
        assert_ne!(read.key(1), read.key(4));
        assert_ne!(read.key(1), read.key(2));
        assert_eq!(read.key(0), read.key(4));
    }

    #[test]
    fn facet_normals_are_those_that_the_triangles_have_anyway() {
        let text =
            |last: &str| format!("NOFF\n4 2 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n1 1 {last}\n3 0 1 2\n3 1 3 2\n");
        let (_, flat) = attributes("a.off", &text("0 0 0 1"));
        assert!((0..4).all(|v| flat.has_facet_normal(v)));
        let (_, bent) = attributes("a.off", &text("1 0 0 1"));
        assert_eq!(
            [0, 1, 2, 3].map(|v| bent.has_facet_normal(v)),
            [true, false, false, false]
        );
    }
}
