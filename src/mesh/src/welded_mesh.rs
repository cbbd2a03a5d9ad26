//! The welded, cleaned triangle mesh, with its map to the render vertices that it came from.

use crate::adjacency::Lists;
use crate::error::Error;
use crate::measure::BoundingBox;
use crate::weld::{self, Weld};
use glam::DVec3;

/// In [`Mesh::solver_from_render`]: the render vertex has no solver vertex, because no face uses it.
pub const NONE: u32 = u32::MAX;

/// A welded, cleaned triangle mesh with its map to the render vertices that it came from.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Solver vertices: one per distinct point that a face uses, numbered by first appearance among the render
    /// vertices. Each is a corner of at least one triangle.
    pub positions: Vec<DVec3>,
    /// Faces over solver vertices in the order of the input, each with three distinct corners, no two with the same
    /// three corners. A face without area stays, because it still connects its corners.
    pub triangles: Vec<[u32; 3]>,
    /// The solver vertex of each render vertex, or [`NONE`].
    pub solver_from_render: Vec<u32>,
    /// For each triangle, which input triangle it is.
    pub source_triangle: Vec<u32>,
    /// Input triangles left out because two corners are the same point.
    pub collapsed_triangles: Vec<u32>,
    /// Input triangles left out because an earlier one has the same three corners, whichever way round.
    pub duplicate_triangles: Vec<u32>,
    /// Render vertices that are not exactly where their solver vertex is, rising.
    pub inexact_vertices: Vec<u32>,
    render_from_solver: Lists,
}

impl Mesh {
    /// Welds and cleans the triangles of a model.
    ///
    /// Linear but for one sort of the vertices; uses no thread but the caller's.
    ///
    /// ```
    /// use glam::DVec3;
    /// use pliant_mesh::{Mesh, Weld};
    ///
    /// // A square of two triangles whose common edge is split, as along a seam of the shading.
    /// let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    /// let positions = corners.map(|[x, y]| DVec3::new(x, y, 0.0));
    /// let mesh = Mesh::build(&positions, &[[0, 1, 2], [3, 4, 5]], Weld::Exact)?;
    /// assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    /// assert_eq!(mesh.render_vertices_of(0), [0, 3]);
    /// # Ok::<(), pliant_mesh::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error`] when an index is out of range, a used position is not finite or outside the range of `f32`, the
    /// tolerance is not a length, there are more than 32-bit indices can name, or no face is left.
    pub fn build(positions: &[DVec3], triangles: &[[u32; 3]], weld: Weld) -> Result<Self, Error> {
        check_counts(positions, triangles)?;
        let used = used_vertices(positions, triangles)?;
        let representative = weld::representatives(positions, triangles, &used, weld)?;
        let kept = clean(triangles, &representative);
        if kept.triangles.is_empty() {
            return Err(Error::NoTriangle {
                triangles: triangles.len(),
            });
        }

        let mut live = vec![false; positions.len()];
        kept.triangles.iter().flatten().for_each(|&v| live[v as usize] = true);
        let mut solver_from_render = vec![NONE; positions.len()];
        let mut solver_positions = Vec::new();
        // A representative is the first of its class, so its number is set before any other member asks for it.
        for (v, &r) in representative.iter().enumerate() {
            if !live[r as usize] {
                continue;
            }
            if r as usize == v {
                solver_from_render[v] = solver_positions.len() as u32;
                solver_positions.push(positions[v]);
            } else {
                solver_from_render[v] = solver_from_render[r as usize];
            }
        }
        solver_positions.shrink_to_fit();
        let render_from_solver = Lists::gather(solver_positions.len(), || {
            solver_from_render
                .iter()
                .zip(0u32..)
                .filter(|&(&s, _)| s != NONE)
                .map(|(&s, render)| (s, render))
        });
        Ok(Self {
            inexact_vertices: inexact_vertices(positions, &solver_from_render, &solver_positions),
            positions: solver_positions,
            triangles: kept
                .triangles
                .iter()
                .map(|t| t.map(|v| solver_from_render[v as usize]))
                .collect(),
            source_triangle: kept.source,
            collapsed_triangles: kept.collapsed,
            duplicate_triangles: kept.duplicate,
            solver_from_render,
            render_from_solver,
        })
    }

    /// A mesh whose welding is already known: `solver_from_render` numbers the solver vertices below `vertices`, each a
    /// corner of some triangle, and no triangle has a corner twice. Nothing is welded, dropped or renumbered.
    ///
    /// # Errors
    /// [`Error`] when an index is out of range, a used position is not finite or outside the range of `f32`, there are
    /// more than 32-bit indices can name, or there is no face.
    pub fn of_points(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        solver_from_render: Vec<u32>,
        vertices: usize,
    ) -> Result<Self, Error> {
        check_counts(positions, triangles)?;
        if triangles.is_empty() {
            return Err(Error::NoTriangle { triangles: 0 });
        }
        used_vertices(positions, triangles)?;
        let mut solver_positions = vec![DVec3::ZERO; vertices];
        // The first render vertex of each speaks for it.
        for (&s, &p) in solver_from_render
            .iter()
            .zip(positions)
            .rev()
            .filter(|(s, _)| **s != NONE)
        {
            solver_positions[s as usize] = p;
        }
        let render_from_solver = Lists::gather(vertices, || {
            solver_from_render
                .iter()
                .zip(0u32..)
                .filter(|&(&s, _)| s != NONE)
                .map(|(&s, render)| (s, render))
        });
        Ok(Self {
            inexact_vertices: inexact_vertices(positions, &solver_from_render, &solver_positions),
            positions: solver_positions,
            triangles: triangles
                .iter()
                .map(|t| t.map(|v| solver_from_render[v as usize]))
                .collect(),
            source_triangle: (0..triangles.len() as u32).collect(),
            collapsed_triangles: Vec::new(),
            duplicate_triangles: Vec::new(),
            solver_from_render,
            render_from_solver,
        })
    }

    /// The render vertices at one solver vertex, in rising order, at least one.
    ///
    /// # Panics
    /// When `solver` is not a solver vertex.
    pub fn render_vertices_of(&self, solver: u32) -> &[u32] {
        self.render_from_solver.of(solver)
    }

    /// Of positions of render vertices those of the solver's vertices.
    ///
    /// # Panics
    /// When there are fewer positions than the model has.
    pub fn welded(&self, positions: &[DVec3]) -> Vec<DVec3> {
        let of = |s: u32| positions[self.render_vertices_of(s)[0] as usize];
        (0..self.positions.len() as u32).map(of).collect()
    }

    /// All lists of render vertices, one row per solver vertex.
    pub fn render_from_solver(&self) -> &Lists {
        &self.render_from_solver
    }

    /// The smallest box around the solver vertices.
    pub fn bounds(&self) -> BoundingBox {
        BoundingBox::of(&self.positions)
    }

    /// The median of the lengths of the triangles' first edges; 0 without any.
    pub fn median_edge(&self) -> f64 {
        let length = |t: &[u32; 3]| self.positions[t[0] as usize].distance(self.positions[t[1] as usize]);
        let mut lengths: Vec<f64> = self.triangles.iter().map(length).collect();
        let middle = lengths.len() / 2;
        match lengths.is_empty() {
            true => 0.0,
            false => *lengths.select_nth_unstable_by(middle, f64::total_cmp).1,
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.positions.capacity() * size_of::<DVec3>()
            + self.triangles.capacity() * size_of::<[u32; 3]>()
            + (self.solver_from_render.capacity()
                + self.source_triangle.capacity()
                + self.collapsed_triangles.capacity()
                + self.duplicate_triangles.capacity()
                + self.inexact_vertices.capacity())
                * size_of::<u32>()
            + self.render_from_solver.byte_size()
    }
}

/// The render vertices that are not exactly where their solver vertices are, rising.
fn inexact_vertices(positions: &[DVec3], solver_from_render: &[u32], solver: &[DVec3]) -> Vec<u32> {
    let welded = (0u32..).zip(positions.iter().zip(solver_from_render));
    let inexact = welded.filter(|(_, (p, s))| **s != NONE && **p != solver[**s as usize]);
    inexact.map(|(v, _)| v).collect()
}

/// Refuses more vertices or triangles than lists can number: six entries a triangle (both directions of each edge) must be
/// countable with 32 bits.
fn check_counts(positions: &[DVec3], triangles: &[[u32; 3]]) -> Result<(), Error> {
    let limit = u64::from(NONE / 6);
    for (what, seen) in [("vertices", positions.len()), ("triangles", triangles.len())] {
        let seen = seen as u64;
        if seen > limit {
            return Err(Error::TooLarge { what, seen, limit });
        }
    }
    Ok(())
}

/// Which vertices some triangle names; checks indices and the positions of those.
fn used_vertices(positions: &[DVec3], triangles: &[[u32; 3]]) -> Result<Vec<bool>, Error> {
    let mut used = vec![false; positions.len()];
    for (triangle, corners) in triangles.iter().enumerate() {
        for &index in corners {
            let Some(used) = used.get_mut(index as usize) else {
                let count = positions.len();
                let problem = format!("names vertex {index}, there are {count} vertices, counted from 0");
                return Err(Error::invalid(format!("triangle {triangle}"), problem));
            };
            *used = true;
        }
    }
    let limit = f64::from(f32::MAX);
    let is_lost = |(p, used): (&DVec3, &bool)| *used && !p.abs().cmple(DVec3::splat(limit)).all();
    match positions.iter().zip(&used).position(is_lost) {
        Some(vertex) => Err(Error::invalid(
            format!("vertex {vertex}"),
            format!(
                "lies at {}, each coordinate must be a finite number within ±{:e}",
                positions[vertex],
                f32::MAX
            ),
        )),
        None => Ok(used),
    }
}

struct CleanTriangles {
    triangles: Vec<[u32; 3]>,
    source: Vec<u32>,
    collapsed: Vec<u32>,
    duplicate: Vec<u32>,
}

/// Replaces corners by their representatives and drops faces with a repeated corner or with the corners of an earlier
/// face.
fn clean(triangles: &[[u32; 3]], representative: &[u32]) -> CleanTriangles {
    let welded = |t: usize| triangles[t].map(|v| representative[v as usize]);
    let collapsed_at = |t: usize| {
        let [a, b, c] = welded(t);
        a == b || b == c || c == a
    };
    let collapsed: Vec<u32> = (0..triangles.len())
        .filter(|&t| collapsed_at(t))
        .map(|t| t as u32)
        .collect();
    // Faces with the same corners share the smallest one, so looking through each vertex's own short list finds them.
    let smallest = Lists::gather(representative.len(), || {
        (0..triangles.len()).filter(|&t| !collapsed_at(t)).map(|t| {
            let [a, b, c] = welded(t);
            (a.min(b).min(c), t as u32)
        })
    });
    let mut is_duplicate = vec![false; triangles.len()];
    let mut row: Vec<([u32; 3], u32)> = Vec::new();
    for v in 0..representative.len() as u32 {
        let faces = smallest.of(v);
        if faces.len() < 2 {
            continue;
        }
        row.clear();
        row.extend(faces.iter().map(|&t| {
            let mut corners = welded(t as usize);
            corners.sort_unstable();
            (corners, t)
        }));
        row.sort_unstable();
        for pair in row.windows(2) {
            is_duplicate[pair[1].1 as usize] = pair[0].0 == pair[1].0;
        }
    }
    let source: Vec<u32> = (0..triangles.len())
        .filter(|&t| !is_duplicate[t] && !collapsed_at(t))
        .map(|t| t as u32)
        .collect();
    CleanTriangles {
        triangles: source.iter().map(|&t| welded(t as usize)).collect(),
        duplicate: (0..triangles.len() as u32)
            .filter(|&t| is_duplicate[t as usize])
            .collect(),
        source,
        collapsed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(p: &[[f64; 3]]) -> Vec<DVec3> {
        p.iter().copied().map(DVec3::from_array).collect()
    }

    #[test]
    fn seams_weld_and_unused_vertices_have_no_solver_vertex() {
        // Two faces of a quad with the shared edge split, one unused vertex, in render order 0..=6.
        let p = points(&[
            [9., 9., 9.],
            [0., 0., 0.],
            [1., 0., 0.],
            [1., 1., 0.],
            [0., 0., 0.],
            [1., 1., 0.],
            [0., 1., 0.],
        ]);
        let mesh = Mesh::build(&p, &[[1, 2, 3], [4, 5, 6]], Weld::Exact).expect("a quad");
        assert_eq!(mesh.solver_from_render, [NONE, 0, 1, 2, 0, 2, 3]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.render_vertices_of(0), [1, 4]);
        assert_eq!(mesh.positions[3], p[6]);
    }

    #[test]
    fn collapsed_and_repeated_faces_are_dropped_and_named() {
        let p = points(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 0., 0.], [5., 5., 5.]]);
        let faces = [[0, 1, 1], [0, 1, 2], [2, 3, 0], [1, 3, 4], [2, 1, 0]];
        let mesh = Mesh::build(&p, &faces, Weld::Exact).expect("one face is left");
        assert_eq!((mesh.triangles.len(), mesh.source_triangle.as_slice()), (1, &[1][..]));
        assert_eq!(mesh.collapsed_triangles, [0, 3]);
        assert_eq!(mesh.duplicate_triangles, [2, 4]);
        assert_eq!(mesh.solver_from_render, [0, 1, 2, 1, NONE]);
    }

    #[test]
    fn refusals_say_where_and_what() {
        let p = points(&[
            [0., 0., 0.],
            [f64::NAN, 0., 0.],
            [0., 1., 0.],
            [1e39, 0., 0.],
            [1., 0., 0.],
        ]);
        let text = |faces: &[[u32; 3]], weld| Mesh::build(&p, faces, weld).expect_err("refused").to_string();
        assert!(text(&[[0, 2, 4], [0, 9, 2]], Weld::Exact).contains("triangle 1: names vertex 9, there are 5"));
        assert!(text(&[[0, 1, 2]], Weld::Exact).starts_with("vertex 1: lies at [NaN, 0, 0]"));
        assert!(text(&[[0, 3, 2]], Weld::Exact).starts_with("vertex 3: lies at"));
        assert!(text(&[[0, 2, 4]], Weld::Tolerance(-1.0)).contains("weld tolerance: is -1"));
        assert!(text(&[[0, 2, 4]], Weld::Tolerance(10.0)).contains("none of 1 triangles"));
        assert!(text(&[], Weld::Exact).contains("none of 0 triangles"));
        assert!(
            Mesh::build(&p, &[[0, 2, 4]], Weld::Exact).is_ok(),
            "a position that no face uses may be anything"
        );
    }
}
