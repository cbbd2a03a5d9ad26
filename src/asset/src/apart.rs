//! Decoders in C and C++ that run in a process of their own: how that process is called.
//!
//! Such decoders read bytes that strangers upload, and a fault in them could do anything. A caller who sets
//! [`Limits::apart`](super::Limits::apart) has them called in another process, which runs
//! [`answer_parser_calls`](super::answer_parser_calls). This crate starts no process and confines none: the caller does. Without one, the
//! decoders run in this process, with the same results.
//!
//! A message is a list of parts, the first of them JSON. Before the parts stands their number and before each part its length, as 64-bit
//! numbers, least byte first.

use super::{Error, Format};
use pliant_exec::progress::{self, Progress};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

/// Starts a process that answers calls of decoders.
#[derive(Debug, Clone, Copy)]
pub struct ParserStarter {
    /// Starts one, which is given up after that time.
    pub start: fn(longest: Duration) -> io::Result<Box<dyn ParserProcess>>,
    /// How long it may work.
    pub longest: Duration,
}

impl PartialEq for ParserStarter {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::fn_addr_eq(self.start, other.start) && self.longest == other.longest
    }
}

impl Eq for ParserStarter {}

/// A process that answers calls of decoders: its input and output. Dropping it ends the process.
///
/// Reading and writing return [`ErrorKind::WouldBlock`] after a while without progress, so that the caller can give up.
pub trait ParserProcess: Read + Write + Send {
    /// Lets the process hold as many bytes of memory, beside what it held when it started.
    ///
    /// # Errors
    /// When the process has ended.
    fn allow(&mut self, bytes: u64) -> io::Result<()>;

    /// Ends the process if it has not ended; returns how it ended, such as `was ended by signal 11`.
    fn end(&mut self) -> String;
}

/// About as many bytes as a process holds for its own once it has started.
pub(super) const PROCESS_BYTES: u64 = 4 << 20;

/// Bytes that a part of a message takes beside its own.
const PART_BYTES: u64 = 64;

/// Bytes that one byte of JSON may take once it is parsed: an empty text is three bytes there, and 24 in a list that may have doubled.
const PARSED_BYTES: u64 = 24;

/// Why a message did not arrive.
enum Lost {
    /// The other side is gone, or sent something else.
    Io(io::Error),
    /// The caller gave up, or may not take as much.
    Refused(Error),
}

impl From<io::Error> for Lost {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Tries until there is progress, or until the caller gives up.
fn waited<T>(progress: &dyn Progress, mut attempt: impl FnMut() -> io::Result<T>) -> Result<T, Lost> {
    loop {
        progress::check(progress).map_err(|_| Lost::Refused(Error::Cancelled))?;
        match attempt() {
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            done => return Ok(done?),
        }
    }
}

fn write_bytes(to: &mut (impl Write + ?Sized), mut bytes: &[u8], progress: &dyn Progress) -> Result<(), Lost> {
    while !bytes.is_empty() {
        match waited(progress, || to.write(bytes))? {
            0 => return Err(Lost::Io(ErrorKind::WriteZero.into())),
            written => bytes = &bytes[written..],
        }
    }
    Ok(())
}

fn read_bytes(from: &mut (impl Read + ?Sized), mut bytes: &mut [u8], progress: &dyn Progress) -> Result<(), Lost> {
    while !bytes.is_empty() {
        match waited(progress, || from.read(bytes))? {
            0 => return Err(Lost::Io(ErrorKind::UnexpectedEof.into())),
            read => bytes = &mut bytes[read..],
        }
    }
    Ok(())
}

fn read_number(from: &mut (impl Read + ?Sized), progress: &dyn Progress) -> Result<u64, Lost> {
    let mut bytes = [0; 8];
    read_bytes(from, &mut bytes, progress)?;
    Ok(u64::from_le_bytes(bytes))
}

fn write_message(
    to: &mut (impl Write + ?Sized),
    message: &impl Serialize,
    parts: &[&[u8]],
    progress: &dyn Progress,
) -> Result<(), Lost> {
    let json = serde_json::to_vec(message).map_err(io::Error::from)?;
    write_bytes(to, &(1 + parts.len() as u64).to_le_bytes(), progress)?;
    for part in [&*json].iter().chain(parts) {
        write_bytes(to, &(part.len() as u64).to_le_bytes(), progress)?;
        write_bytes(to, part, progress)?;
    }
    Ok(())
}

/// Reads a message. `may_take` is asked for the bytes of each part before they are allocated, for those of the JSON with what they become.
fn read_message<T: DeserializeOwned>(
    from: &mut (impl Read + ?Sized),
    progress: &dyn Progress,
    may_take: &mut dyn FnMut(u64) -> Result<(), Error>,
) -> Result<(T, Vec<Vec<u8>>), Lost> {
    let mut parts = Vec::new();
    for _ in 0..read_number(from, progress)? {
        let length = read_number(from, progress)?;
        let beside = if parts.is_empty() {
            length.saturating_mul(PARSED_BYTES)
        } else {
            0
        };
        may_take(length.saturating_add(beside).saturating_add(PART_BYTES)).map_err(Lost::Refused)?;
        let mut part = Vec::new();
        let length = usize::try_from(length).map_err(|_| io::Error::from(ErrorKind::OutOfMemory))?;
        part.try_reserve_exact(length).map_err(io::Error::from)?;
        part.resize(length, 0);
        read_bytes(from, &mut part, progress)?;
        parts.push(part);
    }
    if parts.is_empty() {
        return Err(Lost::Io(ErrorKind::InvalidData.into()));
    }
    let json = parts.remove(0);
    Ok((serde_json::from_slice(&json).map_err(io::Error::from)?, parts))
}

/// What is decoded, and for whom.
#[derive(Clone, Copy)]
pub(super) struct DecodedPlace<'a> {
    /// Where it stands in the file.
    pub place: &'a str,
    /// Who waits for it.
    pub progress: &'a dyn Progress,
}

/// The calls of one decoder, and the process that answers them.
pub(super) struct ParserCalls {
    process: Box<dyn ParserProcess>,
    /// The format of the files, for errors.
    format: Format,
}

impl ParserCalls {
    /// Starts the process.
    ///
    /// # Errors
    /// [`Error::NotStarted`].
    pub(super) fn start(starter: ParserStarter, format: Format) -> Result<Self, Error> {
        let process = (starter.start)(starter.longest).map_err(|e| Error::NotStarted(e.to_string()))?;
        Ok(Self { process, format })
    }

    /// Lets the process hold so many bytes, which the caller has reserved.
    pub(super) fn allow(&mut self, bytes: u64, at: DecodedPlace<'_>) -> Result<(), Error> {
        let allowed = self.process.allow(bytes);
        allowed.map_err(|e| self.lost(Lost::Io(e), at))
    }

    /// Sends a message.
    pub(super) fn send(
        &mut self,
        message: &impl Serialize,
        parts: &[&[u8]],
        at: DecodedPlace<'_>,
    ) -> Result<(), Error> {
        let sent = write_message(&mut *self.process, message, parts, at.progress);
        sent.map_err(|lost| self.lost(lost, at))
    }

    /// Waits for a message. `may_take` is asked for the bytes of each part before they are allocated.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Unsupported`] where the process ends, or is ended for what it does; those of `may_take`.
    pub(super) fn receive<T: DeserializeOwned>(
        &mut self,
        at: DecodedPlace<'_>,
        may_take: &mut dyn FnMut(u64) -> Result<(), Error>,
    ) -> Result<(T, Vec<Vec<u8>>), Error> {
        let received = read_message(&mut *self.process, at.progress, may_take);
        received.map_err(|lost| self.lost(lost, at))
    }

    /// The refusal of a file whose decoder sent something that it never sends.
    pub(super) fn unexpected(&mut self, at: DecodedPlace<'_>) -> Error {
        self.lost(Lost::Io(ErrorKind::InvalidData.into()), at)
    }

    fn lost(&mut self, lost: Lost, at: DecodedPlace<'_>) -> Error {
        let end = match lost {
            Lost::Refused(error) => return error,
            Lost::Io(error) if error.kind() == ErrorKind::TimedOut => error.to_string(),
            Lost::Io(_) => self.process.end(),
        };
        let problem = format!("the process that decodes it {end}");
        Error::unsupported(
            self.format,
            at.place,
            problem,
            "export the model again, as a glb without compression",
        )
    }
}

/// A call of a decoder.
pub(super) struct DecoderCall {
    /// Its name.
    pub decoder: String,
    /// What it is called with.
    pub call: Value,
    /// The bytes to decode.
    pub parts: Vec<Vec<u8>>,
}

/// The other side of [`ParserCalls`]: where calls come from and answers go to.
pub(super) struct AnsweredCalls<'a> {
    pub input: &'a mut (dyn Read + Send),
    pub output: &'a mut (dyn Write + Send),
}

impl AnsweredCalls<'_> {
    /// Waits for a call; `None` when no more come.
    pub(super) fn next(&mut self) -> io::Result<Option<DecoderCall>> {
        match self.read::<(String, Value)>() {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(None),
            read => read.map(|((decoder, call), parts)| Some(DecoderCall { decoder, call, parts })),
        }
    }

    /// Waits for a message.
    pub(super) fn read<T: DeserializeOwned>(&mut self) -> io::Result<(T, Vec<Vec<u8>>)> {
        read_message(self.input, &progress::Silent, &mut |_| Ok(())).map_err(io_error)
    }

    /// Sends a message.
    pub(super) fn write(&mut self, message: &impl Serialize, parts: &[&[u8]]) -> io::Result<()> {
        write_message(self.output, message, parts, &progress::Silent).map_err(io_error)
    }
}

fn io_error(lost: Lost) -> io::Error {
    match lost {
        Lost::Io(error) => error,
        Lost::Refused(error) => io::Error::other(error.to_string()),
    }
}

/// The bytes of a message.
#[cfg(test)]
pub(super) fn message(message: &impl Serialize, parts: &[&[u8]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    assert!(write_message(&mut bytes, message, parts, &progress::Silent).is_ok());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use progress::Silent;

    fn received(bytes: &[u8], room: u64) -> Result<Vec<Vec<u8>>, String> {
        let mut may_take = |bytes: u64| match bytes <= room {
            true => Ok(()),
            false => Err(Error::Cancelled),
        };
        let read = read_message::<String>(&mut &*bytes, &Silent, &mut may_take);
        read.map(|(_, parts)| parts).map_err(|lost| io_error(lost).to_string())
    }

    #[test]
    fn a_message_arrives_and_a_length_without_room_is_refused_before_it_is_taken() {
        let sent = message(&"call", &[b"", b"abc"]);
        assert_eq!(received(&sent, 1000), Ok(vec![vec![], b"abc".to_vec()]));
        for cut in 0..sent.len() {
            assert!(received(&sent[..cut], 1000).is_err(), "{cut}");
        }
        let claims = |length: u64| [1u64.to_le_bytes(), length.to_le_bytes()].concat();
        assert_eq!(received(&claims(u64::MAX), 1000), Err("cancelled".into()));
        assert!(received(&0u64.to_le_bytes(), 1000).is_err());
        // Each part counts, however short it is.
        assert!(received(&[&u64::MAX.to_le_bytes()[..], &[0; 64]].concat(), 1 << 20).is_err());
    }
}
