//! Frames as a client reads them, one part after the other, each after its length.

use pliant::wire::frames::FrameReader;
use pliant::wire::pb;
use prost::Message;

/// Vertices of the model that the frames are of.
pub const VERTICES: usize = 48;

/// Parts that follow one another; what was refused is followed by what may still be read.
pub fn frames(mut bytes: &[u8]) {
    let mut reader = FrameReader::new(VERTICES);
    while let Ok(part) = pb::Frame::decode_length_delimited(&mut bytes) {
        let _ = reader.take(&part);
        let position = pb::frame::Attribute::Position;
        let numbers = reader.numbers(position).len();
        assert!(numbers == 0 || numbers == 3 * VERTICES, "{numbers} numbers");
        if bytes.is_empty() {
            return;
        }
    }
}
