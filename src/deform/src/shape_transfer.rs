//! What one surface does, done by another with the same triangles: deformation transfer (Sumner and Popović 2004).
//!
//! A shape of the source turns and stretches each of its triangles. The other surface is looked for whose triangles do the same, in
//! the sense of least squares over its area. For maps that are linear on each triangle that is a sum over the edges of triangles,
//! each weighed by half the cotangent of the angle across it (Pinkall and Polthier 1993): equation (8) of the paper on the surface, with
//! the gradients of triangles in place of local frames. Weights below zero, of obtuse angles, are raised, so that slivers of either
//! surface cannot turn the sum over; where the other surface is the source itself the shape comes out as it is whatever the weights.
//!
//! What does not move in the source is fixed, so each shape is solved where it moves alone. All shapes share the graph and its
//! hierarchy.

use crate::error::Error;
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_mesh::rotation::{fit_rotation, outer_product};
use pliant_mesh::shading::area_gradient;
use pliant_mesh::{Adjacency, Mesh};
use pliant_solver::{
    BuildOptions, Constraints, Hierarchy, InitialGuess, SolveControl, SolveOptions, WeightedGraph, Workspace,
};

/// Half cotangents that weights stay between.
const WEIGHTS: [f64; 2] = [0.02, 10.0];
/// A vertex that a shape moves by less than this share of its largest move stays.
const STILL: f64 = 1e-4;
/// How far the solver may stay from the exact solution, in shares of the largest move.
const ACCURACY: f64 = 1e-4;

/// Two surfaces of the same triangles, between which shapes are carried.
pub struct ShapeTransfer<'a> {
    source: &'a Mesh,
    /// Where the vertices of the source are on the other surface.
    other: &'a [DVec3],
    hierarchy: Hierarchy,
    /// By triangle, the weights of its edges, each against the corner across it.
    weights: Vec<[f64; 3]>,
    /// How the other surface is turned as a whole, and how many times as large it is.
    turn: DMat3,
    scale: f64,
    workspace: Workspace,
}

impl<'a> ShapeTransfer<'a> {
    /// Prepares: weighs the edges of `other`, one place for each vertex of the source.
    ///
    /// # Errors
    /// Those of the solver; [`Error::Cancelled`].
    pub fn between(source: &'a Mesh, other: &'a [DVec3], exec: &Exec<'_>) -> Result<Self, Error> {
        let weights: Vec<[f64; 3]> = source
            .triangles
            .iter()
            .map(|t| half_cotangents(t.map(|v| other[v as usize])))
            .collect();
        let hierarchy = build_hierarchy(source, other, &weights, exec)?;
        let (turn, scale) = alignment(&source.positions, other);
        Ok(Self {
            source,
            other,
            hierarchy,
            weights,
            turn,
            scale,
            workspace: Workspace::default(),
        })
    }

    /// How far a shape that moves the source's vertices by `moves` moves those of the other surface. Vertices that do not move in
    /// the source do not move at all.
    ///
    /// # Errors
    /// Those of the solver; [`Error::Cancelled`].
    pub fn carry(&mut self, moves: &[DVec3], exec: &Exec<'_>) -> Result<Vec<DVec3>, Error> {
        let largest = moves.iter().map(|m| m.length()).fold(0.0, f64::max);
        let still: Vec<bool> = moves.iter().map(|m| m.length() <= STILL * largest).collect();
        // Where nothing of a part stays, the solver keeps the mean of the start.
        let start = |(moves, still): (&DVec3, &bool)| match still {
            true => DVec3::ZERO,
            false => self.turn * *moves * self.scale,
        };
        let mut solution: Vec<f64> = moves.iter().zip(&still).flat_map(|one| start(one).to_array()).collect();
        if largest > 0.0 {
            let rhs = self.wanted_differences(moves, &still);
            let constraints = Constraints {
                fixed: &still,
                stiffness: None,
            };
            let system = self.hierarchy.constrain(&constraints, exec.pool)?;
            let options = SolveOptions {
                start: InitialGuess::Given,
                tolerance: None,
                max_error: Some(ACCURACY * largest * self.scale),
                ..SolveOptions::default()
            };
            let equations = system.equations(&self.hierarchy, 3, &rhs);
            equations.solve(&mut solution, &options, &mut self.workspace, exec, &mut |_| {
                SolveControl::Continue
            })?;
        }
        let places = solution.as_chunks::<3>().0.iter();
        Ok(places.map(|p| DVec3::from_array(*p)).collect())
    }

    /// The right-hand side: what the gradients of the source make of the edges of the other surface, summed by vertex.
    fn wanted_differences(&self, moves: &[DVec3], still: &[bool]) -> Vec<f64> {
        let mut sums = vec![DVec3::ZERO; moves.len()];
        for (t, weights) in self.source.triangles.iter().zip(&self.weights) {
            let corners = t.map(|v| v as usize);
            if corners.iter().all(|v| still[*v]) {
                continue;
            }
            let before = corners.map(|v| self.source.positions[v]);
            let after = corners.map(|v| self.source.positions[v] + if still[v] { DVec3::ZERO } else { moves[v] });
            let area = (before[1] - before[0]).cross(before[2] - before[0]).length();
            let Some(gradient) = area_gradient(before, after) else {
                continue;
            };
            let change = self.turn * (gradient * (1.0 / area) - DMat3::IDENTITY) * self.turn.transpose();
            for (k, weight) in weights.iter().enumerate() {
                let (i, j) = (corners[(k + 1) % 3], corners[(k + 2) % 3]);
                let wanted = change * (self.other[i] - self.other[j]) * *weight;
                sums[i] += wanted;
                sums[j] -= wanted;
            }
        }
        sums.iter().flat_map(|s| s.to_array()).collect()
    }
}

/// Half the cotangents of the angles at the corners of a triangle, raised where they are below zero.
fn half_cotangents(p: [DVec3; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| {
        let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
        let half = 0.5 * a.dot(b) / a.cross(b).length();
        match half.is_finite() {
            true => half.clamp(WEIGHTS[0], WEIGHTS[1]),
            false => WEIGHTS[0],
        }
    })
}

fn build_hierarchy(source: &Mesh, other: &[DVec3], weights: &[[f64; 3]], exec: &Exec<'_>) -> Result<Hierarchy, Error> {
    let neighbours = Adjacency::build(other.len(), &source.triangles).neighbours;
    let mut sums = vec![0.0f64; neighbours.items().len()];
    let place = |i: u32, j: u32| {
        let found = neighbours.of(i).binary_search(&j).ok();
        found.map(|k| neighbours.offsets()[i as usize] as usize + k)
    };
    for (t, weights) in source.triangles.iter().zip(weights) {
        for (k, weight) in weights.iter().enumerate() {
            let (i, j) = (t[(k + 1) % 3], t[(k + 2) % 3]);
            for at in [place(i, j), place(j, i)].into_iter().flatten() {
                sums[at] += weight;
            }
        }
    }
    let edge_weights: Vec<f32> = sums.iter().map(|w| *w as f32).collect();
    let positions: Vec<[f64; 3]> = other.iter().map(|p| p.to_array()).collect();
    let graph = WeightedGraph {
        offsets: neighbours.offsets(),
        neighbours: neighbours.items(),
        weights: Some(&edge_weights),
        positions: Some(&positions),
    };
    Ok(Hierarchy::build(&graph, &BuildOptions::default(), exec)?)
}

/// The rotation and the scale that take points nearest to others (Horn 1987).
fn alignment(from: &[DVec3], to: &[DVec3]) -> (DMat3, f64) {
    let mean = |of: &[DVec3]| of.iter().sum::<DVec3>() / of.len().max(1) as f64;
    let (a, b) = (mean(from), mean(to));
    let mut cross = DMat3::ZERO;
    let mut squares = [0.0; 2];
    for (p, q) in from.iter().zip(to) {
        cross += outer_product(*q - b, *p - a);
        squares[0] += (*p - a).length_squared();
        squares[1] += (*q - b).length_squared();
    }
    let scale = (squares[1] / squares[0]).sqrt();
    let turn = DMat3::from_quat(fit_rotation(cross));
    (turn, if scale.is_finite() { scale } else { 1.0 })
}
