//! Guides: a curve, a lattice or a cage whose new shape says where vertices are wanted.
//!
//! A guide is bound to vertices once, in the rest pose. Each pose of it then gives a place for every vertex, which handles take as
//! targets. A guide in its rest shape gives the rest positions bit for bit.

mod cage;
mod curve;
mod lattice;
mod pose;

use crate::error::Error;
use cage::CageWeights;
use curve::CurvePlaces;
use glam::DVec3;
use lattice::LatticePlaces;
use pliant_exec::Exec;
use pose::finite;
pub use pose::{GuidePose, GuideProblem};

/// What leads vertices, in its rest shape. Places are in model space.
#[derive(Debug, Clone, PartialEq)]
pub enum Guide {
    /// A smooth curve through points. A vertex keeps its offset from the nearest point of the curve, in a frame carried along it.
    Curve {
        /// At least 2, no two in a row at one place.
        points: Vec<DVec3>,
        /// Whether a vertex keeps its distance along the curve from the first point. Otherwise it keeps its share of the length.
        keeps_length: bool,
    },
    /// A box of control points with cubic B-splines between them (free-form deformation: Sederberg and Parry 1986).
    Lattice {
        /// The corner of the box from which control points are counted.
        origin: DVec3,
        /// The edges of the box from there, not in one plane.
        edges: [DVec3; 3],
        /// How many control points there are along each edge, at least 2. Those along the first edge follow each other.
        counts: [u32; 3],
    },
    /// A closed triangle mesh around the vertices, by mean value coordinates (Ju, Schaefer and Warren 2005).
    Cage {
        /// Places of its vertices.
        positions: Vec<DVec3>,
        /// Corners counter-clockwise from outside; every edge lies in two triangles.
        triangles: Vec<[u32; 3]>,
    },
}

/// A guide that is bound to vertices.
#[derive(Debug, Clone)]
pub struct BoundGuide {
    rest: Vec<DVec3>,
    binding: Binding,
}

#[derive(Debug, Clone)]
enum Binding {
    Curve(CurvePlaces),
    Lattice(LatticePlaces),
    Cage(CageWeights),
}

impl Guide {
    /// Checks the guide, which is to lead so many vertices.
    ///
    /// # Errors
    /// The field below the guide and what is wrong with it.
    pub fn check(&self, vertices: usize) -> Result<(), GuideProblem> {
        match self {
            Guide::Curve { points, .. } => curve::check_points(points, "curve.points"),
            Guide::Lattice { origin, edges, counts } => lattice::check(*origin, edges, *counts),
            Guide::Cage { positions, triangles } => cage::check(positions, triangles, vertices),
        }
    }

    /// Bytes that the guide will hold once it is bound to so many vertices.
    pub fn bound_bytes(&self, vertices: usize) -> usize {
        let each = match self {
            Guide::Curve { .. } => size_of::<f64>() + size_of::<DVec3>(),
            Guide::Lattice { .. } => size_of::<Option<DVec3>>(),
            Guide::Cage { positions, .. } => size_of::<f32>() * positions.len(),
        };
        vertices.saturating_mul(each + size_of::<DVec3>())
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        let lists = match self {
            Guide::Curve { points, .. } => size_of_val(&points[..]),
            Guide::Lattice { .. } => 0,
            Guide::Cage { positions, triangles } => size_of_val(&positions[..]) + size_of_val(&triangles[..]),
        };
        size_of::<Self>() + lists
    }

    /// About how many points are looked at for each vertex that it leads.
    pub fn cost(&self) -> u64 {
        match self {
            Guide::Curve { .. } => 16,
            Guide::Lattice { .. } => 1,
            Guide::Cage { triangles, .. } => triangles.len() as u64,
        }
    }

    /// Binds the guide, which has been checked, to vertices at their rest positions.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn bind(&self, rest: Vec<DVec3>, exec: &Exec<'_>) -> Result<BoundGuide, Error> {
        let binding = match self {
            Guide::Curve { points, keeps_length } => {
                Binding::Curve(CurvePlaces::bind(points, *keeps_length, &rest, exec)?)
            }
            Guide::Lattice { origin, edges, counts } => {
                Binding::Lattice(LatticePlaces::bind(*origin, *edges, *counts, &rest))
            }
            Guide::Cage { positions, triangles } => {
                Binding::Cage(CageWeights::bind(positions, triangles, &rest, exec)?)
            }
        };
        Ok(BoundGuide { rest, binding })
    }
}

impl BoundGuide {
    /// Checks a pose.
    ///
    /// # Errors
    /// The field of the pose and what is wrong with it.
    pub fn check(&self, pose: &GuidePose) -> Result<(), GuideProblem> {
        let (controls, name) = match &self.binding {
            Binding::Curve(_) => {
                curve::check_points(&pose.positions, "positions")?;
                return curve::check_values(pose);
            }
            Binding::Lattice(lattice) => (lattice.controls(), "lattice"),
            Binding::Cage(cage) => (cage.controls(), "cage"),
        };
        if pose.positions.len() != controls {
            let problem = format!("has {} places, but the {name} has {controls}", pose.positions.len());
            return Err(GuideProblem::new("positions", problem));
        }
        for (name_of_list, list) in [("twists", &pose.twists), ("scales", &pose.scales)] {
            if !list.is_empty() {
                return Err(GuideProblem::new(
                    name_of_list,
                    format!("is for curves, and this guide is a {name}"),
                ));
            }
        }
        finite(&pose.positions, "positions")
    }

    /// Where they are wanted in the rest shape.
    pub fn rest_places(&self) -> Vec<Option<DVec3>> {
        match &self.binding {
            Binding::Lattice(lattice) => lattice.rest_places(&self.rest),
            Binding::Curve(_) | Binding::Cage(_) => self.rest.iter().copied().map(Some).collect(),
        }
    }

    /// Where the vertices are wanted for a pose that has been checked; `None` for those that the guide does not lead.
    pub fn places(&self, pose: &GuidePose, exec: &Exec<'_>) -> Vec<Option<DVec3>> {
        match &self.binding {
            Binding::Curve(curve) => curve.places(&self.rest, pose, exec),
            Binding::Lattice(lattice) => lattice.places(&self.rest, &pose.positions, exec),
            Binding::Cage(cage) => cage.places(&self.rest, &pose.positions, exec),
        }
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        let binding = match &self.binding {
            Binding::Curve(curve) => curve.byte_size(),
            Binding::Lattice(lattice) => lattice.byte_size(),
            Binding::Cage(cage) => cage.byte_size(),
        };
        size_of_val(&self.rest[..]) + binding
    }
}

#[cfg(test)]
mod tests;
