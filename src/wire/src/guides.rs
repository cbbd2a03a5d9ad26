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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::json::from_json;

    #[test]
    fn guides_are_written_as_they_were_read() {
        let flat = |count: u32| (0..3 * count).map(|k| f64::from(k) + 0.1).collect::<Vec<f64>>();
        for shape in [
            r#"{"curve": {"points": [0, 0, 0, 1, 0.1, 2], "keepLength": true}}"#,
            r#"{"lattice": {"origin": [0, 1, 2], "edges": [1, 0, 0, 0, 1, 0, 0, 0, 1], "counts": [2, 3, 4]}}"#,
            r#"{"cage": {"positions": [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1], "triangles": [0, 2, 1, 0, 1, 3]}}"#,
        ] {
            let message: pb::Guide = from_json(shape.as_bytes()).expect("a guide");
            let read = guide(Some(&message), "guide").expect("a guide").expect("it is given");
            assert_eq!(guide_message(&read), message);
        }
        let pose = pb::GuidePose {
            positions: flat(3),
            twists: flat(1),
            scales: flat(1),
        };
        assert_eq!(guide_pose_message(&guide_pose(&pose, "guide").expect("a shape")), pose);
    }

    #[test]
    fn wrong_guides_are_refused_with_their_field() {
        for (shape, field) in [
            ("{}", "guide"),
            (r#"{"curve": {"points": [0, 0, 0, 1]}}"#, "guide.curve.points"),
            (
                r#"{"lattice": {"origin": [0], "edges": [1, 0, 0, 0, 1, 0, 0, 0, 1], "counts": [2, 2, 2]}}"#,
                "guide.lattice.origin",
            ),
            (
                r#"{"lattice": {"origin": [0, 0, 0], "edges": [1, 0, 0, 0, 1, 0], "counts": [2, 2, 2]}}"#,
                "guide.lattice.edges",
            ),
            (
                r#"{"lattice": {"origin": [0, 0, 0], "edges": [1, 0, 0, 0, 1, 0, 0, 0, 1], "counts": [2]}}"#,
                "guide.lattice.counts",
            ),
            (
                r#"{"cage": {"positions": [0, 0, 0, 1, 0, 0], "triangles": [0, 2]}}"#,
                "guide.cage.triangles",
            ),
        ] {
            let message: pb::Guide = from_json(shape.as_bytes()).expect("a message");
            let error = guide(Some(&message), "guide").expect_err("it is wrong");
            assert!(
                matches!(&error, Error::Invalid { field: named, .. } if named == field),
                "{shape}: {error}"
            );
        }
    }
}
