//! The GLB container: a header, a JSON chunk, mostly a BIN chunk, and chunks of other kinds that pass through.
//!
//! The lengths of chunks must be multiples of 4. Some writers give a chunk's length without its padding, and some do
//! not pad at all. Both are read as other readers do, with a warning; what is written has the padding and counts it.

use crate::{Error, Format};
use std::borrow::Cow;

const JSON: [u8; 4] = *b"JSON";
const BIN: [u8; 4] = *b"BIN\0";

/// A GLB file taken apart. All parts are slices of the file.
pub(super) struct GlbContainer<'a> {
    /// The JSON chunk, with its padding.
    pub(super) json: &'a [u8],
    /// The BIN chunk's data, with its padding; `None` without such a chunk.
    pub(super) bin: Option<&'a [u8]>,
    /// Whatever chunks follow, with their headers; with padding where the file's have none.
    pub(super) rest: Cow<'a, [u8]>,
    /// The byte where the first chunk begins whose length is not a multiple of 4, and that length.
    pub(super) uneven: Option<(usize, usize)>,
}

/// A chunk of a GLB file.
struct GlbChunk<'a> {
    start: usize,
    kind: [u8; 4],
    data: &'a [u8],
}

impl GlbChunk<'_> {
    /// The byte after its data.
    fn end(&self) -> usize {
        self.start + 8 + self.data.len()
    }
}

/// Takes a GLB apart, checking every length before it is used.
pub(super) fn split(file: &[u8], fault: GltfFault) -> Result<GlbContainer<'_>, Error> {
    let Some(header) = file.first_chunk::<12>() else {
        return Err(fault.malformed("header", format!("{} bytes, a GLB header alone takes 12", file.len())));
    };
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    if !file.starts_with(b"glTF") {
        return Err(fault.malformed("header", "does not start with the letters glTF"));
    }
    match word(4) {
        2 => {}
        1 => {
            return Err(fault.unsupported(
                "header",
                "container version 1, a glTF 1.x asset",
                "convert it to glTF 2.0",
            ));
        }
        version => return Err(fault.malformed("header", format!("container version {version}, only 2 is known"))),
    }
    if u64::from(word(8)) != file.len() as u64 {
        let problem = format!("says a length of {} bytes, the file has {}", word(8), file.len());
        return Err(fault.malformed("header", problem));
    }
    let json = read_chunk(file, 12, fault)?;
    if json.kind != JSON {
        return Err(fault.malformed("chunk at byte 12", "the first chunk must be JSON"));
    }
    let mut parts = GlbContainer {
        json: json.data,
        bin: None,
        rest: Cow::Borrowed(&[]),
        uneven: None,
    };
    let mut others = Vec::new();
    let mut last = json;
    loop {
        if parts.uneven.is_none() && last.data.len() % 4 != 0 {
            parts.uneven = Some((last.start, last.data.len()));
        }
        let Some(chunk) = chunk_after(file, &last, fault)? else {
            break;
        };
        let place = || format!("chunk at byte {}", chunk.start);
        match chunk.kind {
            JSON => return Err(fault.malformed(place(), "a second JSON chunk")),
            BIN if last.start == 12 => parts.bin = Some(chunk.data),
            BIN => return Err(fault.malformed(place(), "a BIN chunk that is not the second chunk")),
            _ => others.push((chunk.start, chunk.kind, chunk.data)),
        }
        last = chunk;
    }
    parts.rest = match others.first() {
        None => Cow::Borrowed(&[]),
        Some((start, ..)) if parts.uneven.is_none() => Cow::Borrowed(&file[*start..]),
        Some(_) => {
            let mut rest = Vec::new();
            others
                .iter()
                .for_each(|(_, kind, data)| push_chunk(&mut rest, *kind, data, 0));
            Cow::Owned(rest)
        }
    };
    Ok(parts)
}

/// The chunk that follows another, `None` at the end of the file. Where a length is not a multiple of 4, the next chunk
/// may begin right behind the data or behind padding that the length leaves out.
fn chunk_after<'a>(file: &'a [u8], before: &GlbChunk<'_>, fault: GltfFault) -> Result<Option<GlbChunk<'a>>, Error> {
    let (close, padded) = (before.end(), before.end().next_multiple_of(4));
    let left = &file[close..];
    if left.is_empty() || (padded >= file.len() && left.iter().all(|b| matches!(b, 0 | b' '))) {
        return Ok(None);
    }
    let padding = file.get(close..padded).unwrap_or_default();
    if close != padded
        && padding.iter().all(|b| matches!(b, 0 | b' '))
        && let Ok(chunk) = read_chunk(file, padded, fault)
        // Right behind the data stands a chunk of its own where that makes sense, and only one of both can.
        && !read_chunk(file, close, fault).is_ok_and(|other| other.kind == BIN)
    {
        return Ok(Some(chunk));
    }
    read_chunk(file, close, fault).map(Some)
}

fn read_chunk(file: &[u8], start: usize, fault: GltfFault) -> Result<GlbChunk<'_>, Error> {
    let place = || format!("chunk at byte {start}");
    let left = file.get(start..).unwrap_or_default();
    let Some(([a, b, c, d, kind @ ..], data)) = left.split_first_chunk::<8>() else {
        return Err(fault.malformed(
            place(),
            format!("{} bytes are left, a chunk header takes 8", left.len()),
        ));
    };
    let length = u32::from_le_bytes([*a, *b, *c, *d]);
    let Some(data) = usize::try_from(length).ok().and_then(|length| data.get(..length)) else {
        let problem = format!("says a length of {length} bytes, {} are left", data.len());
        return Err(fault.malformed(place(), problem));
    };
    let kind = *kind;
    Ok(GlbChunk { start, kind, data })
}

/// Adds a chunk, filled up with `pad` to a multiple of 4 bytes. Its length must fit 32 bits.
fn push_chunk(out: &mut Vec<u8>, kind: [u8; 4], data: &[u8], pad: u8) {
    let length = data.len().next_multiple_of(4);
    out.extend_from_slice(&(length as u32).to_le_bytes());
    out.extend_from_slice(&kind);
    out.extend_from_slice(data);
    out.resize(out.len() + length - data.len(), pad);
}

/// Puts a GLB together; pads JSON with spaces and BIN with zeros.
pub(super) fn join(json: &str, bin: Option<&[u8]>, rest: &[u8], fault: GltfFault) -> Result<Vec<u8>, Error> {
    let padded = |length: usize| length.next_multiple_of(4);
    let bin_size = bin.map_or(0, |b| 8 + padded(b.len()));
    let total = 12 + 8 + padded(json.len()) + bin_size + rest.len();
    let Ok(total_u32) = u32::try_from(total) else {
        return Err(fault.unwritable(format!("{total} bytes, a GLB holds at most {}", u32::MAX)));
    };
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&total_u32.to_le_bytes());
    // Both lengths are below the total, which fits 32 bits.
    push_chunk(&mut out, JSON, json.as_bytes(), b' ');
    if let Some(bin) = bin {
        push_chunk(&mut out, BIN, bin, 0);
    }
    out.extend_from_slice(rest);
    Ok(out)
}

/// Makes the errors of one file, which all name its format.
#[derive(Debug, Clone, Copy)]
pub(super) struct GltfFault(pub(super) Format);

impl GltfFault {
    /// The file breaks a rule of the format at `place`.
    pub(super) fn malformed(self, place: impl Into<String>, problem: impl Into<String>) -> Error {
        Error::malformed(self.0, place, problem)
    }

    /// The file is valid but not for us.
    pub(super) fn unsupported(
        self,
        place: impl Into<String>,
        problem: impl Into<String>,
        hint: impl Into<String>,
    ) -> Error {
        Error::unsupported(self.0, place, problem, hint)
    }

    /// The result cannot be written.
    pub(super) fn unwritable(self, problem: impl Into<String>) -> Error {
        Error::unwritable(self.0, problem)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;

    const FAULT: GltfFault = GltfFault(Format::GLB);

    #[test]
    fn what_is_joined_splits_again() {
        let unknown = [4, 0, 0, 0, b'X', b'T', b'R', b'A', 1, 2, 3, 4];
        let file = join("{\"a\":1}", Some(&[1, 2, 3, 4, 5]), &unknown, FAULT).expect("small");
        let parts = split(&file, FAULT).expect("valid");
        assert_eq!(parts.json, b"{\"a\":1} ");
        assert_eq!(parts.bin, Some(&[1, 2, 3, 4, 5, 0, 0, 0][..]));
        assert_eq!(&parts.rest[..], unknown);
        assert_eq!(parts.uneven, None);
    }

    /// A file whose chunks have these data and say these lengths, whatever they are.
    fn glb_of(chunks: &[([u8; 4], &[u8], usize)]) -> Vec<u8> {
        let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, data, length) in chunks {
            file.extend_from_slice(&(*length as u32).to_le_bytes());
            file.extend_from_slice(kind);
            file.extend_from_slice(data);
        }
        let total = (file.len() as u32).to_le_bytes();
        file[8..12].copy_from_slice(&total);
        file
    }

    #[test]
    fn lengths_that_are_no_multiple_of_four_are_read_with_and_without_padding() {
        let extra = *b"XTRA";
        // Padding that the length leaves out, then no padding at all; each also at the end of the file.
        let padded = glb_of(&[
            (JSON, b"{\"a\":123}   ", 9),
            (BIN, &[1, 2, 3, 4, 5, 0, 0, 0], 5),
            (extra, &[7, 0, 0, 0], 1),
        ]);
        let bare = glb_of(&[(JSON, b"{\"a\":1}", 7), (BIN, &[1, 2, 3, 4, 5], 5), (extra, &[7], 1)]);
        for (file, json) in [(padded, &b"{\"a\":123}"[..]), (bare, b"{\"a\":1}")] {
            let parts = split(&file, FAULT).expect("read with a warning");
            assert_eq!(parts.json.trim_ascii(), json);
            assert_eq!(parts.bin, Some(&[1, 2, 3, 4, 5][..]));
            assert_eq!(&parts.rest[..], [4, 0, 0, 0, b'X', b'T', b'R', b'A', 7, 0, 0, 0]);
            assert!(parts.uneven.is_some());
            let text = std::str::from_utf8(parts.json).expect("text");
            let again = join(text, parts.bin, &parts.rest, FAULT).expect("small");
            assert_eq!(split(&again, FAULT).expect("valid").uneven, None);
        }
    }

    #[test]
    fn every_truncation_is_refused() {
        let file = join("{}", Some(&[9; 8]), &[], FAULT).expect("small");
        for length in 0..file.len() {
            assert!(
                split(&file[..length], FAULT).is_err(),
                "{length} bytes of {}",
                file.len()
            );
        }
    }

    #[test]
    fn lengths_that_lie_are_refused_with_the_place() {
        let mut file = join("{}", Some(&[9; 8]), &[], FAULT).expect("small");
        file[24..28].copy_from_slice(&u32::MAX.to_le_bytes());
        let text = split(&file, FAULT).err().expect("a lie").to_string();
        assert!(
            text.contains("chunk at byte 24") && text.contains("4294967295"),
            "{text}"
        );
    }
}
