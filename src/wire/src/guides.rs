//! Guides and their shapes: lists of numbers, and values of the engine, which checks what the model decides.

use super::check::{points, vector};
use super::{Error, pb};
use glam::DVec3;
use pliant_core::engine::{Guide, GuidePose};
use std::sync::Arc;

/// Points of a guide or its shape at most.
const MOST_POINTS: usize = 1 << 16;

/// Reads a guide.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`.
pub(super) fn guide(message: Option<&pb::Guide>, field: &str) -> Result<Option<Arc<Guide>>, Error> {
    use pb::guide::Shape;
    let Some(message) = message else { return Ok(None) };
    let Some(shape) = &message.shape else {
        return Err(Error::invalid(
            field,
            "has none of curve, lattice and cage; one of them is needed",
        ));
    };
    let at = |name: &str| format!("{field}.{name}");
    let guide = match shape {
        Shape::Curve(curve) => Guide::Curve {
            points: places(&curve.points, &at("curve.points"))?,
            keeps_length: curve.keep_length,
        },
        Shape::Lattice(lattice) => {
            let edges = places(&lattice.edges, &at("lattice.edges"))?;
            let Ok(edges) = <[DVec3; 3]>::try_from(edges) else {
                let problem = format!("has {} numbers; three edges have 9", lattice.edges.len());
                return Err(Error::invalid(at("lattice.edges"), problem));
            };
            let Ok(counts) = <[u32; 3]>::try_from(&lattice.counts[..]) else {
                let problem = format!("has {} numbers; three edges have 3", lattice.counts.len());
                return Err(Error::invalid(at("lattice.counts"), problem));
            };
            Guide::Lattice {
                origin: vector(&lattice.origin, &at("lattice.origin"))?,
                edges,
                counts,
            }
        }
        Shape::Cage(cage) => {
            let (triangles, rest) = cage.triangles.as_chunks::<3>();
            if !rest.is_empty() {
                let problem = format!("has {} numbers; a triangle has three", cage.triangles.len());
                return Err(Error::invalid(at("cage.triangles"), problem));
            }
            Guide::Cage {
                positions: places(&cage.positions, &at("cage.positions"))?,
                triangles: triangles.to_vec(),
            }
        }
    };
    Ok(Some(Arc::new(guide)))
}

/// Writes a guide; numbers are as they were read.
pub(super) fn guide_message(guide: &Guide) -> pb::Guide {
    use pb::guide::{Cage, Curve, Lattice, Shape};
    let shape = match guide {
        Guide::Curve { points, keeps_length } => Shape::Curve(Curve {
            points: numbers(points),
            keep_length: *keeps_length,
        }),
        Guide::Lattice { origin, edges, counts } => Shape::Lattice(Lattice {
            origin: numbers(&[*origin]),
            edges: numbers(edges),
            counts: counts.to_vec(),
        }),
        Guide::Cage { positions, triangles } => Shape::Cage(Cage {
            positions: numbers(positions),
            triangles: triangles.as_flattened().to_vec(),
        }),
    };
    pb::Guide { shape: Some(shape) }
}

/// Reads the shape of a guide.
///
/// # Errors
/// As [`guide`].
pub(super) fn guide_pose(message: &pb::GuidePose, field: &str) -> Result<GuidePose, Error> {
    Ok(GuidePose {
        positions: places(&message.positions, &format!("{field}.positions"))?,
        twists: message.twists.clone(),
        scales: message.scales.clone(),
    })
}

/// Writes the shape of a guide; numbers are as they were read.
pub(super) fn guide_pose_message(pose: &GuidePose) -> pb::GuidePose {
    pb::GuidePose {
        positions: numbers(&pose.positions),
        twists: pose.twists.clone(),
        scales: pose.scales.clone(),
    }
}

fn places(values: &[f64], field: &str) -> Result<Vec<DVec3>, Error> {
    let problem = |seen| format!("has {seen} numbers; three for each of 2 to {MOST_POINTS} points are allowed");
    points(values, 2..=MOST_POINTS, field, problem)
}

fn numbers(places: &[DVec3]) -> Vec<f64> {
    places.iter().flat_map(|p| p.to_array()).collect()
}
