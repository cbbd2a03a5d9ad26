//! The GLB container: a header, a JSON chunk, mostly a BIN chunk, and chunks of other kinds that pass through.

use super::fault::GltfFault;
use crate::asset::Error;

const JSON: [u8; 4] = *b"JSON";
const BIN: [u8; 4] = *b"BIN\0";

/// A GLB file taken apart. All parts are slices of the file.
pub(super) struct GlbContainer<'a> {
    /// The JSON chunk, with its padding.
    pub(super) json: &'a [u8],
    /// The BIN chunk's data, with its padding; `None` without such a chunk.
    pub(super) bin: Option<&'a [u8]>,
    /// Whatever chunks follow, with their headers.
    pub(super) rest: &'a [u8],
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
    let mut at = 12;
    let (kind, json) = next_chunk(file, &mut at, fault)?;
    if kind != JSON {
        return Err(fault.malformed("chunk at byte 12", "the first chunk must be JSON"));
    }
    let (mut bin, mut rest_start) = (None, at);
    let mut second = true;
    while at < file.len() {
        let chunk_start = at;
        let (kind, data) = next_chunk(file, &mut at, fault)?;
        match kind {
            JSON => {
                return Err(fault.malformed(format!("chunk at byte {chunk_start}"), "a second JSON chunk"));
            }
            BIN if second => (bin, rest_start) = (Some(data), at),
            BIN => {
                let problem = "a BIN chunk that is not the second chunk";
                return Err(fault.malformed(format!("chunk at byte {chunk_start}"), problem));
            }
            _ => {}
        }
        second = false;
    }
    Ok(GlbContainer {
        json,
        bin,
        rest: &file[rest_start..],
    })
}

fn next_chunk<'a>(file: &'a [u8], at: &mut usize, fault: GltfFault) -> Result<([u8; 4], &'a [u8]), Error> {
    let place = || format!("chunk at byte {at}");
    let left = &file[*at..];
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
    if length % 4 != 0 {
        return Err(fault.malformed(place(), format!("length {length} is not a multiple of 4")));
    }
    *at += 8 + data.len();
    Ok((*kind, data))
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
    let mut chunk = |kind: [u8; 4], data: &[u8], pad: u8| {
        out.extend_from_slice(&(padded(data.len()) as u32).to_le_bytes());
        out.extend_from_slice(&kind);
        out.extend_from_slice(data);
        out.resize(out.len() + padded(data.len()) - data.len(), pad);
    };
    chunk(JSON, json.as_bytes(), b' ');
    if let Some(bin) = bin {
        chunk(BIN, bin, 0);
    }
    out.extend_from_slice(rest);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::Format;

    const FAULT: GltfFault = GltfFault(Format::GLB);

    #[test]
    fn what_is_joined_splits_again() {
        let unknown = [4, 0, 0, 0, b'X', b'T', b'R', b'A', 1, 2, 3, 4];
        let file = join("{\"a\":1}", Some(&[1, 2, 3, 4, 5]), &unknown, FAULT).expect("small");
        let parts = split(&file, FAULT).expect("valid");
        assert_eq!(parts.json, b"{\"a\":1} ");
        assert_eq!(parts.bin, Some(&[1, 2, 3, 4, 5, 0, 0, 0][..]));
        assert_eq!(parts.rest, unknown);
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
