//! The bytes behind buffers and buffer views, wherever they are kept, and what URIs name. Nothing is ever fetched or opened.

use super::compressed::ViewCoding;
use super::container::GltfFault;
use super::document::GltfDocument;
use super::schema::{BufferView, GltfAccessor};
use super::stored::{BufferOrigin, StoredBuffer, ViewDecoding};
use crate::apart::{DecodedPlace, PROCESS_BYTES, ParserCalls};
use crate::files::ReadWatch;
use crate::{Error, FileSet};
use base64::Engine as _;
use base64::alphabet::STANDARD;
use base64::engine::DecodePaddingMode;
use base64::engine::general_purpose::{GeneralPurpose, GeneralPurposeConfig};
use bytes::Bytes;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use pliant_exec::progress::Silent;
use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::BTreeSet;

impl<'a> GltfDocument<'a> {
    /// Finds the bytes of every buffer.
    pub(super) fn load_bytes(mut self, files: &FileSet, watch: Option<&ReadWatch<'a>>) -> Result<Self, Error> {
        if let Some(watch) = watch {
            self.bytes.decoding = ViewDecoding {
                apart: watch.apart,
                progress: Some(watch.progress()),
            };
            self.bytes.watch = Some(watch.clone());
        }
        self.bytes.decoded = vec![OnceCell::new(); self.views.len()];
        for i in 0..self.buffers.len() {
            let stored = self.load_buffer(files, i)?;
            self.bytes.stored.push(stored);
        }
        Ok(self)
    }

    fn load_buffer(&self, files: &FileSet, i: usize) -> Result<StoredBuffer, Error> {
        let buffer = &self.buffers.values[i];
        let place = format!("buffers/{i}/uri");
        let fallback = buffer.is_fallback();
        let nowhere = StoredBuffer {
            origin: BufferOrigin::Nowhere,
            bytes: None,
        };
        let (origin, bytes) = match &buffer.uri {
            None if i == 0 && !fallback && self.container.is_some() => {
                let Some(bin) = self.chunk() else {
                    return Err(self.fault.malformed(place, "absent, and the GLB has no BIN chunk"));
                };
                (BufferOrigin::Bin, files.main.slice_ref(bin))
            }
            None => return Ok(nowhere),
            Some(text) => match resolve(text, &place, self.fault, &mut |bytes| self.bytes.reserve(bytes))? {
                UriTarget::Embedded(bytes) => (BufferOrigin::Embedded, Bytes::from(bytes)),
                UriTarget::Companion(name) => match files.companions.get(&name) {
                    Some(bytes) => (BufferOrigin::Companion(name), bytes.clone()),
                    None if fallback => return Ok(nowhere),
                    None => {
                        return Err(self.fault.unsupported(
                            place,
                            format!("the file {name:?} is missing"),
                            "send it along as another part of a multipart upload under that name, or keep it beside \
                             the .gltf when working on the command line",
                        ));
                    }
                },
            },
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let problem = format!("{} bytes are declared, there are {}", buffer.byte_length.0, bytes.len());
            return Err(self.fault.malformed(format!("buffers/{i}/byteLength"), problem));
        }
        Ok(StoredBuffer {
            origin,
            bytes: Some(bytes),
        })
    }

    /// Where each buffer is kept.
    pub(super) fn origins(&self) -> impl Iterator<Item = &BufferOrigin> {
        self.bytes.stored.iter().map(|stored| &stored.origin)
    }

    /// The bytes of a buffer; `None` when there are none.
    pub(super) fn buffer_bytes(&self, buffer: usize) -> Option<&Bytes> {
        self.bytes.stored.get(buffer)?.bytes.as_ref()
    }

    /// Decompresses what the given accessors need.
    pub(super) fn decode_for(&self, accessors: impl IntoIterator<Item = usize>) -> Result<(), Error> {
        let accessors = accessors.into_iter().filter_map(|a| self.accessors.get(a));
        let is_compressed = |&v: &usize| self.views.get(v).is_some_and(|view| view.compression().is_some());
        let views: BTreeSet<usize> = accessors.flat_map(GltfAccessor::views).filter(is_compressed).collect();
        views.into_iter().try_for_each(|view| self.view(view).map(drop))
    }

    /// The bytes of a view, decompressed.
    pub(super) fn view(&self, index: usize) -> Result<&[u8], Error> {
        let Some(view) = self.views.get(index) else {
            return Err(self.fault.malformed(format!("bufferViews/{index}"), "does not exist"));
        };
        let Some(compression) = view.compression() else {
            return self.bytes_of(view.buffer.index(), view.offset(), view.byte_length.0);
        };
        let cell = self.bytes.decoded.get(index);
        if let Some(bytes) = cell.and_then(OnceCell::get) {
            return Ok(bytes);
        }
        let bytes = compression.count.0.saturating_mul(compression.byte_stride.0);
        // The filters make a second copy of what the codec gives. Another process holds these and the source, beside what comes back.
        let ViewDecoding { apart, progress } = self.bytes.decoding;
        let beside = match apart {
            None => bytes,
            Some(_) => bytes.saturating_mul(2).saturating_add(compression.byte_length.0),
        };
        self.bytes.reserve(bytes.saturating_add(beside))?;
        let source = self.bytes_of(
            compression.buffer.index(),
            compression.offset(),
            compression.byte_length.0,
        )?;
        let place = format!("bufferViews/{index}");
        let coding = ViewCoding::of(compression, source.len() as u64, &place, self.fault)?;
        let mut calls = self.bytes.calls.borrow_mut();
        if let (None, Some(starter)) = (&*calls, apart) {
            self.bytes.reserve(PROCESS_BYTES)?;
            *calls = Some(ParserCalls::start(starter, self.fault.0)?);
        }
        let at = DecodedPlace {
            place: &format!("{place}/extensions/meshopt_compression"),
            progress: progress.unwrap_or(&Silent),
        };
        let decoded = coding.decode_at(source, at, self.fault, calls.as_mut())?;
        self.bytes.release(beside);
        Ok(cell.map_or(&[], |cell| cell.get_or_init(|| decoded)))
    }

    fn bytes_of(&self, buffer: usize, offset: u64, length: u64) -> Result<&[u8], Error> {
        let place = || format!("buffers/{buffer}");
        let Some(bytes) = self.buffer_bytes(buffer) else {
            let problem = "holds geometry but has neither a URI nor a BIN chunk";
            return Err(self.fault.malformed(place(), problem));
        };
        let range = usize::try_from(offset).ok().zip(usize::try_from(length).ok());
        range.and_then(|(o, n)| bytes.get(o..o.checked_add(n)?)).ok_or_else(|| {
            self.fault
                .malformed(place(), format!("has no {length} bytes from {offset} on"))
        })
    }

    /// The first buffer that new data may be appended to.
    pub(super) fn growing_buffer(&self) -> Option<usize> {
        let takes_more = |&i: &usize| {
            self.buffer_bytes(i).is_some() && self.is_exclusive(i) && !self.buffers.values[i].is_fallback()
        };
        (0..self.buffers.len()).find(takes_more)
    }

    /// Whether floats can be written over bytes of a view.
    pub(super) fn takes_floats(&self, view: &BufferView) -> bool {
        let buffer = view.buffer.index();
        view.compression().is_none() && self.is_exclusive(buffer) && !self.buffers.values[buffer].is_fallback()
    }

    /// Whether changing this buffer's bytes changes nothing else: no other buffer is kept in the same place.
    pub(super) fn is_exclusive(&self, index: usize) -> bool {
        match self.bytes.stored.get(index).map(|stored| &stored.origin) {
            None | Some(BufferOrigin::Nowhere) => false,
            Some(BufferOrigin::Bin | BufferOrigin::Embedded) => true,
            Some(companion) => self.origins().filter(|origin| *origin == companion).count() == 1,
        }
    }
}

/// Padding is often forgotten and never needed.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The media types that glTF allows for embedded buffers; the first is the one we write.
const MEDIA_TYPES: [&str; 2] = ["application/octet-stream", "application/gltf-buffer"];

/// What stands as itself in the URI of a file.
const PLAIN: &AsciiSet = &NON_ALPHANUMERIC
    .remove(b'-')
    .remove(b'_')
    .remove(b'.')
    .remove(b'~')
    .remove(b'/');

/// The URI of a file beside the model, by its name.
pub(in super::super) fn of_file_name(name: &str) -> String {
    utf8_percent_encode(name, PLAIN).to_string()
}

/// What a buffer's URI means.
#[derive(Debug, PartialEq)]
pub(super) enum UriTarget {
    /// The bytes are in the URI itself.
    Embedded(Vec<u8>),
    /// They are in the companion file of this name.
    Companion(String),
}

/// Reads a buffer URI. `reserve` is asked for the bytes of embedded data before they are decoded.
pub(super) fn resolve(
    uri: &str,
    place: &str,
    fault: GltfFault,
    reserve: &mut dyn FnMut(u64) -> Result<(), Error>,
) -> Result<UriTarget, Error> {
    if uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:")) {
        // As many bytes at most, whether or not some of them are escaped.
        reserve(uri.len() as u64)?;
        return embedded(&uri[5..], place, fault).map(UriTarget::Embedded);
    }
    companion_name(uri, place, fault).map(UriTarget::Companion)
}

fn embedded(rest: &str, place: &str, fault: GltfFault) -> Result<Vec<u8>, Error> {
    let Some((kind, payload)) = rest.split_once(',') else {
        return Err(fault.malformed(place, "a data URI without a comma"));
    };
    let mut parts = kind.split(';').map(str::trim);
    let media_type = parts.next().unwrap_or_default();
    if !MEDIA_TYPES
        .iter()
        .any(|allowed| allowed.eq_ignore_ascii_case(media_type))
    {
        let problem = format!(
            "media type {:?}, allowed are {}",
            shown(media_type),
            MEDIA_TYPES.join(" and ")
        );
        return Err(fault.malformed(place, problem));
    }
    if !parts.any(|p| p.eq_ignore_ascii_case("base64")) {
        return Err(fault.malformed(place, "an embedded buffer must be base64"));
    }
    // Some writers escape the + / = of base64.
    let payload: Cow<'_, [u8]> = if payload.contains('%') {
        percent_decode_str(payload).into()
    } else {
        payload.as_bytes().into()
    };
    BASE64.decode(&payload).map_err(|e| {
        let reason = e.to_string().to_lowercase();
        fault.malformed(place, format!("not base64: {}", reason.trim_end_matches('.')))
    })
}

fn companion_name(uri: &str, place: &str, fault: GltfFault) -> Result<String, Error> {
    let refuse = |what: &str| {
        let problem = format!(
            "{:?} {what}; a buffer's URI must be a relative name or embedded data",
            shown(uri)
        );
        Err(fault.malformed(place, problem))
    };
    match relative_name(uri) {
        RelativeName::Inside(name) => Ok(name),
        RelativeName::Outside if uri.starts_with(['/', '\\']) => refuse("is an absolute path"),
        RelativeName::Outside => refuse("leads out of the model's folder"),
        RelativeName::Remote => refuse("has a scheme, and nothing is ever fetched"),
        RelativeName::NoName(what) => refuse(what),
    }
}

/// The bytes of a data URI of any media type, with or without white space around the base64; `None` for what is none.
pub(super) fn embedded_bytes(uri: &str) -> Option<Vec<u8>> {
    let (kind, payload) = uri.get(5..)?.split_once(',')?;
    let is_data = uri[..5].eq_ignore_ascii_case("data:") && kind.to_ascii_lowercase().ends_with(";base64");
    let payload: Vec<u8> = percent_decode_str(payload).collect();
    is_data.then(|| BASE64.decode(payload.trim_ascii()).ok()).flatten()
}

/// What a URI that is not embedded data names.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum RelativeName {
    /// A file in the model's folder or below it, by its decoded name.
    Inside(String),
    /// A file somewhere else.
    Outside,
    /// Something of another scheme.
    Remote,
    /// Nothing, and why.
    NoName(&'static str),
}

/// Returns what a URI names.
pub(super) fn relative_name(uri: &str) -> RelativeName {
    let Ok(name) = percent_decode_str(uri).decode_utf8() else {
        return RelativeName::NoName("is not UTF-8");
    };
    let name = name.strip_prefix("./").unwrap_or(&name);
    let is_scheme = |s: &str| {
        s.starts_with(|c: char| c.is_ascii_alphabetic())
            && s.chars()
                .all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'))
    };
    if name.is_empty() {
        RelativeName::NoName("is empty")
    } else if name.split_once(':').is_some_and(|(scheme, _)| is_scheme(scheme)) {
        RelativeName::Remote
    } else if name.starts_with(['/', '\\']) || name.split(['/', '\\']).any(|part| part == "..") {
        RelativeName::Outside
    } else if name.contains(char::is_control) {
        RelativeName::NoName("holds control characters")
    } else {
        RelativeName::Inside(name.to_owned())
    }
}

/// The start of a text that may be long.
pub(super) fn shown(text: &str) -> String {
    let mut out: String = text.chars().take(80).collect();
    if out.len() < text.len() {
        out.push('…');
    }
    out
}

/// An embedded buffer's URI.
pub(super) fn embed(bytes: &[u8]) -> String {
    let mut uri = format!("data:{};base64,", MEDIA_TYPES[0]);
    BASE64.encode_string(bytes, &mut uri);
    uri
}

/// Media types with the extension of their files.
const KINDS: [(&str, &str); 6] = [
    ("image/png", "png"),
    ("image/jpeg", "jpg"),
    ("image/webp", "webp"),
    ("image/ktx2", "ktx2"),
    ("image/avif", "avif"),
    ("image/vnd-ms.dds", "dds"),
];

/// The media type of a picture by its first bytes, else by its name; `None` for a kind that glTF has none for.
pub(in crate::formats) fn media_type_of(name: &str, bytes: &[u8]) -> Option<&'static str> {
    const BY_CONTENT: [(&[u8], &str); 4] = [
        (b"\x89PNG\r\n\x1a\n", "image/png"),
        (b"\xff\xd8\xff", "image/jpeg"),
        (b"\xabKTX 20\xbb\r\n\x1a\n", "image/ktx2"),
        (b"DDS ", "image/vnd-ms.dds"),
    ];
    let by_content = BY_CONTENT.iter().find(|(mark, _)| bytes.starts_with(mark));
    if let Some((_, media_type)) = by_content {
        return Some(media_type);
    }
    if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP") {
        return Some("image/webp");
    }
    if bytes.get(4..8) == Some(b"ftyp") && bytes.get(8..12).is_some_and(|brand| brand.starts_with(b"avi")) {
        return Some("image/avif");
    }
    let (_, extension) = name.rsplit_once('.')?;
    let extension = match extension.to_ascii_lowercase().as_str() {
        "jpeg" => "jpg".to_owned(),
        other => other.to_owned(),
    };
    KINDS
        .iter()
        .find(|(_, known)| *known == extension)
        .map(|(kind, _)| *kind)
}

/// The extension of a picture's file: by its bytes, else by the media type that is said.
pub(super) fn file_extension(said: Option<&str>, bytes: &[u8]) -> &'static str {
    let kind = media_type_of("", bytes).or(said);
    let known = KINDS.iter().find(|(known, _)| Some(*known) == kind);
    known.map_or("bin", |(_, extension)| extension)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;

    fn read(uri: &str) -> Result<UriTarget, String> {
        resolve(uri, "buffers/0/uri", GltfFault(Format::GLTF), &mut |_| Ok(())).map_err(|e| e.to_string())
    }

    #[test]
    fn embedded_data_comes_back() {
        for length in 0..5 {
            let bytes: Vec<u8> = (0..length).collect();
            assert_eq!(read(&embed(&bytes)), Ok(UriTarget::Embedded(bytes)));
        }
        let spellings = [
            "data:application/gltf-buffer;base64,/+8",
            "data:application/octet-stream;base64,%2F%2B8%3D",
        ];
        for uri in spellings {
            assert_eq!(read(uri), Ok(UriTarget::Embedded(vec![0xff, 0xef])), "{uri}");
        }
    }

    #[test]
    fn names_are_decoded() {
        assert_eq!(
            read("./my%20model.bin"),
            Ok(UriTarget::Companion("my model.bin".into()))
        );
        assert!(read("a:b/c.bin").is_err(), "reads as a scheme");
        assert_eq!(
            read("sub/dir..x/c.bin"),
            Ok(UriTarget::Companion("sub/dir..x/c.bin".into()))
        );
    }

    #[test]
    fn nothing_outside_the_set_can_be_named() {
        let hostile = [
            "http://127.0.0.1:9/x.bin",
            "file:///etc/passwd",
            "/etc/passwd",
            "../../etc/passwd",
            "a/%2e%2e/b",
            "..%5cx",
            "%2Fetc",
            "C:\\x",
            "",
            "data:text/neutral;base64,AAAA",
            "data:application/octet-stream,AAAA",
            "data:application/octet-stream;base64,A*AA",
            "data:",
            "a%00b",
        ];
        for uri in hostile {
            let text = read(uri).expect_err(uri);
            assert!(text.contains("buffers/0/uri"), "{text}");
        }
    }
}
