//! Messages as `prost` writes and reads them, each into one buffer of its size. Bytes that are no message are the fault of who sent them: `INVALID_ARGUMENT`, and not
//! `INTERNAL`, which would be a defect of the server.

use super::status::status;
use crate::session::Error;
use prost::Message;
use tonic::Status;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic_prost::ProstCodec;

/// Encodes `T` and decodes `U`; the generated code names it.
#[derive(Debug)]
pub struct MessageCodec<T, U>(ProstCodec<T, U>);

impl<T, U> Default for MessageCodec<T, U> {
    fn default() -> Self {
        Self(ProstCodec::default())
    }
}

impl<T, U> Codec for MessageCodec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = MessageEncoder<<ProstCodec<T, U> as Codec>::Encoder>;
    type Decoder = MessageDecoder<<ProstCodec<T, U> as Codec>::Decoder>;

    fn encoder(&mut self) -> Self::Encoder {
        MessageEncoder(self.0.encoder())
    }

    fn decoder(&mut self) -> Self::Decoder {
        MessageDecoder(self.0.decoder())
    }
}

/// Makes room for a message before it is written, so that none is moved while it grows.
#[derive(Debug)]
pub struct MessageEncoder<E>(E);

impl<E: Encoder<Error = Status, Item: Message>> Encoder for MessageEncoder<E> {
    type Item = E::Item;
    type Error = Status;

    fn encode(&mut self, message: E::Item, bytes: &mut EncodeBuf<'_>) -> Result<(), Status> {
        bytes.reserve(message.encoded_len());
        self.0.encode(message, bytes)
    }

    fn buffer_settings(&self) -> BufferSettings {
        self.0.buffer_settings()
    }
}

/// Says whose fault it is when bytes are no message.
#[derive(Debug)]
pub struct MessageDecoder<D>(D);

impl<D: Decoder<Error = Status>> Decoder for MessageDecoder<D> {
    type Item = D::Item;
    type Error = Status;

    fn decode(&mut self, bytes: &mut DecodeBuf<'_>) -> Result<Option<Self::Item>, Status> {
        self.0.decode(bytes).map_err(|broken| {
            status(Error::malformed(format!(
                "the message cannot be read: {}",
                broken.message()
            )))
        })
    }

    fn buffer_settings(&self) -> BufferSettings {
        self.0.buffer_settings()
    }
}
