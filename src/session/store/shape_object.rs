//! A shape as an object: a mark, a version, and the exact coordinates of its vertices.

use super::session_store::StoreError;
use bytes::Bytes;
use glam::DVec3;

const MARK: &[u8; 4] = b"PLSH";
const VERSION: u32 = 1;
const HEAD: usize = 8;

/// Writes the positions of a shape.
pub(in crate::session) fn write_shape(positions: &[DVec3]) -> Bytes {
    let mut bytes = Vec::with_capacity(HEAD + positions.len() * 24);
    bytes.extend_from_slice(MARK);
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    for number in positions.iter().flat_map(|p| p.to_array()) {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.into()
}

/// Reads the positions of a shape.
pub(in crate::session) fn read_shape(bytes: &[u8]) -> Result<Vec<DVec3>, StoreError> {
    let damaged = || StoreError::Damaged("a stored shape is not a shape".into());
    let (head, body) = bytes.split_at_checked(HEAD).ok_or_else(damaged)?;
    if &head[..4] != MARK || head[4..] != VERSION.to_le_bytes() || !body.len().is_multiple_of(24) {
        return Err(damaged());
    }
    let number = |b: &[u8]| b.try_into().map(f64::from_le_bytes).unwrap_or(f64::NAN);
    let vertex = |v: &[u8]| DVec3::new(number(&v[..8]), number(&v[8..16]), number(&v[16..]));
    Ok(body.chunks_exact(24).map(vertex).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shape_comes_back_to_the_bit_and_nothing_else_is_one() {
        let shape = [DVec3::new(0.1, -0.0, 1e-310), DVec3::new(f64::MAX, 1.0 / 3.0, 2.0)];
        let bytes = write_shape(&shape);
        let again = read_shape(&bytes).expect("a shape");
        assert!(
            shape
                .iter()
                .zip(&again)
                .all(|(a, b)| { a.to_array().map(f64::to_bits) == b.to_array().map(f64::to_bits) })
        );
        for wrong in [
            &bytes[..7],
            &bytes[..bytes.len() - 1],
            b"PLSH\x02\0\0\0",
            b"XXXX\x01\0\0\0",
            b"",
        ] {
            assert!(read_shape(wrong).is_err());
        }
    }
}
