//! The frames of an animation as the decomposition keeps them: in single precision, turned back onto the rest shape.

use super::joined::JoinedVertices;
use crate::rig::RigidMotion;
use glam::{DMat3, DVec3};
use pliant_exec::progress::Cancelled;
use pliant_mesh::rotation::{fit_rotation, outer_product};

/// Why an animation cannot be decomposed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DecompositionError {
    /// A shape is not one of finite positions, one for each vertex.
    #[error("{what}: {problem}")]
    Shape {
        /// Which: the rest shape, or a frame by its number.
        what: String,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// An option is not what it may be.
    #[error("{option} is {seen}, allowed are {allowed}")]
    Option {
        /// Which.
        option: &'static str,
        /// What it is.
        seen: usize,
        /// What it may be.
        allowed: String,
    },
    /// The caller cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The shapes that a mesh goes through: its rest shape, and frames with a position for each of its vertices.
///
/// Frames are kept in single precision, relative to the rest shape moved along rigidly with them and in units of its size, so
/// that 12 bytes a vertex are exact to 1e-7 of it, however far the animation travels.
#[derive(Debug, Clone)]
pub struct ShapeSequence {
    pub(super) samples: ShapeSamples,
    pub(super) joined: JoinedVertices,
    /// By frame: the motion of the whole shape, in model units.
    pub(super) carried: Vec<RigidMotion>,
    /// Of the rest shape, in model units.
    pub(super) centre: DVec3,
    /// Model units for one unit of the samples: the diagonal of the rest shape's bounding box.
    pub(super) diagonal: f64,
}

/// Some vertices in some frames.
#[derive(Debug, Clone, Default)]
pub(super) struct ShapeSamples {
    /// Rest positions by vertex.
    pub(super) rest: Vec<DVec3>,
    /// Frame after frame, vertex after vertex: x, y, z.
    places: Vec<f32>,
    frames: usize,
}

impl ShapeSamples {
    pub(super) fn vertices(&self) -> usize {
        self.rest.len()
    }

    pub(super) fn frames(&self) -> usize {
        self.frames
    }

    /// x, y, z of all vertices in a frame, one after the other.
    pub(super) fn frame(&self, frame: usize) -> &[f32] {
        let size = 3 * self.rest.len();
        &self.places[frame * size..(frame + 1) * size]
    }

    /// Some vertices in some frames of these.
    pub(super) fn pick(&self, vertices: &[u32], frames: &[usize]) -> Self {
        let mut places = Vec::with_capacity(3 * vertices.len() * frames.len());
        for &frame in frames {
            let all = self.frame(frame);
            for &v in vertices {
                let at = 3 * v as usize;
                places.extend_from_slice(&all[at..at + 3]);
            }
        }
        Self {
            rest: vertices.iter().map(|&v| self.rest[v as usize]).collect(),
            places,
            frames: frames.len(),
        }
    }
}

impl ShapeSequence {
    /// Begins with a rest shape, in model units.
    ///
    /// # Errors
    /// [`DecompositionError::Shape`] without a vertex, or when a position is not finite.
    pub fn new(rest: &[DVec3]) -> Result<Self, DecompositionError> {
        if rest.is_empty() {
            return Err(refused(
                "the rest shape",
                "has no vertex, at least one is needed".into(),
            ));
        }
        check("the rest shape", rest)?;
        let low = rest.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = rest.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let length = (high - low).length();
        let diagonal = if length > 0.0 && length.is_finite() {
            length
        } else {
            1.0
        };
        let centre = rest.iter().sum::<DVec3>() / rest.len() as f64;
        Ok(Self {
            samples: ShapeSamples {
                rest: rest.iter().map(|p| (*p - centre) / diagonal).collect(),
                ..ShapeSamples::default()
            },
            joined: JoinedVertices::default(),
            carried: Vec::new(),
            centre,
            diagonal,
        })
    }

    /// Joins vertices by the triangles of the mesh, so that neighbours get weights that are alike.
    pub fn join(&mut self, triangles: &[[u32; 3]]) {
        self.joined = JoinedVertices::of_triangles(&self.samples.rest, triangles);
    }

    /// Adds a frame: a position for each vertex of the rest shape, in model units.
    ///
    /// # Errors
    /// [`DecompositionError::Shape`] for another number of positions, or when one is not finite.
    pub fn push(&mut self, positions: &[DVec3]) -> Result<(), DecompositionError> {
        let what = || format!("frame {}", self.carried.len());
        let rest = &self.samples.rest;
        if positions.len() != rest.len() {
            let problem = format!("has {} positions, the rest shape has {}", positions.len(), rest.len());
            return Err(refused(&what(), problem));
        }
        check(&what(), positions)?;
        let middle = positions.iter().sum::<DVec3>() / rest.len() as f64;
        let covariance: DMat3 = (rest.iter().zip(positions))
            .map(|(p, x)| outer_product((*x - middle) / self.diagonal, *p))
            .fold(DMat3::ZERO, |a, b| a + b);
        let rotation = fit_rotation(covariance);
        let back = rotation.inverse();
        for x in positions {
            let seen = back * ((*x - middle) / self.diagonal);
            self.samples.places.extend(seen.to_array().map(|c| c as f32));
        }
        self.samples.frames += 1;
        self.carried.push(RigidMotion {
            rotation,
            from: self.centre,
            to: middle,
        });
        Ok(())
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.samples.vertices()
    }

    /// Number of frames so far.
    pub fn frames(&self) -> usize {
        self.samples.frames()
    }

    /// The diagonal of the rest shape's bounding box, in model units; 1 for a single point.
    pub fn diagonal(&self) -> f64 {
        self.diagonal
    }
}

fn refused(what: &str, problem: String) -> DecompositionError {
    DecompositionError::Shape {
        what: what.into(),
        problem,
    }
}

fn check(what: &str, positions: &[DVec3]) -> Result<(), DecompositionError> {
    match positions.iter().position(|p| !p.is_finite()) {
        Some(vertex) => Err(refused(
            what,
            format!("position {vertex} is not a point of finite numbers"),
        )),
        None => Ok(()),
    }
}
