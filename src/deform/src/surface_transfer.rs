//! What one surface does, done by another with the same triangles: deformation transfer (Sumner and Popović 2004).
//!
//! A shape of the source turns and stretches each of its triangles. The other surface is looked for whose triangles do the same, in
//! the sense of least squares over its area. For maps that are linear on each triangle that is a sum over the edges of triangles,
//! each weighed by half the cotangent of the angle across it (Pinkall and Polthier 1993): equation (8) of the paper on the surface, with
//! the gradients of triangles in place of local frames. Weights below zero, of obtuse angles, are raised, so that slivers of either
//! surface cannot turn the sum over; where the other surface is the source itself the shape comes out as it is whatever the weights.
//!
//! The two surfaces stand and are built differently around each place, and what a triangle does is said there by the map from one to the
//! other, averaged over a neighbourhood: F Q F⁻¹ for a gradient Q. Under a smooth map of one surface onto the other that is what the
//! map makes of a small move, to first order; with gradients taken over as they are, shapes of a head keep the directions and the
//! lengths that they have on the other one. Of a pose, which turns limbs far, only the rotation of F is used, for a limb that is
//! thicker turns and does not shear.
//!
//! What does not move in the source is fixed, so each shape is solved where it moves alone. All shapes share the graph and its
//! hierarchy.

use crate::error::Error;
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_mesh::local_turns::nearest_rotation;
use pliant_mesh::rotation::outer_product;
use pliant_mesh::shading::area_gradient;
use pliant_mesh::{Adjacency, Lists, Mesh, surface_area};
use pliant_solver::{
    BuildOptions, Constraints, Hierarchy, InitialGuess, SolveControl, SolveOptions, WeightedGraph, Workspace,
};
use rayon::prelude::*;

/// What the source does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CarriedMotion {
    /// It moves parts of itself a little, as blend shapes do: moves grow and turn with the map to the other surface.
    Shapes,
    /// It bends: only turned by that map.
    Pose,
}

/// Half cotangents that weights stay between.
const WEIGHTS: [f64; 2] = [0.02, 10.0];
/// A vertex that a shape moves by less than this share of its largest move stays.
const STILL: f64 = 1e-4;
/// Maps between the surfaces are averaged with those around them as often as there are vertices along so much of the surface's side.
const NEIGHBOURHOOD: f64 = 0.1;
/// A map that stretches one way by more than about so many times as much as another says nothing, and its rotation counts alone.
const UNEVEN: f64 = 3.0;
/// How far the solver may stay from the exact solution, in shares of the largest move.
const ACCURACY: f64 = 1e-4;

/// Two surfaces of the same triangles, between which shapes are carried.
pub struct SurfaceTransfer<'a> {
    source: &'a Mesh,
    /// Where the vertices of the source are on the other surface.
    other: &'a [DVec3],
    hierarchy: Hierarchy,
    /// By triangle, the weights of its edges, each against the corner across it.
    weights: Vec<[f64; 3]>,
    /// By vertex, what takes a move of the source to one of the other surface.
    maps: Vec<DMat3>,
    /// How many times as large the other surface is.
    scale: f64,
    workspace: Workspace,
}

impl<'a> SurfaceTransfer<'a> {
    /// Prepares: weighs the edges of `other`, one place for each vertex of the source.
    ///
    /// # Errors
    /// Those of the solver; [`Error::Cancelled`].
    pub fn between(
        source: &'a Mesh,
        other: &'a [DVec3],
        motion: CarriedMotion,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let weights: Vec<[f64; 3]> = source
            .triangles
            .iter()
            .map(|t| half_cotangents(t.map(|v| other[v as usize])))
            .collect();
        let neighbours = Adjacency::build(other.len(), &source.triangles).neighbours;
        let hierarchy = build_hierarchy(source, other, &neighbours, &weights, exec)?;
        exec.check()?;
        let areas = [&source.positions[..], other].map(|at| surface_area(at, &source.triangles));
        let scale = (areas[1] / areas[0]).sqrt();
        let scale = if scale.is_finite() && scale > 0.0 { scale } else { 1.0 };
        let mut maps = exec.pool.install(|| averaged_maps(source, other, &neighbours));
        if motion == CarriedMotion::Pose {
            maps.iter_mut().for_each(|map| *map = turn_of(map) * scale);
        }
        Ok(Self {
            source,
            other,
            hierarchy,
            weights,
            maps,
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
        let start = |v: usize| match still[v] {
            true => DVec3::ZERO,
            false => self.maps[v] * moves[v],
        };
        let mut solution: Vec<f64> = (0..moves.len()).flat_map(|v| start(v).to_array()).collect();
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
            let map = corners.iter().fold(DMat3::ZERO, |sum, v| sum + self.maps[*v]);
            let change = map * (gradient * (1.0 / area) - DMat3::IDENTITY) * map.inverse();
            if !change.is_finite() {
                continue;
            }
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

fn build_hierarchy(
    source: &Mesh,
    other: &[DVec3],
    neighbours: &Lists,
    weights: &[[f64; 3]],
    exec: &Exec<'_>,
) -> Result<Hierarchy, Error> {
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

/// By vertex, the linear map from the source to the other surface: that of the triangles around, weighed by their areas, and of those
/// further around. Across the surface it grows as along it.
fn averaged_maps(source: &Mesh, other: &[DVec3], neighbours: &Lists) -> Vec<DMat3> {
    let mut sums = vec![(DMat3::ZERO, 0.0); other.len()];
    for t in &source.triangles {
        let (p, q) = (t.map(|v| source.positions[v as usize]), t.map(|v| other[v as usize]));
        let [n, m] = [p, q].map(|[a, b, c]| (b - a).cross(c - a));
        let Some(along) = area_gradient(p, q) else {
            continue;
        };
        let (before, after) = (n.length(), m.length());
        let across = outer_product(m.normalize_or_zero(), n.normalize_or_zero());
        let map = along + across * (((after / before).sqrt() - 1.0) * before);
        for v in t.map(|v| v as usize).into_iter().filter(|_| map.is_finite()) {
            sums[v].0 += map;
            sums[v].1 += before;
        }
    }
    let rounds = (NEIGHBOURHOOD * (other.len() as f64).sqrt()).ceil() as usize;
    for _ in 0..rounds {
        let around = |v: usize| {
            let own = sums[v];
            let others = neighbours.of(v as u32).iter().map(|n| sums[*n as usize]);
            let sum = others.fold(own, |sum, one| (sum.0 + one.0, sum.1 + one.1));
            // What grows from round to round is scaled back.
            (sum.0 * 0.125, sum.1 * 0.125)
        };
        sums = (0..other.len()).into_par_iter().map(around).collect();
    }
    sums.iter().map(|(sum, area)| even_map(*sum * (1.0 / area))).collect()
}

/// A map, or its rotation and growth where it is too uneven, and nothing where it flattens.
fn even_map(map: DMat3) -> DMat3 {
    let unevenness = frobenius(&map) * frobenius(&map.inverse()) / 3.0;
    let even = match unevenness <= UNEVEN && map.determinant() > 0.0 {
        true => map,
        false => turn_of(&map) * libm::cbrt(map.determinant().abs()),
    };
    match even.is_finite() && even.determinant() > 0.0 {
        true => even,
        false => DMat3::IDENTITY,
    }
}

fn turn_of(map: &DMat3) -> DMat3 {
    nearest_rotation(map).unwrap_or(DMat3::IDENTITY)
}

fn frobenius(m: &DMat3) -> f64 {
    let squares = m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared();
    squares.sqrt()
}
