//! The numbers of a PLY file beyond positions and triangles, read again when they are needed.

use super::super::polygons::Polygons;
use super::body::{PlyBody, PlyElement, PlyEncoding, PlyHeader, PlyProperty, PlyScalar};
use super::read::{TriangleStrip, index_list};
use crate::asset::Error;
use crate::mesh::NONE;
use glam::DVec3;
use std::collections::BTreeMap;

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
    /// The bytes of elements that are neither vertices, faces, strips nor edges.
    pub others: BTreeMap<usize, &'a [u8]>,
}

/// Reads a file that was read before, whose vertices rest at `positions`.
pub(super) fn read<'a>(bytes: &'a [u8], positions: &[DVec3]) -> Result<PlyTable<'a>, Error> {
    let header = PlyHeader::read(bytes)?;
    let mut body = PlyBody::starting_at(bytes, header.encoding, header.body);
    let mut table = PlyTable {
        encoding: header.encoding,
        vertices: Vec::new(),
        vertex_lists: BTreeMap::new(),
        face: None,
        faces: Vec::new(),
        face_lists: BTreeMap::new(),
        row_of: Vec::new(),
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
