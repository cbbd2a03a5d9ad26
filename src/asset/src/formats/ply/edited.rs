//! PLY out after edits of the topology, and what an edited PLY gives to other formats.

use super::super::text::newline_of;
use super::body::{PlyElement, PlyEncoding, PlyProperty, PlyScalar, push};
use super::edges::rewired;
use super::read::{FORMAT, PlyNotes, PlyTable, VertexRole, edge_ends, is_indices, read_table, stored_types};
use crate::codec::EditedOutput;
use crate::edited::{CarriedAttributes, EditedModel, FollowedLines, PrimitiveRun, RunFaces, TriangleOrigins};
use crate::files::counted;
use crate::neutral::RunAttributes;
use crate::vertex_attributes::{AttributeKeys, hash_numbers};
use crate::{Error, Model, WrittenFiles, WrittenWarning};
use glam::{DVec3, Vec3};
use pliant_mesh::{NONE, mix_bits};
use std::collections::BTreeMap;

/// Names of colours, from which a lack of alpha means opaque.
const COLOURS: [[&str; 4]; 2] = [
    ["red", "green", "blue", "alpha"],
    ["diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"],
];

/// Names of texture coordinates of vertices.
const COORDINATES: [[&str; 2]; 4] = [
    ["s", "t"],
    ["u", "v"],
    ["texture_u", "texture_v"],
    ["texture_s", "texture_t"],
];

/// A file of the edited model in the encoding and with the properties of the first base. Faces that the edit left
/// alone stay whole, others are triangles; they have the numbers of the face that they lie on.
pub(super) fn write_edited(output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
    let EditedOutput { edited, positions, .. } = *output;
    let tables = edited.read_bases(|model, _: &PlyNotes| read_table(&model.files.main, &model.positions))?;
    let notes = edited.bases.first().and_then(|base| base.model.notes::<PlyNotes>());
    let (Some(Some(first)), Some(notes)) = (tables.first(), notes) else {
        return Err(Error::unwritable(FORMAT, "the first base is not PLY"));
    };
    let mut writer = EditedPlyWriter {
        output,
        edited,
        positions,
        notes,
        first,
        tables: &tables,
        stored: stored_types(notes, positions)?,
        run_faces: edited.runs.iter().map(output.run_faces).collect(),
        edges: Vec::new(),
        out: Vec::new(),
    };
    let lost = writer.follow_edges();
    writer.write_header(&edited.bases[0].model.files.main);
    let mut faces_written = false;
    for (e, element) in first.header.elements.iter().enumerate() {
        match element.name.as_str() {
            "vertex" => writer.write_vertices()?,
            "face" | "tristrips" if !faces_written => {
                faces_written = true;
                writer.write_faces()?;
            }
            "face" | "tristrips" => {}
            "edge" => writer.write_edges(element),
            _ => writer.copy_row(first.others.get(&e).copied().unwrap_or(&[])),
        }
    }
    let edges = counted(lost, "edge", "edges");
    let mut written = WrittenFiles::single(writer.out);
    written
        .warnings
        .extend(WrittenWarning::left_out(edges.as_slice(), FORMAT, "after the edit "));
    Ok(written)
}

/// The numbers of vertices beside position and normal, and those of the faces around them.
pub(super) fn distinguish_vertices(model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
    let notes: &PlyNotes = model.notes_or_refuse(FORMAT)?;
    let table = read_table(&model.files.main, &model.geometry.positions)?;
    let properties = notes.vertex.properties.iter().enumerate();
    for (p, property) in properties.filter(|(p, _)| notes.role(*p).is_none()) {
        let lists = table.vertex_lists.get(&p).filter(|_| property.count.is_some());
        for v in 0..model.geometry.positions.len() {
            match lists {
                Some(lists) => keys.add(v, lists.get(v).map_or(0, |list| hash_numbers(list))),
                None => keys.add(v, table.vertex_number(v as u32, p).to_bits()),
            }
        }
    }
    let triangles = &model.geometry.triangles;
    let (Some(face), true) = (&table.face, table.row_of.len() == triangles.len()) else {
        return Ok(());
    };
    let coordinates = table.corner_coordinates();
    let corner_list = table.corner_list().map(|(at, _)| at);
    let of_row = |row: u32| {
        let properties = face.properties.iter().enumerate();
        let own = properties.filter(|(p, property)| !is_indices(&property.name) && Some(*p) != corner_list);
        own.fold(1, |hash, (p, property)| {
            let list = table.face_lists.get(&p).and_then(|lists| lists.get(row as usize));
            mix_bits(
                hash,
                match property.count {
                    Some(_) => list.map_or(0, |list| hash_numbers(list)),
                    None => table.face_number(row, p).to_bits(),
                },
            )
        })
    };
    for (i, (t, &row)) in triangles.iter().zip(&table.row_of).enumerate() {
        let of_face = of_row(row);
        for (k, &v) in t.iter().enumerate() {
            let here = coordinates.as_ref().and_then(|all| all.get(3 * i + k));
            keys.add_of_corner(v, here.map_or(of_face, |uv| mix_bits(of_face, hash_numbers(uv))));
        }
    }
    Ok(())
}

struct EditedPlyWriter<'w, 'a> {
    output: &'w EditedOutput<'a>,
    edited: &'w EditedModel<'a>,
    positions: &'w [DVec3],
    notes: &'w PlyNotes,
    first: &'w PlyTable<'a>,
    tables: &'w [Option<PlyTable<'a>>],
    stored: Vec<PlyScalar>,
    /// For each run its faces, where some have more than three corners.
    run_faces: Vec<Option<RunFaces>>,
    /// The rows of edges.
    edges: Vec<Vec<f64>>,
    out: Vec<u8>,
}

impl EditedPlyWriter<'_, '_> {
    fn write_header(&mut self, bytes: &[u8]) {
        let text = &bytes[..self.first.header.body.0.min(bytes.len())];
        let newline = newline_of(bytes);
        let lines = || text.split(|b| matches!(b, b'\n' | b'\r')).map(|line| line.trim_ascii());
        let is_kept = |line: &&[u8]| {
            let word = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
            matches!(word, b"format" | b"comment" | b"obj_info")
        };
        let of_faces = face_properties(self.first, self.positions.len(), self.most_corners());
        let counts = self.edited.runs.iter().zip(&self.run_faces);
        let face_count: usize = counts
            .map(|(run, faces)| faces.as_ref().map_or(run.triangle_count as usize, RunFaces::face_count))
            .sum();
        let mut push = |line: &[u8]| {
            self.out.extend_from_slice(line);
            self.out.extend_from_slice(newline);
        };
        push(b"ply");
        lines().filter(|l| l.starts_with(b"format")).take(1).for_each(&mut push);
        lines()
            .filter(is_kept)
            .filter(|l| !l.starts_with(b"format"))
            .for_each(&mut push);
        let mut faces_written = false;
        for element in &self.first.header.elements {
            match element.name.as_str() {
                "vertex" => {
                    push(format!("element vertex {}", self.positions.len()).as_bytes());
                    for (property, &scalar) in element.properties.iter().zip(&self.stored) {
                        push(property_line(property, scalar).as_bytes());
                    }
                }
                "face" | "tristrips" => {
                    if !std::mem::replace(&mut faces_written, true) {
                        push(format!("element face {face_count}").as_bytes());
                        for property in &of_faces {
                            push(property_line(property, property.scalar).as_bytes());
                        }
                    }
                }
                "edge" if self.edges.is_empty() => {}
                "edge" => {
                    push(format!("element edge {}", self.edges.len()).as_bytes());
                    for (property, scalar) in element.properties.iter().zip(edge_types(element, self.positions.len())) {
                        push(property_line(property, scalar).as_bytes());
                    }
                }
                name => {
                    push(format!("element {name} {}", element.rows).as_bytes());
                    for property in &element.properties {
                        push(property_line(property, property.scalar).as_bytes());
                    }
                }
            }
        }
        push(b"end_header");
    }

    /// The most corners that a face has.
    fn most_corners(&self) -> usize {
        let faces = self.run_faces.iter().flatten().flat_map(RunFaces::face_corners);
        faces.map(<[u32]>::len).max().unwrap_or(3)
    }

    fn write_number(&mut self, value: f64, scalar: PlyScalar, first: bool) {
        let encoding = self.first.encoding;
        if encoding == PlyEncoding::Ascii && !first {
            self.out.push(b' ');
        }
        let value = if scalar.is_integer() {
            scalar.nearest_value(value)
        } else {
            value
        };
        push(&mut self.out, value, scalar, encoding);
    }

    fn end_row(&mut self) {
        if self.first.encoding == PlyEncoding::Ascii {
            self.out.push(b'\n');
        }
    }

    fn write_list(&mut self, items: &[f64], count: PlyScalar, scalar: PlyScalar, first: bool) {
        // A count that its type cannot hold was not read, so it is not here.
        self.write_number(items.len() as f64, count, first);
        items.iter().for_each(|&v| self.write_number(v, scalar, false));
    }

    fn write_vertices(&mut self) -> Result<(), Error> {
        for run in self.edited.runs {
            let normals = match self.notes.normal {
                Some(_) => CarriedAttributes::new(self.edited, run, self.positions).normals(),
                None => Vec::new(),
            };
            let columns = self.find_columns(run)?;
            for (i, vertex) in run.vertices().enumerate() {
                for (p, property) in self.notes.vertex.properties.iter().enumerate() {
                    let scalar = self.stored[p];
                    if let Some(count) = property.count {
                        let lists = self.first.vertex_lists.get(&p).filter(|_| run.base == 0);
                        let items = lists.and_then(|l| l.get(self.edited.blend(vertex).heaviest() as usize));
                        self.write_list(items.map_or(&[], Vec::as_slice), count, scalar, p == 0);
                        continue;
                    }
                    let value = match self.notes.role(p) {
                        Some(VertexRole::Position(axis)) => self.positions[vertex][axis],
                        Some(VertexRole::Normal(axis)) => {
                            f64::from(normals.get(i).copied().unwrap_or(Vec3::ZERO)[axis])
                        }
                        None => self.property_value(run, i, &columns[p], property, scalar),
                    };
                    self.write_number(value, scalar, p == 0);
                }
                self.end_row();
            }
        }
        Ok(())
    }

    /// Where each property of the first base finds its numbers in the base of a run.
    fn find_columns(&self, run: &PrimitiveRun) -> Result<Vec<PropertyColumn>, Error> {
        let names = &self.notes.vertex.properties;
        let Some(Some(table)) = self.tables.get(run.base as usize) else {
            let neutral = (self.output.neutral_base)(run.base)?;
            let before = self.edited.runs_with_triangles(run.base);
            let own = neutral.primitives().nth(before.take_while(|r| *r != run).count());
            let own = own.filter(|own| own.attributes.has_colours);
            let colours = own.and_then(|own| neutral.colours.get(own.vertices)).unwrap_or(&[]);
            let one = |p: &PlyProperty| match COLOURS.iter().find_map(|c| c.iter().position(|n| *n == p.name)) {
                Some(lane) if !colours.is_empty() => {
                    PropertyColumn::Values(colours.iter().map(|c| f64::from(c[lane])).collect())
                }
                Some(_) => PropertyColumn::Constant(1.0),
                None => PropertyColumn::Nothing,
            };
            return Ok(names.iter().map(one).collect());
        };
        let of = |p: &PlyProperty| {
            let found = table
                .vertex()
                .and_then(|e| e.scalar_property(&p.name).map(|at| (at, e.properties[at].scalar)));
            match found {
                Some((at, scalar)) => PropertyColumn::Stored(at, scalar),
                None if COLOURS.iter().flatten().any(|n| *n == p.name) => PropertyColumn::Constant(1.0),
                None => PropertyColumn::Nothing,
            }
        };
        Ok(names.iter().map(of).collect())
    }

    /// The value of a property at vertex `i` of a run, written as a `scalar`.
    fn property_value(
        &self,
        run: &PrimitiveRun,
        i: usize,
        column: &PropertyColumn,
        property: &PlyProperty,
        scalar: PlyScalar,
    ) -> f64 {
        let full = scalar.full_value();
        let is_colour = COLOURS.iter().flatten().any(|n| *n == property.name);
        match column {
            PropertyColumn::Nothing => 0.0,
            PropertyColumn::Constant(value) => value * full,
            PropertyColumn::Values(values) => values.get(i).copied().unwrap_or(1.0) * full,
            PropertyColumn::Stored(at, stored) => {
                let Some(Some(table)) = self.tables.get(run.base as usize) else {
                    return 0.0;
                };
                let vertex = run.first_vertex as usize + i;
                // Whole numbers of more than a byte are labels more often than quantities.
                let is_label = !is_colour && stored.is_integer() && stored.byte_size() > 1;
                let value = if is_label {
                    table.vertex_number(self.edited.blend(vertex).heaviest(), *at)
                } else {
                    self.edited.blended(vertex, |v| table.vertex_number(v, *at))
                };
                let scale = match (is_colour, stored.is_integer(), scalar.is_integer()) {
                    (true, true, false) => 1.0 / stored.largest_value(),
                    (true, false, true) => full,
                    _ => 1.0,
                };
                value * scale
            }
        }
    }

    fn write_faces(&mut self) -> Result<(), Error> {
        let properties = face_properties(self.first, self.positions.len(), self.most_corners());
        let coordinates = self.first.corner_coordinates();
        let corner_list = self.first.corner_list().map(|(at, _)| at);
        let seam = coordinates.as_ref().map(|c| number_pairs(c)).unwrap_or_default();
        let needs_origins = properties.len() > 1;
        let (edited, first) = (self.edited, self.first);
        let run_faces = std::mem::take(&mut self.run_faces);
        let runs = edited.runs.iter().zip(&run_faces);
        for (run, faces) in runs.filter(|(r, _)| r.triangle_count > 0) {
            let old = &edited.base(run).model.geometry.triangles;
            let has_rows = run.base == 0 && needs_origins && first.row_of.len() == old.len();
            let origins = has_rows.then(|| TriangleOrigins::new(edited, run, old));
            let corners = FaceCorners {
                triangles: &edited.triangles[run.triangles()],
                origins: origins.as_ref(),
                coordinates: coordinates.as_deref(),
                seam: &seam,
            };
            RunFaces::each_or_triangles(faces.as_ref(), corners.triangles.len(), |face| {
                let origin = corners.origin(face[0]);
                let row = first.row_of.get(origin as usize).copied().unwrap_or(NONE);
                for (p, property) in properties.iter().enumerate() {
                    let Some(count) = property.count else {
                        self.write_number(first.face_number(row, p), property.scalar, p == 0);
                        continue;
                    };
                    let items: Vec<f64> = if is_indices(&property.name) {
                        face.iter().map(|&c| f64::from(corners.vertex(c))).collect()
                    } else if Some(p) == corner_list {
                        face.iter().flat_map(|&c| corners.coordinates(c)).collect()
                    } else {
                        let whole = first.corners_of.get(row as usize) == Some(&(face.len() as u32));
                        let list = first.face_lists.get(&p).and_then(|l| l.get(row as usize));
                        list.filter(|_| whole).cloned().unwrap_or_default()
                    };
                    self.write_list(&items, count, property.scalar, p == 0);
                }
                self.end_row();
            });
        }
        Ok(())
    }

    /// Finds where the edges of the first base are now; answers how many are gone.
    fn follow_edges(&mut self) -> usize {
        let elements = self.first.header.elements.iter().filter(|e| e.name == "edge");
        let mut named = elements.clone().filter_map(edge_ends);
        let Some(ends) = named.next() else {
            return elements.map(|e| e.rows as usize).sum();
        };
        let own = self.edited.runs.iter().filter(|run| run.base == 0);
        let followed = FollowedLines::of_runs(self.edited, own);
        let mut lost = 0;
        for (row, count) in rewired(&self.first.edges, ends, &followed) {
            let [a, b] = ends.map(|end| row[end] as u32);
            // An edge that lies on no triangle joins its two vertices, with what is between them.
            let along = followed
                .edges_along(a, b)
                .filter(|along| !along.is_empty())
                .unwrap_or_else(|| followed.segment(a, b));
            lost += if along.is_empty() { count } else { count - 1 };
            for edge in along {
                let mut row = row.clone();
                ends.iter()
                    .zip(edge)
                    .for_each(|(end, vertex)| row[*end] = f64::from(vertex));
                self.edges.push(row);
            }
        }
        lost
    }

    fn write_edges(&mut self, element: &PlyElement) {
        let types = edge_types(element, self.positions.len());
        for row in std::mem::take(&mut self.edges) {
            for (p, (value, scalar)) in row.iter().zip(&types).enumerate() {
                self.write_number(*value, *scalar, p == 0);
            }
            self.end_row();
        }
    }

    fn copy_row(&mut self, bytes: &[u8]) {
        if self.first.encoding == PlyEncoding::Ascii {
            self.out.extend_from_slice(bytes.trim_ascii());
            self.end_row();
        } else {
            self.out.extend_from_slice(bytes);
        }
    }
}

/// What corners of a run's triangles have: 3 × triangle + place.
struct FaceCorners<'c> {
    triangles: &'c [[u32; 3]],
    origins: Option<&'c TriangleOrigins<'c>>,
    /// Texture coordinates of the old corners, and which of them are equal.
    coordinates: Option<&'c [[f64; 2]]>,
    seam: &'c [u32],
}

impl FaceCorners<'_> {
    fn vertex(&self, corner: u32) -> u32 {
        self.triangles[corner as usize / 3][corner as usize % 3]
    }

    /// The old triangle that a corner's triangle lies on.
    fn origin(&self, corner: u32) -> u32 {
        let triangle = corner as usize / 3;
        self.origins.map_or(NONE, |o| o.old_triangles()[triangle])
    }

    fn coordinates(&self, corner: u32) -> [f64; 2] {
        let mut sum = [0.0; 2];
        if let (Some(origins), Some(coordinates)) = (self.origins, self.coordinates)
            && self.origin(corner) != NONE
        {
            for (old, weight) in origins.corner(corner as usize / 3, corner as usize % 3, self.seam) {
                let at = coordinates[old as usize];
                sum = [sum[0] + at[0] * weight, sum[1] + at[1] * weight];
            }
        }
        sum
    }
}

/// Where the numbers of one property come from.
enum PropertyColumn {
    /// A property of a PLY base, and its type.
    Stored(usize, PlyScalar),
    /// Colours of another format, from 0 to 1.
    Values(Vec<f64>),
    /// The same for all, 1 being the whole of the type's range.
    Constant(f64),
    Nothing,
}

/// The types of the numbers of edges, of which two number so many vertices.
fn edge_types(element: &PlyElement, vertices: usize) -> Vec<PlyScalar> {
    let ends = edge_ends(element);
    let holds = |scalar: PlyScalar| scalar.holds_exactly(vertices as f64);
    let is_end = |p: usize| ends.is_some_and(|ends| ends.contains(&p));
    let wide = |(p, property): (usize, &PlyProperty)| match is_end(p) && !holds(property.scalar) {
        true => PlyScalar::U32,
        false => property.scalar,
    };
    element.properties.iter().enumerate().map(wide).collect()
}

/// The properties of faces: those of the first base, in types that hold the numbers of vertices and corners.
fn face_properties(first: &PlyTable<'_>, vertices: usize, most_corners: usize) -> Vec<PlyProperty> {
    let of_file = first
        .face
        .as_ref()
        .map(|element: &PlyElement| element.properties.clone());
    let mut properties = of_file.unwrap_or_else(|| {
        vec![PlyProperty {
            name: "vertex_indices".into(),
            count: Some(PlyScalar::U8),
            scalar: PlyScalar::I32,
            type_place: 0..0,
        }]
    });
    for property in properties.iter_mut().filter(|p| is_indices(&p.name)) {
        if !property.scalar.holds_exactly(vertices as f64) {
            property.scalar = PlyScalar::U32;
        }
    }
    for property in &mut properties {
        // Polygons of another base may have more corners than this file's; two numbers stand for each at most.
        let holds = |count: &PlyScalar| count.holds_exactly(2.0 * most_corners as f64);
        property.count = property
            .count
            .map(|count| if holds(&count) { count } else { PlyScalar::U32 });
    }
    properties
}

fn property_line(property: &PlyProperty, scalar: PlyScalar) -> String {
    let (name, scalar) = (&property.name, scalar.name());
    match property.count {
        Some(count) => format!("property list {} {scalar} {name}", count.name()),
        None => format!("property {scalar} {name}"),
    }
}

/// A number for each distinct pair.
fn number_pairs(pairs: &[[f64; 2]]) -> Vec<u32> {
    let mut known = BTreeMap::new();
    let one = |pair: &[f64; 2]| {
        let next = known.len() as u32;
        *known.entry(pair.map(f64::to_bits)).or_insert(next)
    };
    pairs.iter().map(one).collect()
}

/// Colours and texture coordinates of the vertices of runs.
pub(super) fn run_attributes(edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
    let Some(first) = runs.first() else {
        return Ok(Vec::new());
    };
    let model = edited.base(first).model;
    let table = read_table(&model.files.main, &model.geometry.positions)?;
    let Some(vertex) = table.vertex() else {
        return Ok(Vec::new());
    };
    let find = |names: &[&str]| -> Option<Vec<usize>> { names.iter().map(|n| vertex.scalar_property(n)).collect() };
    let colour = COLOURS
        .iter()
        .find_map(|names| Some((find(&names[..3])?, vertex.scalar_property(names[3]))));
    let coordinates = COORDINATES.iter().find_map(|names| find(names));
    let value = |new: usize, property: usize| edited.blended(new, |v| table.vertex_number(v, property));
    let share = |new: usize, property: usize| -> f32 {
        let full = vertex.properties[property].scalar.full_value();
        ((value(new, property) / full) as f32).clamp(0.0, 1.0)
    };
    let one = |run: &&PrimitiveRun| {
        let mut extras = RunAttributes::default();
        if let Some((rgb, alpha)) = &colour {
            let of = |v: usize| {
                let [r, g, b] = [0, 1, 2].map(|lane| share(v, rgb[lane]));
                [r, g, b, alpha.map_or(1.0, |a| share(v, a))]
            };
            extras.colours = run.vertices().map(of).collect();
        }
        if let Some(uv) = &coordinates {
            extras.uv = run
                .vertices()
                .map(|v| [value(v, uv[0]) as f32, (1.0 - value(v, uv[1])) as f32])
                .collect();
        } else if let Some(corners) = table.corner_coordinates().filter(|_| run.triangle_count > 0) {
            let old = &model.geometry.triangles;
            let origins = TriangleOrigins::new(edited, run, old);
            let seam = number_pairs(&corners);
            let corners = FaceCorners {
                triangles: &edited.triangles[run.triangles()],
                origins: (corners.len() == 3 * old.len()).then_some(&origins),
                coordinates: Some(&corners),
                seam: &seam,
            };
            let at = |c: u32| {
                let [u, v] = corners.coordinates(c);
                [u as f32, (1.0 - v) as f32]
            };
            extras.corner_uv = (0..3 * run.triangle_count).map(at).collect();
        }
        extras
    };
    Ok(runs.iter().map(one).collect())
}
