//! PLY in: positions, normals and faces; whatever else there is is stepped over.

use super::super::polygons::Polygons;
use super::body::{PlyBody, PlyElement, PlyEncoding, PlyHeader};
use crate::asset::edited::FaceOutlines;
use crate::asset::files::{ReadWatch, check_main_size};
use crate::asset::format::{FormatDetails, Recognition};
use crate::asset::geometry::unit_or_zero;
use crate::asset::model::FileNotes;
use crate::asset::{Error, Format, Geometry};
use glam::{DVec3, Vec3};

/// The format, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "ply",
    media_types: &["model/ply"],
    recognise: |bytes| Recognition::mark(bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r")),
});

/// What the writers have to remember of a file.
#[derive(Debug)]
pub(super) struct PlyNotes {
    pub encoding: PlyEncoding,
    /// The element of the vertices.
    pub vertex: PlyElement,
    /// Offset and line of the first vertex.
    pub vertices_at: (usize, u32),
    /// The properties that hold x, y and z.
    pub position: [usize; 3],
    /// The properties that hold a normal.
    pub normal: Option<[usize; 3]>,
    /// Faces of more than three corners.
    pub outlines: FaceOutlines,
}

impl FileNotes for PlyNotes {
    fn bytes_held(&self) -> u64 {
        self.outlines.bytes_held()
    }
}

/// Reads a PLY file.
pub(super) fn read(bytes: &[u8], watch: &ReadWatch<'_>) -> Result<(Geometry, PlyNotes), Error> {
    check_main_size(bytes)?;
    let header = PlyHeader::read(bytes)?;
    let vertex = single_element(&header, "vertex")?.clone();
    watch.check_vertices(vertex.rows)?;
    let position = ["x", "y", "z"].map(|name| vertex.scalar_property(name));
    let [Some(x), Some(y), Some(z)] = position else {
        return Err(Error::malformed(
            FORMAT,
            "header",
            "element `vertex` needs the numbers x, y and z",
        ));
    };
    let is_real = |p: &usize| !vertex.properties[*p].scalar.is_integer();
    let normal = ["nx", "ny", "nz"].map(|name| vertex.scalar_property(name).filter(is_real));
    let normal = if let [Some(x), Some(y), Some(z)] = normal {
        Some([x, y, z])
    } else {
        None
    };
    let mut body = PlyBody::starting_at(bytes, header.encoding, header.body);
    let mut notes = PlyNotes {
        encoding: header.encoding,
        vertices_at: body.next_place(),
        vertex,
        position: [x, y, z],
        normal,
        outlines: FaceOutlines::default(),
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
                notes.vertices_at = body.next_place();
                (positions, normals) = read_vertices(&mut body, &notes)?;
            }
            "face" | "tristrips" => read_faces(&mut body, element, notes.vertex.rows, &mut faces, watch)?,
            _ => body.skip_rows(element)?,
        }
    }
    let (geometry, outlines) = faces.into_geometry(positions, normals, watch)?;
    notes.outlines = outlines;
    Ok((geometry, notes))
}

fn single_element<'a>(header: &'a PlyHeader, name: &str) -> Result<&'a PlyElement, Error> {
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
                FORMAT,
                "header",
                format!("{seen} `{name}`; exactly one is needed"),
            ))
        }
    }
}

fn read_vertices(body: &mut PlyBody<'_>, notes: &PlyNotes) -> Result<(Vec<DVec3>, Vec<Vec3>), Error> {
    let rows = notes.vertex.rows as usize;
    let mut positions = Vec::with_capacity(rows);
    let mut normals = Vec::with_capacity(if notes.normal.is_some() { rows } else { 0 });
    for row in 0..rows {
        let (mut position, mut normal) = (DVec3::ZERO, DVec3::ZERO);
        for (i, property) in notes.vertex.properties.iter().enumerate() {
            match notes.role(i) {
                Some(VertexRole::Position(axis)) => {
                    position[axis] = body.read_number(property.scalar)?;
                    if !position[axis].is_finite() {
                        let seen = position[axis];
                        let problem = format!("coordinate {} of vertex {row} is {seen}, not finite", property.name);
                        return Err(body.malformed(problem));
                    }
                }
                Some(VertexRole::Normal(axis)) => normal[axis] = body.read_normal(property.scalar)?,
                None => body.skip_property(property)?,
            }
        }
        positions.push(position);
        if notes.normal.is_some() {
            normals.push(unit_or_zero(normal));
        }
    }
    Ok((positions, normals))
}

fn read_faces(
    body: &mut PlyBody<'_>,
    element: &PlyElement,
    vertex_count: u64,
    faces: &mut Polygons,
    watch: &ReadWatch<'_>,
) -> Result<(), Error> {
    let Some(list) = index_list(element) else {
        return body.skip_rows(element);
    };
    let strips = element.name == "tristrips";
    for row in 0..element.rows {
        watch.check_at(row as usize)?;
        for (i, property) in element.properties.iter().enumerate() {
            let Some(count) = property.count.filter(|_| i == list) else {
                body.skip_property(property)?;
                continue;
            };
            let mut strip = TriangleStrip::default();
            let items = body.list_count(count, property.scalar)?;
            if !strips {
                watch.check_triangles(faces.triangle_count() + items.saturating_sub(2))?;
            }
            for _ in 0..items {
                let index = body.read_number(property.scalar)?;
                if strips && index == -1.0 {
                    strip = TriangleStrip::default();
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
                    watch.check_triangles(faces.triangle_count())?;
                }
            }
            faces.end_face();
        }
    }
    Ok(())
}

/// The property of faces or strips that lists their vertices.
pub(super) fn index_list(element: &PlyElement) -> Option<usize> {
    let mut properties = element.properties.iter();
    let list = properties.position(|p| is_indices(&p.name) && p.count.is_some());
    list.filter(|&i| element.properties[i].scalar.is_integer())
}

/// Whether a list property names the vertices of a face.
pub(super) fn is_indices(name: &str) -> bool {
    name == "vertex_indices" || name == "vertex_index"
}

/// The last two vertices of a triangle strip; every other triangle is turned over.
#[derive(Default)]
pub(super) struct TriangleStrip {
    last: [Option<u32>; 2],
    odd: bool,
}

impl TriangleStrip {
    /// The triangle that a vertex completes; none at the strip's start and where it repeats a vertex to turn a corner.
    pub fn next(&mut self, c: u32) -> Option<[u32; 3]> {
        let [a, b] = self.last;
        self.last = [b, Some(c)];
        let (a, b) = (a?, b?);
        self.odd = !self.odd;
        let triangle = if self.odd { [a, b, c] } else { [b, a, c] };
        (a != b && b != c && c != a).then_some(triangle)
    }
}

/// What a property of a vertex holds that a deformation changes, and along which axis.
pub(super) enum VertexRole {
    Position(usize),
    Normal(usize),
}

impl PlyNotes {
    /// What a property holds; `None` for one that a deformation leaves alone.
    pub fn role(&self, property: usize) -> Option<VertexRole> {
        let axis_in = |places: &[usize; 3]| places.iter().position(|&p| p == property);
        axis_in(&self.position)
            .map(VertexRole::Position)
            .or_else(|| self.normal.as_ref().and_then(axis_in).map(VertexRole::Normal))
    }
}
