//! The numbers of the GLB in the making: what comes from a file is checked before it goes in.

use super::super::gltf::{ElementShape, GlbWriter};
use super::fault::refuse;
use crate::asset::Error;
use crate::asset::files::ReadWatch;
use serde_json::Value;

/// How often the numbers of an accessor are in memory at most: as they are, as bytes, and in the buffer as it grows.
const COPIES: u64 = 3;

/// One buffer that grows; it refuses what is not finite, and reserves what it is about to hold.
pub(super) struct GlbBuffer<'a> {
    writer: GlbWriter,
    watch: ReadWatch<'a>,
}

impl<'a> GlbBuffer<'a> {
    /// An empty buffer.
    pub(super) fn new(watch: &ReadWatch<'a>) -> Self {
        Self {
            writer: GlbWriter::default(),
            watch: watch.clone(),
        }
    }

    /// The file of a document over the buffer.
    pub(super) fn finish(self, document: Value) -> Result<Vec<u8>, Error> {
        self.writer.finish(document)
    }

    fn make_room(&self, bytes: usize) -> Result<(), Error> {
        self.watch.reserve(COPIES * bytes as u64)
    }

    /// Adds bytes as a view of their own; returns its number.
    pub(super) fn add_view(&mut self, bytes: &[u8]) -> Result<usize, Error> {
        self.make_room(bytes.len())?;
        Ok(self.writer.add_view(bytes))
    }

    /// Adds elements of N numbers each; every one has to be finite, `place` says whose they are.
    pub(super) fn add_floats<const N: usize>(&mut self, values: &[[f32; N]], place: &str) -> Result<usize, Error> {
        self.check(values, place)?;
        Ok(self.writer.add_floats(values.as_flattened(), shape_of(N)))
    }

    /// As [`GlbBuffer::add_floats`], with the bounds that positions and times must have.
    pub(super) fn add_bounded<const N: usize>(&mut self, values: &[[f32; N]], place: &str) -> Result<usize, Error> {
        self.check(values, place)?;
        Ok(self.writer.add_bounded(values.as_flattened(), shape_of(N)))
    }

    fn check<const N: usize>(&self, values: &[[f32; N]], place: &str) -> Result<(), Error> {
        self.make_room(size_of_val(values))?;
        match values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
            Some(i) => Err(refuse(
                place,
                format!("value {i} is {:?}, not finite in 32 bits", values[i]),
            )),
            None => Ok(()),
        }
    }

    /// Adds displacements of `count` vertices of which those of `places` (ascending) are not zero.
    pub(super) fn add_displacements(
        &mut self,
        count: usize,
        (places, values): (&[u32], &[[f32; 3]]),
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
        Ok(self.writer.add_sparse(count, places, values))
    }

    /// Adds the joints of vertices, four each.
    pub(super) fn add_joints(&mut self, joints: &[[u16; 4]]) -> Result<usize, Error> {
        self.make_room(size_of_val(joints))?;
        Ok(self.writer.add_joints(joints))
    }

    /// Adds the corners of triangles.
    pub(super) fn add_triangles(&mut self, triangles: &[[u32; 3]]) -> Result<usize, Error> {
        self.make_room(size_of_val(triangles))?;
        Ok(self.writer.add_triangles(triangles))
    }
}

fn shape_of(lanes: usize) -> ElementShape {
    match lanes {
        1 => ElementShape::Scalar,
        2 => ElementShape::Vec2,
        3 => ElementShape::Vec3,
        4 => ElementShape::Vec4,
        _ => ElementShape::Mat4,
    }
}
