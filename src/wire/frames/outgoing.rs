//! A response of a deform stream whose numbers are written once, into the bytes that are sent.

use super::part::FramePart;
use super::pb::{self, deform_response::Message as Response};
use bytes::{Buf, BufMut};
use prost::encoding::{DecodeContext, WireType, encode_key, encode_varint, encoded_len_varint, key_len};
use prost::{DecodeError, Message};

/// `DeformResponse.frame`.
const FRAME: u32 = 1;
/// `Frame.data`. It is written last: a message's fields may come in any order.
const DATA: u32 = 7;

/// A response as it goes out, in place of [`pb::DeformResponse`]: the bytes of both say the same.
#[derive(Debug)]
pub enum OutgoingResponse {
    /// All but frames.
    Words(Box<pb::DeformResponse>),
    /// A part of a frame.
    Part(Box<FramePart>),
}

impl OutgoingResponse {
    /// A response that says `message`.
    pub fn of(message: Response) -> Self {
        Self::Words(Box::new(pb::DeformResponse { message: Some(message) }))
    }
}

impl From<OutgoingResponse> for pb::DeformResponse {
    fn from(response: OutgoingResponse) -> Self {
        match response {
            OutgoingResponse::Words(words) => *words,
            OutgoingResponse::Part(part) => Self {
                message: Some(Response::Frame(part.into_message())),
            },
        }
    }
}

/// Bytes of the message of a part.
fn frame_bytes(part: &FramePart) -> usize {
    let data = part.data_bytes();
    let told = if data > 0 { delimited_bytes(DATA, data) } else { 0 };
    part.head().encoded_len() + told
}

/// Bytes of a field that holds `bytes` bytes.
fn delimited_bytes(tag: u32, bytes: usize) -> usize {
    key_len(tag) + encoded_len_varint(bytes as u64) + bytes
}

fn open_field(tag: u32, bytes: usize, out: &mut impl BufMut) {
    encode_key(tag, WireType::LengthDelimited, out);
    encode_varint(bytes as u64, out);
}

impl Message for OutgoingResponse {
    fn encode_raw(&self, out: &mut impl BufMut) {
        match self {
            Self::Words(words) => words.encode_raw(out),
            Self::Part(part) => {
                open_field(FRAME, frame_bytes(part), out);
                part.head().encode_raw(out);
                if part.data_bytes() > 0 {
                    open_field(DATA, part.data_bytes(), out);
                    part.write_data(out);
                }
            }
        }
    }

    fn encoded_len(&self) -> usize {
        match self {
            Self::Words(words) => words.encoded_len(),
            Self::Part(part) => delimited_bytes(FRAME, frame_bytes(part)),
        }
    }

    fn merge_field(
        &mut self,
        tag: u32,
        wire_type: WireType,
        bytes: &mut impl Buf,
        context: DecodeContext,
    ) -> Result<(), DecodeError> {
        let mut words = pb::DeformResponse::from(std::mem::take(self));
        let merged = words.merge_field(tag, wire_type, bytes, context);
        *self = Self::Words(Box::new(words));
        merged
    }

    fn clear(&mut self) {
        *self = Self::default();
    }
}

impl Default for OutgoingResponse {
    fn default() -> Self {
        Self::Words(Box::default())
    }
}
