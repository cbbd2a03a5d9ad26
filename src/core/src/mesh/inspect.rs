//! The inspection report: what a mesh is made of and what is unusual about it. Nothing here is fatal.

use crate::mesh::adjacency::Adjacency;
use crate::mesh::boundary::BoundaryLoop;
use crate::mesh::components::Components;
use crate::mesh::findings::{MeshFindings, MeshWarning, describe_findings};
use crate::mesh::measure::BoundingBox;
use crate::mesh::measure::{cone_volume, mean_edge_length, signed_volume, surface_area, triangle_area};
use crate::mesh::welded_mesh::Mesh;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::findings::PLACES;
    use crate::mesh::weld::Weld;
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
        // stray vertex and a second part that touches nothing.
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
    fn a_crack_is_told_from_an_honest_rim() {
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
