//! The inspection report: what a mesh is made of and what is unusual about it. Nothing here is fatal.
//!
//! What is unusual about a mesh, place by place, and how it is reported.

use crate::adjacency::{Adjacency, BoundaryLoop, Components, MeshEdge, boundary_loops};
use crate::measure::{
    BoundingBox, brief_point, cone_volume, grouped_count, mean_edge_length, signed_volume, surface_area, triangle_area,
};
use crate::query::closest_surface_point::group_fans;
use crate::weld::{self, Weld};
use crate::welded_mesh::{Mesh, NONE};

/// One connected part.
#[derive(Debug, Clone, PartialEq)]
pub struct PartReport {
    /// Its smallest solver vertex.
    pub first_vertex: u32,
    /// Number of its solver vertices.
    pub vertices: usize,
    /// Number of its faces.
    pub triangles: usize,
    /// Area of its faces.
    pub area: f64,
    /// Signed volume; meaningful when `closed`.
    pub volume: f64,
    /// Whether each of its edges has exactly two faces.
    pub closed: bool,
}

/// Counts and measures of a mesh. Vertices and faces are the solver's unless said otherwise.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshReport {
    /// Render vertices.
    pub render_vertices: usize,
    /// Solver vertices.
    pub vertices: usize,
    /// Faces.
    pub triangles: usize,
    /// Edges.
    pub edges: usize,
    /// Render vertices that no face uses.
    pub unreferenced_vertices: usize,
    /// Render vertices that were welded to an earlier one.
    pub coincident_vertices: usize,
    /// Input faces with two corners at one point, or without area.
    pub degenerate_triangles: usize,
    /// Input faces left out because an earlier one has the same corners.
    pub duplicate_triangles: usize,
    /// Faces more than a hundred times longer than high.
    pub slivers: usize,
    /// Edges with one face.
    pub boundary_edges: usize,
    /// The rims that those edges form.
    pub boundary_loops: Vec<BoundaryLoop>,
    /// Edges with more than two faces.
    pub non_manifold_edges: usize,
    /// Vertices whose faces form more than one fan.
    pub non_manifold_vertices: usize,
    /// Edges whose two faces are wound in opposite senses.
    pub winding_conflicts: usize,
    /// Boundary vertices so close to another that they are probably meant to be one.
    pub cracked_vertices: usize,
    /// Connected parts in the order of their smallest vertex.
    pub parts: Vec<PartReport>,
    /// Whether each edge has exactly two faces.
    pub closed: bool,
    /// The smallest box around the vertices.
    pub bounds: BoundingBox,
    /// Area of all faces.
    pub area: f64,
    /// Signed volume; meaningful when `closed`.
    pub volume: f64,
    /// Mean length of the edges.
    pub mean_edge_length: f64,
    /// What a user may want to know of, at most one entry per code.
    pub warnings: Vec<MeshWarning>,
}

/// Examines `mesh`; `adjacency` must be its own.
///
/// # Panics
/// When `adjacency` belongs to another mesh.
pub fn inspect(mesh: &Mesh, adjacency: &Adjacency) -> MeshReport {
    let edges = &adjacency.edges;
    let parts = parts(mesh, adjacency);
    let found = MeshFindings::gather(mesh, adjacency);
    let warnings = describe_findings(
        mesh,
        &found,
        &parts.iter().map(|p| (p.first_vertex, p.vertices)).collect::<Vec<_>>(),
    );
    MeshReport {
        render_vertices: mesh.solver_from_render.len(),
        vertices: mesh.positions.len(),
        triangles: mesh.triangles.len(),
        edges: edges.len(),
        unreferenced_vertices: found.unreferenced.len(),
        coincident_vertices: mesh.render_from_solver().items().len() - mesh.positions.len(),
        degenerate_triangles: found.degenerate.len(),
        duplicate_triangles: mesh.duplicate_triangles.len(),
        slivers: found.slivers.len(),
        boundary_edges: edges.iter().filter(|e| e.faces() == 1).count(),
        boundary_loops: found.loops,
        non_manifold_edges: found.crowded_edges.len(),
        non_manifold_vertices: found.pinched_vertices.len(),
        winding_conflicts: found.conflicts.len(),
        cracked_vertices: found.cracked.len(),
        closed: parts.iter().all(|p| p.closed),
        parts,
        bounds: mesh.bounds(),
        area: surface_area(&mesh.positions, &mesh.triangles),
        volume: signed_volume(&mesh.positions, &mesh.triangles),
        mean_edge_length: mean_edge_length(&mesh.positions, edges),
        warnings,
    }
}

fn parts(mesh: &Mesh, adjacency: &Adjacency) -> Vec<PartReport> {
    let components = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    let mut parts: Vec<PartReport> = components
        .first_vertices()
        .into_iter()
        .map(|first_vertex| PartReport {
            first_vertex,
            vertices: 0,
            triangles: 0,
            area: 0.0,
            volume: 0.0,
            closed: true,
        })
        .collect();
    components
        .of_vertex
        .iter()
        .for_each(|&c| parts[c as usize].vertices += 1);
    for &t in &mesh.triangles {
        let part = &mut parts[components.of_vertex[t[0] as usize] as usize];
        let origin = mesh.positions[part.first_vertex as usize];
        part.triangles += 1;
        part.area += triangle_area(&mesh.positions, t);
        part.volume += cone_volume(&mesh.positions, t, origin);
    }
    for e in adjacency.edges.iter().filter(|e| e.faces() != 2) {
        parts[components.of_vertex[e.vertices[0] as usize] as usize].closed = false;
    }
    parts
}

/// A face is a sliver when its longest edge is more than this many times its height over that edge.
const SLIVER: f64 = 100.0;
/// How many places one warning spells out.
pub(super) const PLACES: usize = 16;
/// Rims closer to each other than this fraction of the box's diagonal look like one crack.
const CRACK: f64 = 1e-5;

/// Something unusual that a user may want to know of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeshWarning {
    /// What kind, in kebab-case; stable.
    pub code: &'static str,
    /// What, how many, and where the first one is.
    pub message: String,
    /// Where: up to sixteen places, separated by `; `.
    pub place: String,
    /// A render vertex at each of these places, in their order; places that have none are left out.
    pub vertices: Vec<u32>,
}

/// What is unusual about a mesh, place by place.
pub(super) struct MeshFindings {
    pub(super) loops: Vec<BoundaryLoop>,
    /// Boundary vertices almost on others.
    pub(super) cracked: Vec<u32>,
    /// Edges with more than two faces.
    pub(super) crowded_edges: Vec<[u32; 2]>,
    /// Vertices whose faces form more than one fan.
    pub(super) pinched_vertices: Vec<u32>,
    /// Edges between faces of opposite winding.
    pub(super) conflicts: Vec<[u32; 2]>,
    /// Input faces without area, or with two corners at one point; rising.
    pub(super) degenerate: Vec<u32>,
    pub(super) slivers: Vec<u32>,
    /// Render vertices that no face uses.
    pub(super) unreferenced: Vec<u32>,
}

impl MeshFindings {
    pub(super) fn gather(mesh: &Mesh, adjacency: &Adjacency) -> Self {
        let thin = thin_faces(mesh);
        let vertices = 0..mesh.positions.len() as u32;
        let edges_that = |wanted: fn(&MeshEdge) -> bool| {
            let found = adjacency.edges.iter().filter(|e| wanted(e));
            found.map(|e| e.vertices).collect()
        };
        let render_vertices = (0u32..).zip(&mesh.solver_from_render);
        Self {
            loops: boundary_loops(&mesh.positions, adjacency),
            cracked: cracked_vertices(mesh, adjacency),
            crowded_edges: edges_that(|e| e.faces() > 2),
            pinched_vertices: vertices
                .filter(|&v| count_fans_around(v, &mesh.triangles, adjacency) > 1)
                .collect(),
            conflicts: edges_that(|e| e.faces() == 2 && e.forward != e.backward),
            degenerate: merged(&mesh.collapsed_triangles, &thin.flat),
            slivers: thin.slivers,
            unreferenced: render_vertices.filter(|s| *s.1 == NONE).map(|s| s.0).collect(),
        }
    }
}

/// Puts findings into words, at most one entry per kind. `parts` are the first solver vertex of each part and how many it has.
fn describe_findings(mesh: &Mesh, found: &MeshFindings, parts: &[(u32, usize)]) -> Vec<MeshWarning> {
    let vertex = |s: u32| vertex_place(mesh, s);
    let face = |t: u32| face_place(mesh, t);
    let counted = |count: usize, of: &str, s: u32| {
        let (place, corner) = vertex(s);
        (format!("{} {of}, {place}", grouped_count(count as u64)), corner)
    };
    let mut words = FindingWords::default();
    let kind = ["boundary-loop", "hole", "holes"];
    words.add_kind(kind, &found.loops, |l| counted(l.edges, "edges long", l.vertex));
    let kind = [
        "crack",
        "boundary vertex almost on another",
        "boundary vertices almost on others",
    ];
    words.add_kind(kind, &found.cracked, |&v| vertex(v));
    let kind = [
        "rounded-vertex",
        "vertex is welded to one with slightly different coordinates",
        "vertices are welded to others with slightly different coordinates",
    ];
    words.add_kind(kind, &mesh.inexact_vertices, |&v| {
        let at = brief_point(mesh.positions[mesh.solver_from_render[v as usize] as usize]);
        (format!("at render vertex {} at {at}", grouped_count(v.into())), Some(v))
    });
    let kind = ["non-manifold-edge", "non-manifold edge", "non-manifold edges"];
    words.add_kind(kind, &found.crowded_edges, |&e| edge_place(mesh, e));
    let kind = ["non-manifold-vertex", "non-manifold vertex", "non-manifold vertices"];
    words.add_kind(kind, &found.pinched_vertices, |&v| vertex(v));
    let kind = [
        "winding-conflict",
        "edge between faces of opposite winding",
        "edges between faces of opposite winding",
    ];
    words.add_kind(kind, &found.conflicts, |&e| edge_place(mesh, e));
    let kind = ["degenerate-face", "face without area", "faces without area"];
    words.add_kind(kind, &found.degenerate, |&t| face(t));
    let kind = ["duplicate-face", "repeated face", "repeated faces"];
    words.add_kind(kind, &mesh.duplicate_triangles, |&t| face(t));
    let kind = [
        "sliver",
        "face over 100 times longer than high",
        "faces over 100 times longer than high",
    ];
    words.add_kind(kind, &found.slivers, |&t| face(t));
    let kind = [
        "unreferenced-vertex",
        "vertex that no face uses",
        "vertices that no face uses",
    ];
    words.add_kind(kind, &found.unreferenced, |&v| {
        (format!("at render vertex {}", grouped_count(v.into())), Some(v))
    });
    if parts.len() > 1 {
        let kind = ["components", "connected part", "connected parts"];
        words.add_kind(kind, parts, |&(first, count)| counted(count, "vertices", first));
    }
    words.warnings
}

/// Warnings as they are put into words.
#[derive(Default)]
struct FindingWords {
    warnings: Vec<MeshWarning>,
}

impl FindingWords {
    /// Adds a warning about all that was found of a kind, if something was: its code, and what one and many are called.
    fn add_kind<T>(&mut self, [code, one, many]: [&'static str; 3], found: &[T], place: impl Fn(&T) -> FoundPlace) {
        if found.is_empty() {
            return;
        }
        let (what, first) = if found.len() == 1 { (one, "") } else { (many, "first ") };
        let (mut places, vertices): (Vec<String>, Vec<Option<u32>>) = found.iter().take(PLACES).map(place).unzip();
        let count = grouped_count(found.len() as u64);
        let message = format!("{count} {what}, {first}{}", places[0]);
        if let Some(more) = found.len().checked_sub(PLACES).filter(|more| *more > 0) {
            places.push(format!("and {} more", grouped_count(more as u64)));
        }
        self.warnings.push(MeshWarning {
            code,
            message,
            place: places.join("; "),
            vertices: vertices.into_iter().flatten().collect(),
        });
    }
}

/// A place in words, and a render vertex there.
type FoundPlace = (String, Option<u32>);

fn vertex_place(mesh: &Mesh, solver: u32) -> FoundPlace {
    let vertex = mesh.render_vertices_of(solver)[0];
    let at = brief_point(mesh.positions[solver as usize]);
    let number = grouped_count(vertex.into());
    (format!("at render vertex {number} at {at}"), Some(vertex))
}

fn edge_place(mesh: &Mesh, ends: [u32; 2]) -> FoundPlace {
    let [a, b] = ends.map(|s| mesh.positions[s as usize]);
    let [first, second] = ends.map(|s| mesh.render_vertices_of(s)[0]);
    let numbers = [first, second].map(|v| grouped_count(v.into()));
    let at = brief_point((a + b) * 0.5);
    let words = format!("between render vertices {} and {} at {at}", numbers[0], numbers[1]);
    (words, Some(first))
}

fn face_place(mesh: &Mesh, input: u32) -> FoundPlace {
    let drawn = mesh.source_triangle.binary_search(&input);
    let corner = drawn.ok().map(|d| mesh.render_vertices_of(mesh.triangles[d][0])[0]);
    (format!("at triangle {}", grouped_count(input.into())), corner)
}

/// Two rising lists as one.
fn merged(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut all = [a, b].concat();
    all.sort_unstable();
    all
}

/// Faces worth a warning, as input triangles.
struct ThinFaces {
    flat: Vec<u32>,
    slivers: Vec<u32>,
}

fn thin_faces(mesh: &Mesh) -> ThinFaces {
    let mut thin = ThinFaces {
        flat: Vec::new(),
        slivers: Vec::new(),
    };
    for (t, &source) in mesh.triangles.iter().zip(&mesh.source_triangle) {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let twice_area = (b - a).cross(c - a).length();
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        // Areas below what rounding of the cross product leaves are none.
        if twice_area <= longest * longest * 1e-14 {
            thin.flat.push(source);
        } else if longest * longest > SLIVER * twice_area {
            thin.slivers.push(source);
        }
    }
    thin
}

/// Into how many fans the faces around a vertex fall; faces are in one fan when they share an edge at the vertex.
fn count_fans_around(vertex: u32, triangles: &[[u32; 3]], adjacency: &Adjacency) -> usize {
    let faces = adjacency.faces.of(vertex);
    let spokes = faces.iter().zip(0u32..).flat_map(|(&f, i)| {
        let others = triangles[f as usize].into_iter().filter(move |&v| v != vertex);
        others.map(move |v| (v, i))
    });
    group_fans(faces.len(), spokes).1
}

/// Boundary vertices that lie within the crack distance of another boundary vertex.
fn cracked_vertices(mesh: &Mesh, adjacency: &Adjacency) -> Vec<u32> {
    let mut on_rim = vec![false; mesh.positions.len()];
    let rim = adjacency.edges.iter().filter(|e| e.faces() == 1);
    rim.flat_map(|e| e.vertices).for_each(|v| on_rim[v as usize] = true);
    let tolerance = Weld::Tolerance(mesh.bounds().diagonal() * CRACK);
    let near = weld::representatives(&mesh.positions, &mesh.triangles, &on_rim, tolerance).unwrap_or_default();
    (0u32..).zip(&near).filter(|(v, r)| v != *r).map(|(v, _)| v).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weld::Weld;
    use glam::DVec3;

    fn report(positions: &[[f64; 3]], faces: &[[u32; 3]]) -> MeshReport {
        let positions: Vec<DVec3> = positions.iter().copied().map(DVec3::from_array).collect();
        let mesh = Mesh::build(&positions, faces, Weld::Exact).expect("a mesh");
        inspect(&mesh, &Adjacency::build(mesh.positions.len(), &mesh.triangles))
    }

    const TETRAHEDRON: [[f64; 3]; 4] = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    #[test]
    fn a_clean_closed_mesh_has_nothing_to_warn_of() {
        let r = report(&TETRAHEDRON, &FACES);
        assert!(r.closed && r.warnings.is_empty(), "{:?}", r.warnings);
        assert_eq!((r.vertices, r.edges, r.triangles, r.parts.len()), (4, 6, 4, 1));
        assert!((r.parts[0].volume - r.volume).abs() < 1e-12 && (r.volume - 1.0 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn each_defect_is_counted_and_named_once() {
        // A tetrahedron with a hole, a fin on one edge, a flipped neighbour, a repeated and a collapsed face, a
        // unreferenced vertex and a second part that touches nothing.
        let mut p = TETRAHEDRON.to_vec();
        p.extend([
            [0.5, -1., 0.],
            [9., 9., 9.],
            [5., 0., 0.],
            [6., 0., 0.],
            [5.5, 1e-3, 0.],
        ]);
        let faces = [
            [0, 2, 1],
            [0, 1, 3],
            [1, 2, 3],
            [0, 1, 4],
            [3, 1, 0],
            [2, 2, 3],
            [6, 7, 8],
        ];
        let r = report(&p, &faces);
        let codes: Vec<&str> = r.warnings.iter().map(|w| w.code).collect();
        assert_eq!(
            codes,
            [
                "boundary-loop",
                "non-manifold-edge",
                "degenerate-face",
                "duplicate-face",
                "sliver",
                "unreferenced-vertex",
                "components"
            ]
        );
        assert_eq!(
            (r.non_manifold_edges, r.duplicate_triangles, r.degenerate_triangles),
            (1, 1, 1)
        );
        assert_eq!(
            (r.slivers, r.unreferenced_vertices, r.parts.len(), r.closed),
            (1, 1, 2, false)
        );
        let edge = &r.warnings[1].message;
        assert_eq!(
            edge,
            "1 non-manifold edge, between render vertices 0 and 1 at (0.5, 0, 0)"
        );
        assert_eq!(r.warnings[3].place, "at triangle 4");
        let pointed = [1, 3, 4].map(|k: usize| r.warnings[k].vertices.as_slice());
        assert_eq!(
            pointed,
            [&[0][..], &[], &[6]],
            "a face that was left out has no vertex to show"
        );
    }

    #[test]
    fn winding_conflicts_and_pinched_vertices_are_found() {
        let mut faces = FACES;
        faces[0].swap(0, 1);
        let r = report(&TETRAHEDRON, &faces);
        assert_eq!((r.winding_conflicts, r.closed), (3, true));
        let pinch = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [-1., 0., 0.], [-1., -1., 0.]];
        let r = report(&pinch, &[[0, 1, 2], [0, 3, 4]]);
        assert_eq!(
            (r.non_manifold_vertices, r.parts.len(), r.boundary_loops.len()),
            (1, 1, 2)
        );
    }

    #[test]
    fn a_crack_and_an_honest_rim_differ() {
        let gap = 1e-7;
        let p = [
            [0., 0., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [1., gap, 0.],
            [gap, 1., 0.],
            [1., 1., 0.],
        ];
        let r = report(&p, &[[0, 1, 2], [3, 5, 4]]);
        assert_eq!(r.cracked_vertices, 2);
        assert_eq!(report(&p, &[[0, 1, 2]]).cracked_vertices, 0);
    }

    #[test]
    fn many_places_are_summarised() {
        let p: Vec<[f64; 3]> = (0..90).map(|i| [f64::from(i), f64::from(i % 3), 0.0]).collect();
        let faces: Vec<[u32; 3]> = (0..30).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let r = report(&p, &faces);
        let w = &r.warnings[0];
        assert!(
            w.message
                .starts_with("30 holes, first 3 edges long, at render vertex 0"),
            "{}",
            w.message
        );
        assert!(
            w.place.ends_with("; and 14 more") && w.place.matches("; ").count() == PLACES,
            "{}",
            w.place
        );
    }
}
