//! Stanford PLY, text and binary: reading, editing in place, and building.
//!
//! Needed of a file are the numbers x, y and z of element `vertex`, and `vertex_indices` (or `vertex_index`) of element
//! `face` or `tristrips`. Whatever else it holds is stepped over and survives.

mod body;
mod header;
mod remade;
mod table;
#[cfg(test)]
mod tests;

pub(super) use remade::{extras, write_remade};

use super::files::check_main_size;
use super::geometry::unit_or_zero;
use super::plain::Plain;
use super::polygons::Polygons;
use super::text::Patch;
use super::{Error, Format, Geometry, Limits};
use crate::mesh::shading;
use body::{Body, push};
use glam::{DVec3, Vec3};
use header::{Element, Encoding, Header, Scalar};
use std::io::Write as _;

/// What the writer must know beyond the file and the geometry.
#[derive(Debug, Clone)]
pub struct Source {
    encoding: Encoding,
    vertex: Element,
    /// Offset and line of the first vertex.
    vertices_at: (usize, u32),
    position: [usize; 3],
    normal: Option<[usize; 3]>,
}

/// Reads a PLY file.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<(Geometry, Source), Error> {
    check_main_size(bytes)?;
    let header = Header::read(bytes)?;
    let vertex = single_element(&header, "vertex")?.clone();
    limits.check_vertices(vertex.rows)?;
    let position = ["x", "y", "z"].map(|name| vertex.scalar(name));
    let [Some(x), Some(y), Some(z)] = position else {
        return Err(Error::malformed(
            Format::Ply,
            "header",
            "element `vertex` needs the numbers x, y and z",
        ));
    };
    let is_real = |p: &usize| !vertex.properties[*p].scalar.is_integer();
    let normal = ["nx", "ny", "nz"].map(|name| vertex.scalar(name).filter(is_real));
    let normal = if let [Some(x), Some(y), Some(z)] = normal {
        Some([x, y, z])
    } else {
        None
    };
    let mut body = Body::starting_at(bytes, header.encoding, header.body);
    let mut source = Source {
        encoding: header.encoding,
        vertices_at: body.at(),
        vertex,
        position: [x, y, z],
        normal,
    };
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    let mut faces = Polygons::default();
    for element in &header.elements {
        let (least, left) = (element.least_bytes(header.encoding), body.bytes_left());
        if least > left {
            let (name, rows) = (&element.name, element.rows);
            return Err(body.malformed(format!(
                "{rows} rows of `{name}` take {least} bytes at least, {left} are left"
            )));
        }
        match element.name.as_str() {
            "vertex" => {
                source.vertices_at = body.at();
                (positions, normals) = read_vertices(&mut body, &source)?;
            }
            "face" | "tristrips" => read_faces(&mut body, element, source.vertex.rows, &mut faces, limits)?,
            _ => body.skip_rows(element)?,
        }
    }
    let (slots, crude) = faces.triangulate(&positions);
    let triangles = slots.iter().map(|t| t.map(|s| faces.corners[s as usize])).collect();
    let mut geometry = Geometry::of_one_mesh(positions, normals, triangles);
    geometry.warn_of_crude_polygons(crude);
    Ok((geometry, source))
}

fn single_element<'a>(header: &'a Header, name: &str) -> Result<&'a Element, Error> {
    let mut found = header.elements.iter().filter(|e| e.name == name);
    match (found.next(), found.next()) {
        (Some(element), None) => Ok(element),
        (first, _) => {
            let seen = if first.is_some() {
                "several elements"
            } else {
                "no element"
            };
            Err(Error::malformed(
                Format::Ply,
                "header",
                format!("{seen} `{name}`; exactly one is needed"),
            ))
        }
    }
}

fn read_vertices(body: &mut Body<'_>, source: &Source) -> Result<(Vec<DVec3>, Vec<Vec3>), Error> {
    let rows = source.vertex.rows as usize;
    let mut positions = Vec::with_capacity(rows);
    let mut normals = Vec::with_capacity(if source.normal.is_some() { rows } else { 0 });
    for row in 0..rows {
        let (mut position, mut normal) = (DVec3::ZERO, DVec3::ZERO);
        for (i, property) in source.vertex.properties.iter().enumerate() {
            match source.role(i) {
                Some(Role::Position(axis)) => {
                    position[axis] = body.number(property.scalar)?;
                    if !position[axis].is_finite() {
                        let seen = position[axis];
                        let problem = format!("coordinate {} of vertex {row} is {seen}, not finite", property.name);
                        return Err(body.malformed(problem));
                    }
                }
                Some(Role::Normal(axis)) => normal[axis] = body.normal(property.scalar)?,
                None => body.skip_property(property)?,
            }
        }
        positions.push(position);
        if source.normal.is_some() {
            normals.push(unit_or_zero(normal));
        }
    }
    Ok((positions, normals))
}

fn read_faces(
    body: &mut Body<'_>,
    element: &Element,
    vertex_count: u64,
    faces: &mut Polygons,
    limits: &Limits,
) -> Result<(), Error> {
    let list = element
        .properties
        .iter()
        .position(|p| is_indices(&p.name) && p.count.is_some());
    let Some(list) = list.filter(|&i| element.properties[i].scalar.is_integer()) else {
        return body.skip_rows(element);
    };
    let strips = element.name == "tristrips";
    for row in 0..element.rows {
        for (i, property) in element.properties.iter().enumerate() {
            let Some(count) = property.count.filter(|_| i == list) else {
                body.skip_property(property)?;
                continue;
            };
            let mut strip = Strip::default();
            let items = body.list_count(count, property.scalar)?;
            if !strips {
                limits.check_triangles(faces.triangle_count() + items.saturating_sub(2))?;
            }
            for _ in 0..items {
                let index = body.number(property.scalar)?;
                if strips && index == -1.0 {
                    strip = Strip::default();
                } else if index < 0.0 || index >= vertex_count as f64 {
                    let what = if strips { "strip" } else { "face" };
                    let problem =
                        format!("{what} {row} names vertex {index}; there are {vertex_count}, counted from 0");
                    return Err(body.malformed(problem));
                } else if !strips {
                    faces.corners.push(index as u32);
                } else if let Some(triangle) = strip.next(index as u32) {
                    faces.corners.extend(triangle);
                    faces.end_face();
                    limits.check_triangles(faces.triangle_count())?;
                }
            }
            faces.end_face();
        }
    }
    Ok(())
}

/// Whether a list property names the vertices of a face.
fn is_indices(name: &str) -> bool {
    name == "vertex_indices" || name == "vertex_index"
}

/// The last two vertices of a triangle strip; every other triangle is turned over.
#[derive(Default)]
struct Strip {
    last: [Option<u32>; 2],
    odd: bool,
}

impl Strip {
    /// The triangle that a vertex completes; none at the strip's start and where it repeats a vertex to turn a corner.
    fn next(&mut self, c: u32) -> Option<[u32; 3]> {
        let [a, b] = self.last;
        self.last = [b, Some(c)];
        let (a, b) = (a?, b?);
        self.odd = !self.odd;
        let triangle = if self.odd { [a, b, c] } else { [b, a, c] };
        (a != b && b != c && c != a).then_some(triangle)
    }
}

enum Role {
    Position(usize),
    Normal(usize),
}

impl Source {
    fn role(&self, property: usize) -> Option<Role> {
        let axis_in = |places: &[usize; 3]| places.iter().position(|&p| p == property);
        axis_in(&self.position)
            .map(Role::Position)
            .or_else(|| self.normal.as_ref().and_then(axis_in).map(Role::Normal))
    }
}

/// The uploaded file with the vertices at `positions`. Whole-number coordinates become doubles where they must.
pub(super) fn write(bytes: &[u8], source: &Source, rest: &Geometry, positions: &[DVec3]) -> Result<Vec<u8>, Error> {
    let properties = &source.vertex.properties;
    let mut stored: Vec<Scalar> = properties.iter().map(|p| p.scalar).collect();
    for (axis, &property) in source.position.iter().enumerate() {
        let scalar = &mut stored[property];
        if scalar.is_integer() && !positions.iter().all(|p| scalar.holds(p[axis])) {
            *scalar = Scalar::F64;
        } else if *scalar == Scalar::F32
            && let Some(i) = positions.iter().position(|p| !(p[axis] as f32).is_finite())
        {
            let problem = format!(
                "the position of vertex {i} is {}, too large for the file's floats",
                positions[i]
            );
            return Err(Error::unwritable(Format::Ply, problem));
        }
    }
    let triangles = &rest.triangles;
    let gradients = source
        .normal
        .map(|_| shading::gradients(&rest.positions, positions, triangles, triangles, positions.len()));
    let mut patch = Patch::new(bytes);
    for (property, &scalar) in properties.iter().zip(&stored) {
        if property.scalar != scalar {
            patch.replace(property.type_place.clone()).extend_from_slice(b"double");
        }
    }
    let mut body = Body::starting_at(bytes, source.encoding, source.vertices_at);
    for (i, (&old, &new)) in rest.positions.iter().zip(positions).enumerate() {
        let gradient = gradients.as_ref().and_then(|g| g[i].as_ref());
        let normal = gradient.map(|g| shading::carry_normal(g, rest.normals[i]));
        for (j, (property, &scalar)) in properties.iter().zip(&stored).enumerate() {
            let (old, new) = match (source.role(j), normal) {
                (Some(Role::Position(axis)), _) => (old[axis], new[axis]),
                (Some(Role::Normal(axis)), Some(normal)) => (f64::from(rest.normals[i][axis]), f64::from(normal[axis])),
                _ => {
                    body.skip_property(property)?;
                    continue;
                }
            };
            let place = body.place(property.scalar)?;
            let same = match scalar {
                Scalar::F32 => (old as f32).to_bits() == (new as f32).to_bits(),
                _ => old.to_bits() == new.to_bits(),
            };
            let retyped = property.scalar != scalar && source.encoding != Encoding::Ascii;
            if !same || retyped {
                push(patch.replace(place), new, scalar, source.encoding);
            }
        }
    }
    Ok(patch.finish())
}

/// A fresh binary file with double coordinates, normals where every vertex has one, and colours and texture coordinates
/// where any has some.
pub(super) fn build(plain: &Plain) -> Vec<u8> {
    let Plain {
        geometry, uv, colours, ..
    } = plain;
    let with_normals = geometry.all_have_normals();
    let mut out = b"ply\nformat binary_little_endian 1.0\ncomment pliant\n".to_vec();
    let floats = |names: &[&str]| {
        names
            .iter()
            .map(|n| format!("property float {n}\n"))
            .collect::<String>()
    };
    let normals = if with_normals {
        floats(&["nx", "ny", "nz"])
    } else {
        String::new()
    };
    let coordinates = if uv.is_empty() {
        String::new()
    } else {
        floats(&["s", "t"])
    };
    let bytes = if colours.is_empty() {
        ""
    } else {
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n"
    };
    let result = write!(
        out,
        "element vertex {}\nproperty double x\nproperty double y\nproperty double z\n{normals}{coordinates}{bytes}\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        geometry.positions.len(),
        geometry.triangles.len()
    );
    debug_assert!(result.is_ok(), "writing to memory does not fail");
    for (i, position) in geometry.positions.iter().enumerate() {
        out.extend(position.to_array().into_iter().flat_map(f64::to_le_bytes));
        if with_normals {
            out.extend(geometry.normals[i].to_array().into_iter().flat_map(f32::to_le_bytes));
        }
        if let Some([u, v]) = uv.get(i) {
            out.extend([*u, 1.0 - v].into_iter().flat_map(f32::to_le_bytes));
        }
        if let Some(colour) = colours.get(i) {
            out.extend(colour.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8));
        }
    }
    for triangle in &geometry.triangles {
        out.push(3);
        out.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
    }
    out
}
