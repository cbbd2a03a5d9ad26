//! PLY in: positions, normals and faces; and on request all other numbers as a table.

use super::super::polygons::Polygons;
use super::body::{PlyBody, PlyElement, PlyEncoding, PlyHeader, PlyProperty, PlyScalar};
use crate::edited::FaceOutlines;
use crate::files::{ReadWatch, check_main_size};
use crate::format::{FormatDetails, Recognition};
use crate::geometry::unit_or_zero;
use crate::model::FileNotes;
use crate::{Error, Format, Geometry};
use glam::{DVec3, Vec3};
use pliant_mesh::{BoundingBox, NONE};
use std::collections::BTreeMap;

/// The format, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "ply",
    aliases: &[],
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
    /// What no other format takes, in words.
    pub beyond: Vec<String>,
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
        if vertex.scalar_property("packed_position").is_some() {
            let hint = "they are read uncompressed, or as spz";
            return Err(Error::unsupported(FORMAT, "header", "compressed Gaussian splats", hint));
        }
        let problem = "element `vertex` needs the numbers x, y and z";
        return Err(Error::malformed(FORMAT, "header", problem));
    };
    let is_real = |p: &usize| !vertex.properties[*p].scalar.is_integer();
    let normal = ["nx", "ny", "nz"].map(|name| vertex.scalar_property(name).filter(is_real));
    let normal = if let [Some(x), Some(y), Some(z)] = normal {
        Some([x, y, z])
    } else {
        None
    };
    let mut body = PlyBody::starting_at(bytes, header.encoding, header.body.0, header.body.1);
    let mut notes = PlyNotes {
        encoding: header.encoding,
        vertices_at: body.next_place(),
        vertex,
        position: [x, y, z],
        normal,
        outlines: FaceOutlines::default(),
        beyond: beyond_faces(&header),
    };
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    let mut faces = Polygons::default();
    let mut strays = 0;
    for element in &header.elements {
        body.require_rows_of(element, header.encoding)?;
        match element.name.as_str() {
            "vertex" => {
                notes.vertices_at = body.next_place();
                (positions, normals) = read_vertices(&mut body, &notes)?;
            }
            "face" | "tristrips" => read_faces(&mut body, element, notes.vertex.rows, &mut faces, watch)?,
            "edge" => strays += stray_ends(&mut body, element, notes.vertex.rows, watch)?,
            _ => body.skip_rows(element)?,
        }
    }
    let (mut geometry, outlines) = faces.into_geometry(positions, normals, watch)?;
    notes.outlines = outlines;
    if strays > 0 {
        let message = format!("{strays} ends of edges name no vertex; an edit leaves these edges out");
        geometry.warn("bad-line-index", message, "element `edge`");
    }
    Ok((geometry, notes))
}

/// Reads over edges; how many of their ends name none of so many vertices.
fn stray_ends(
    body: &mut PlyBody<'_>,
    element: &PlyElement,
    vertices: u64,
    watch: &ReadWatch<'_>,
) -> Result<u64, Error> {
    let Some(ends) = edge_ends(element) else {
        body.skip_rows(element)?;
        return Ok(0);
    };
    let mut strays = 0;
    for row in 0..element.rows {
        watch.check_at(row as usize)?;
        for p in 0..element.properties.len() {
            let value = body.read_normal(element.properties[p].scalar)?;
            let is_there = (0.0..vertices as f64).contains(&value);
            strays += u64::from(ends.contains(&p) && !is_there);
        }
    }
    Ok(strays)
}

/// What a file has that no other format takes, in words.
fn beyond_faces(header: &PlyHeader) -> Vec<String> {
    let others = header.elements.iter().filter(|e| e.rows > 0);
    let others = others.filter(|e| !matches!(e.name.as_str(), "vertex" | "face" | "tristrips"));
    others
        .map(|e| match (e.name.as_str(), e.rows) {
            ("edge", 1) => "1 edge".into(),
            ("edge", rows) => format!("{rows} edges"),
            (name, rows) => format!("{rows} rows of `{name}`"),
        })
        .collect()
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

/// The properties of edges that name their two vertices; `None` for edges with lists or without those.
pub(super) fn edge_ends(element: &PlyElement) -> Option<[usize; 2]> {
    let is_plain = element.properties.iter().all(|p| p.count.is_none());
    let end = |name: &str| element.scalar_property(name).filter(|_| is_plain);
    Some([end("vertex1")?, end("vertex2")?])
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

/// The types of the vertices' numbers: coordinates become doubles where whole numbers or floats lose places, floats far from the origin.
pub(super) fn stored_types(notes: &PlyNotes, positions: &[DVec3]) -> Result<Vec<PlyScalar>, Error> {
    let mut stored: Vec<PlyScalar> = notes.vertex.properties.iter().map(|p| p.scalar).collect();
    let is_far = BoundingBox::of(positions).is_far();
    let moved = |axis: usize| !positions.iter().all(|p| PlyScalar::F32.holds_exactly(p[axis]));
    for (axis, &property) in notes.position.iter().enumerate() {
        let scalar = &mut stored[property];
        if *scalar == PlyScalar::F32 && is_far && moved(axis) {
            *scalar = PlyScalar::F64;
        }
        if scalar.is_integer() && !positions.iter().all(|p| scalar.holds_exactly(p[axis])) {
            *scalar = PlyScalar::F64;
        } else if *scalar == PlyScalar::F32
            && let Some(i) = positions.iter().position(|p| !(p[axis] as f32).is_finite())
        {
            let problem = format!(
                "the position of vertex {i} is {}, too large for the file's floats",
                positions[i]
            );
            return Err(Error::unwritable(FORMAT, problem));
        }
    }
    Ok(stored)
}

/// A file taken apart.
pub(super) struct PlyTable<'a> {
    pub encoding: PlyEncoding,
    pub header: PlyHeader,
    /// Every single-number property of every vertex, row by row; list properties count as zero.
    pub vertices: Vec<f64>,
    /// For each list property of the vertices, its items by vertex.
    pub vertex_lists: BTreeMap<usize, Vec<Vec<f64>>>,
    /// The element that faces come from, if it says more than which vertices.
    pub face: Option<PlyElement>,
    /// As `vertices`, for the rows of that element.
    pub faces: Vec<f64>,
    /// For each list property of that element except the vertices, its items by row.
    pub face_lists: BTreeMap<usize, Vec<Vec<f64>>>,
    /// For each triangle of the geometry its row; [`NONE`] for those of strips.
    pub row_of: Vec<u32>,
    /// For each triangle corner its place in its face.
    pub place_of: Vec<u32>,
    /// How many corners each row has.
    pub corners_of: Vec<u32>,
    /// The rows of the first element of edges, where they name two vertices and have no lists.
    pub edges: Vec<Vec<f64>>,
    /// The bytes of elements that are neither vertices, faces, strips nor edges.
    pub others: BTreeMap<usize, &'a [u8]>,
}

/// Reads a file that was read before, whose vertices rest at `positions`.
pub(super) fn read_table<'a>(bytes: &'a [u8], positions: &[DVec3]) -> Result<PlyTable<'a>, Error> {
    let header = PlyHeader::read(bytes)?;
    let mut body = PlyBody::starting_at(bytes, header.encoding, header.body.0, header.body.1);
    let mut table = PlyTable {
        encoding: header.encoding,
        vertices: Vec::new(),
        vertex_lists: BTreeMap::new(),
        face: None,
        faces: Vec::new(),
        face_lists: BTreeMap::new(),
        row_of: Vec::new(),
        edges: Vec::new(),
        place_of: Vec::new(),
        corners_of: Vec::new(),
        others: BTreeMap::new(),
        header: PlyHeader {
            encoding: header.encoding,
            elements: Vec::new(),
            body: header.body,
        },
    };
    let mut faces = Polygons::default();
    // For each face its row, and the places of its corners follow from the order.
    let mut rows: Vec<(u32, u32)> = Vec::new();
    for (e, element) in header.elements.iter().enumerate() {
        match element.name.as_str() {
            "vertex" => {
                let mut lists = BTreeMap::new();
                for _ in 0..element.rows {
                    let row = read_row(&mut body, element, &mut lists, None)?;
                    table.vertices.extend(row);
                }
                table.vertex_lists = lists;
            }
            "face" | "tristrips" => table.read_faces(&mut body, element, &mut faces, &mut rows)?,
            "edge" if table.edges.is_empty() && edge_ends(element).is_some() => {
                for _ in 0..element.rows {
                    let row = read_row(&mut body, element, &mut BTreeMap::new(), None)?;
                    table.edges.push(row);
                }
            }
            "edge" => body.skip_rows(element)?,
            _ => {
                let start = body.next_place().0;
                body.skip_rows(element)?;
                table.others.insert(e, &bytes[start..body.next_place().0]);
            }
        }
    }
    table.header = header;
    if faces.corners.iter().any(|&v| v as usize >= positions.len()) {
        return Ok(table);
    }
    let (slots, _) = faces.triangulate(positions, || Ok(()))?;
    let mut starts = Vec::with_capacity(faces.corners.len());
    for &(row, corners) in &rows {
        starts.extend((0..corners).map(|place| (row, place)));
    }
    for slot in slots {
        let at = slot.map(|s| starts.get(s as usize).copied().unwrap_or((NONE, 0)));
        table.row_of.push(at[0].0);
        table.place_of.extend(at.map(|(_, place)| place));
    }
    Ok(table)
}

/// One row: single numbers in place, lists aside. The items of the list `indices` are handed out instead.
fn read_row(
    body: &mut PlyBody<'_>,
    element: &PlyElement,
    lists: &mut BTreeMap<usize, Vec<Vec<f64>>>,
    mut indices: Option<(usize, &mut Vec<f64>)>,
) -> Result<Vec<f64>, Error> {
    let mut row = Vec::with_capacity(element.properties.len());
    for (p, property) in element.properties.iter().enumerate() {
        let Some(count) = property.count else {
            row.push(body.read_normal(property.scalar)?);
            continue;
        };
        row.push(0.0);
        let mut items = Vec::new();
        for _ in 0..body.list_count(count, property.scalar)? {
            items.push(body.read_normal(property.scalar)?);
        }
        match &mut indices {
            Some((at, out)) if *at == p => **out = items,
            _ => lists.entry(p).or_default().push(items),
        }
    }
    Ok(row)
}

impl PlyTable<'_> {
    fn read_faces(
        &mut self,
        body: &mut PlyBody<'_>,
        element: &PlyElement,
        faces: &mut Polygons,
        rows: &mut Vec<(u32, u32)>,
    ) -> Result<(), Error> {
        let Some(list) = index_list(element) else {
            return body.skip_rows(element);
        };
        let strips = element.name == "tristrips";
        // Two elements of faces are not written by anybody; the first one's properties are kept.
        let keeps = !strips && self.face.is_none();
        let mut lists = BTreeMap::new();
        for row in 0..element.rows {
            let mut corners = Vec::new();
            let numbers = read_row(body, element, &mut lists, Some((list, &mut corners)))?;
            let mut strip = TriangleStrip::default();
            let count = corners.len() as u32;
            for index in corners {
                if !strips {
                    faces.corners.push(index as u32);
                } else if index == -1.0 {
                    strip = TriangleStrip::default();
                } else if let Some(triangle) = strip.next(index as u32) {
                    faces.corners.extend(triangle);
                    faces.end_face();
                    rows.push((NONE, 3));
                }
            }
            faces.end_face();
            if !strips && count >= 3 {
                rows.push((if keeps { row as u32 } else { NONE }, count));
            }
            if keeps {
                self.corners_of.push(count);
                if numbers.len() > 1 {
                    self.faces.extend(numbers);
                }
            }
        }
        if keeps {
            self.face = Some(element.clone());
            self.face_lists = lists;
        }
        Ok(())
    }

    /// The element of vertices.
    pub fn vertex(&self) -> Option<&PlyElement> {
        self.header.elements.iter().find(|e| e.name == "vertex")
    }

    /// A number of a vertex.
    pub fn vertex_number(&self, vertex: u32, property: usize) -> f64 {
        let width = self.vertex().map_or(0, |e| e.properties.len());
        self.vertices
            .get(vertex as usize * width + property)
            .copied()
            .unwrap_or(0.0)
    }

    /// A number of a row of faces.
    pub fn face_number(&self, row: u32, property: usize) -> f64 {
        let width = self.face.as_ref().map_or(0, |e| e.properties.len());
        self.faces.get(row as usize * width + property).copied().unwrap_or(0.0)
    }

    /// The list property of faces that has two numbers for each corner: texture coordinates.
    pub fn corner_list(&self) -> Option<(usize, &[Vec<f64>])> {
        let face = self.face.as_ref()?;
        let named = |p: &PlyProperty| p.name == "texcoord" && p.count.is_some() && p.scalar == PlyScalar::F32;
        let at = face.properties.iter().position(named)?;
        self.face_lists.get(&at).map(|lists| (at, lists.as_slice()))
    }

    /// For each triangle corner its texture coordinates by the faces' list; zero where a face has none.
    pub fn corner_coordinates(&self) -> Option<Vec<[f64; 2]>> {
        let (_, lists) = self.corner_list()?;
        let one = |(corner, &place): (usize, &u32)| {
            let row = self.row_of[corner / 3] as usize;
            let list = lists
                .get(row)
                .filter(|l| Some(l.len()) == self.corners_of.get(row).map(|&c| 2 * c as usize));
            let at = 2 * place as usize;
            list.and_then(|l| Some([*l.get(at)?, *l.get(at + 1)?]))
                .unwrap_or([0.0; 2])
        };
        Some(self.place_of.iter().enumerate().map(one).collect())
    }
}
