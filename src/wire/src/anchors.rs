//! Points of the surface between three vertices: as messages, and as values of the engine.

use super::{Error, pb};
use pliant_core::engine::{Anchor, AnchorCorners};

/// How far the weights of an anchor may be from 1 together.
const ROUNDED: f32 = 1e-3;

/// Reads anchors. Whether the model has such vertices and triangles depends on the model.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`.
pub(super) fn anchors(message: &pb::region::Anchors, field: &str) -> Result<Vec<Anchor>, Error> {
    let pb::region::Anchors {
        faces,
        corners,
        weights,
    } = message;
    let (between, rest) = corners.as_chunks::<3>();
    let corners: Vec<AnchorCorners> = match (&faces[..], &corners[..]) {
        ([], []) => {
            let problem = "has neither faces nor corners; one of both is needed";
            return Err(Error::invalid(field, problem));
        }
        (faces, []) => faces.iter().map(|face| AnchorCorners::Face(*face)).collect(),
        ([], _) if rest.is_empty() => between.iter().map(|three| AnchorCorners::Vertices(*three)).collect(),
        ([], corners) => {
            let problem = format!("has {} numbers; three for each anchor are allowed", corners.len());
            return Err(Error::invalid(format!("{field}.corners"), problem));
        }
        _ => {
            let problem = "is given beside faces; one of both is allowed";
            return Err(Error::invalid(format!("{field}.corners"), problem));
        }
    };
    let (threes, rest) = weights.as_chunks::<3>();
    if !rest.is_empty() || threes.len() != corners.len() {
        let problem = format!(
            "has {} numbers; three for each of {} anchors are allowed",
            weights.len(),
            corners.len()
        );
        return Err(Error::invalid(format!("{field}.weights"), problem));
    }
    let is_right = |three: &[f32; 3]| {
        three.iter().all(|w| (0.0..=1.0).contains(w)) && (three.iter().sum::<f32>() - 1.0).abs() <= ROUNDED
    };
    if let Some(k) = threes.iter().position(|three| !is_right(three)) {
        let [a, b, c] = threes[k];
        let problem = format!("are {a}, {b}, {c}; allowed are 0 to 1, and together 1");
        return Err(Error::invalid(format!("{field}.weights[{}]", 3 * k), problem));
    }
    let both = corners.into_iter().zip(threes);
    Ok(both.map(|(corners, &weights)| Anchor { corners, weights }).collect())
}

/// Writes anchors, all of them by faces or all by corners.
pub(super) fn anchors_message(anchors: &[Anchor]) -> pb::region::Anchors {
    let mut message = pb::region::Anchors::default();
    for anchor in anchors {
        match anchor.corners {
            AnchorCorners::Face(face) => message.faces.push(face),
            AnchorCorners::Vertices(corners) => message.corners.extend(corners),
        }
        message.weights.extend(anchor.weights);
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_anchors_are_refused_with_their_field() {
        let refused = |faces: &[u32], corners: &[u32], weights: &[f32], field: &str| {
            let message = pb::region::Anchors {
                faces: faces.to_vec(),
                corners: corners.to_vec(),
                weights: weights.to_vec(),
            };
            match anchors(&message, "a") {
                Err(Error::Invalid { field: f, .. }) => assert_eq!(f, field),
                other => panic!("{field}: {other:?}"),
            }
        };
        let half = [0.5, 0.5, 0.0];
        refused(&[], &[], &half, "a");
        refused(&[1], &[1, 2, 3], &half, "a.corners");
        refused(&[], &[1, 2, 3, 4], &half, "a.corners");
        refused(&[1, 2], &[], &half, "a.weights");
        refused(&[1], &[], &[0.5, 0.5], "a.weights");
        refused(&[1, 2], &[], &[0.5, 0.5, 0.0, 0.5, 0.6, 0.0], "a.weights[3]");
        refused(&[1], &[], &[1.5, -0.5, 0.0], "a.weights[0]");
        refused(&[1], &[], &[f32::NAN, 0.5, 0.5], "a.weights[0]");
    }
}
