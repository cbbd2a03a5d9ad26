//! The media types of pictures, by their first bytes and by the names of their files.

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
pub(in super::super) fn media_type_of(name: &str, bytes: &[u8]) -> Option<&'static str> {
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
