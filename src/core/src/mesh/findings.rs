//! What is unusual about a mesh, place by place, and how it is reported.

use crate::mesh::adjacency::{Adjacency, MeshEdge};
use crate::mesh::boundary::{BoundaryLoop, boundary_loops};
use crate::mesh::query::fan::group_fans;
use crate::mesh::readable::{brief_point, grouped_count};
use crate::mesh::weld;
use crate::mesh::weld::Weld;
use crate::mesh::welded_mesh::{Mesh, NONE};

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
pub(super) fn describe_findings(mesh: &Mesh, found: &MeshFindings, parts: &[(u32, usize)]) -> Vec<MeshWarning> {
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
