//! Targets of vertices: lists of little-endian 32-bit floats, and values of the engine.

use super::{Error, pb};
use pliant_core::engine::VertexTargets;
use prost::bytes::Bytes;

/// The largest weight.
const HEAVIEST: f32 = 1e6;

/// The little-endian 32-bit floats x, y, z of points: finite, 12 bytes each.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`.
pub(super) fn float_points(bytes: &[u8], field: &str) -> Result<Vec<[f32; 3]>, Error> {
    float_points_from(bytes, field, 0)
}

/// The same of a part of a list that begins at an entry.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`, by its number in the whole list.
pub(super) fn float_points_from(bytes: &[u8], field: &str, first: u32) -> Result<Vec<[f32; 3]>, Error> {
    let (places, rest) = bytes.as_chunks::<12>();
    if !rest.is_empty() {
        let problem = format!(
            "has {} bytes, which are no 32-bit floats x, y, z: 12 bytes a vertex are allowed",
            bytes.len()
        );
        return Err(Error::invalid(field, problem));
    }
    let place =
        |bytes: &[u8; 12]| [0, 4, 8].map(|k| f32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]));
    let places: Vec<[f32; 3]> = places.iter().map(place).collect();
    if let Some(k) = places.iter().flatten().position(|v| !v.is_finite()) {
        let ([vertex, axis], value) = ([first as usize + k / 3, k % 3], places[k / 3][k % 3]);
        let problem = format!("has {} = {value}, allowed are finite numbers", ["x", "y", "z"][axis]);
        return Err(Error::invalid(format!("{field}[{vertex}]"), problem));
    }
    Ok(places)
}

/// Reads targets. Whether there are as many as the handle has vertices depends on the model.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`.
pub(super) fn vertex_targets(message: &pb::VertexTargets, field: &str) -> Result<VertexTargets, Error> {
    let at = |name: &str| format!("{field}.{name}");
    let places = float_points(&message.positions, &at("positions"))?;
    let (weights, rest) = message.weights.as_chunks::<4>();
    if !rest.is_empty() {
        let problem = format!(
            "has {} bytes, which are no 32-bit floats: 4 bytes a vertex are allowed",
            message.weights.len()
        );
        return Err(Error::invalid(at("weights"), problem));
    }
    let normals = float_points(&message.normals, &at("normals"))?;
    if places.is_empty() && weights.is_empty() && normals.is_empty() {
        return Err(Error::invalid(
            field,
            "has neither positions nor weights nor normals; one of them is needed",
        ));
    }
    let is_for_all = weights.len() == 1 && message.first.is_none();
    if !places.is_empty() && !weights.is_empty() && places.len() != weights.len() && !is_for_all {
        let problem = format!("has {} entries, but positions has {}", weights.len(), places.len());
        return Err(Error::invalid(at("weights"), problem));
    }
    let others = [
        ("positions", places.len()),
        ("weights", if is_for_all { 0 } else { weights.len() }),
    ];
    if let Some((name, count)) = others
        .iter()
        .find(|(_, n)| *n != 0 && !normals.is_empty() && *n != normals.len())
    {
        let problem = format!("has {} entries, but {name} has {count}", normals.len());
        return Err(Error::invalid(at("normals"), problem));
    }
    let number = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
    let targets = VertexTargets {
        first: message.first,
        positions: places,
        weights: weights.iter().map(number).collect(),
        normals,
    };
    if let Some(k) = targets.weights.iter().position(|w| !(0.0..=HEAVIEST).contains(w)) {
        let problem = format!("is {}, allowed are 0 to {HEAVIEST:e}", targets.weights[k]);
        return Err(Error::invalid(at(&format!("weights[{k}]")), problem));
    }
    Ok(targets)
}

/// Writes targets; numbers are as they were read.
pub(super) fn vertex_targets_message(targets: &VertexTargets) -> pb::VertexTargets {
    let bytes = |numbers: &mut dyn Iterator<Item = f32>| -> Bytes {
        let all: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
        all.into()
    };
    pb::VertexTargets {
        positions: bytes(&mut targets.positions.iter().flatten().copied()),
        weights: bytes(&mut targets.weights.iter().copied()),
        normals: bytes(&mut targets.normals.iter().flatten().copied()),
        first: targets.first,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floats(numbers: &[f32]) -> Bytes {
        let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
        bytes.into()
    }

    #[test]
    fn wrong_targets_are_refused_with_their_field() {
        let refused = |positions: Bytes, weights: Bytes, field: &str| {
            let message = pb::VertexTargets {
                positions,
                weights,
                ..Default::default()
            };
            match vertex_targets(&message, "t") {
                Err(Error::Invalid { field: f, .. }) => assert_eq!(f, field),
                other => panic!("{field}: {other:?}"),
            }
        };
        let (none, two) = (Bytes::new(), floats(&[0.0; 6]));
        refused(none.clone(), none.clone(), "t");
        refused(vec![0; 13].into(), none.clone(), "t.positions");
        refused(none.clone(), vec![0; 3].into(), "t.weights");
        refused(two.clone(), floats(&[1.0, 1.0, 1.0]), "t.weights");
        refused(
            floats(&[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0]),
            none.clone(),
            "t.positions[1]",
        );
        refused(two.clone(), floats(&[1.0, -1.0]), "t.weights[1]");
        refused(two.clone(), floats(&[f32::INFINITY, 1.0]), "t.weights[0]");
        refused(none, floats(&[f32::NAN]), "t.weights[0]");
    }

    #[test]
    fn targets_come_back_as_they_were_written() {
        let targets = VertexTargets {
            first: Some(7),
            positions: vec![[1.5, -0.0, 3.0e38], [0.1, 0.2, 0.3]],
            weights: vec![0.0, 0.3],
            normals: vec![[0.0, 0.0, 2.0], [0.0; 3]],
        };
        assert_eq!(
            vertex_targets(&vertex_targets_message(&targets), "t").as_ref(),
            Ok(&targets)
        );
    }
}
