//! The model formats and how each is told from the others.

use std::fmt;

/// A model format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Format {
    /// Binary glTF 2.0.
    Glb,
    /// glTF 2.0 as JSON, with embedded buffers or companions.
    Gltf,
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY, ASCII or binary.
    Ply,
    /// Object File Format.
    Off,
    /// Stereolithography, ASCII or binary.
    Stl,
}

impl Format {
    /// Every format, in the order in which texts list them.
    pub const ALL: [Self; 6] = [Self::Glb, Self::Gltf, Self::Obj, Self::Ply, Self::Off, Self::Stl];

    /// The name used in requests and as file extension.
    pub fn name(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Gltf => "gltf",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Off => "off",
            Self::Stl => "stl",
        }
    }

    /// The registered or customary media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Glb => "model/gltf-binary",
            Self::Gltf => "model/gltf+json",
            Self::Obj => "model/obj",
            Self::Ply => "model/ply",
            Self::Off => "model/off",
            Self::Stl => "model/stl",
        }
    }

    /// The format of that name, in any case.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|f| f.name().eq_ignore_ascii_case(name))
    }

    /// The format of a media type, parameters ignored; `None` for general ones such as `application/octet-stream`.
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let essence = media_type.split(';').next().unwrap_or_default().trim();
        let alias = |s: &str| essence.eq_ignore_ascii_case(s);
        Self::ALL.into_iter().find(|f| alias(f.media_type())).or_else(|| {
            (alias("model/x.stl-binary") || alias("model/x.stl-ascii") || alias("application/sla")).then_some(Self::Stl)
        })
    }

    /// The format that a file name's extension says.
    pub fn from_file_name(name: &str) -> Option<Self> {
        name.rsplit_once('.')
            .and_then(|(_, extension)| Self::from_name(extension))
    }

    /// The format that the first bytes say. OBJ has no mark of its own and is told by its first keyword.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let blank = bytes.iter().take_while(|b| b.is_ascii_whitespace()).count();
        let text = &bytes[blank..];
        if bytes.starts_with(b"glTF") {
            Some(Self::Glb)
        } else if text.starts_with(b"{") {
            Some(Self::Gltf)
        } else if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
            Some(Self::Ply)
        } else if is_binary_stl(bytes) {
            Some(Self::Stl)
        } else if is_off(text) {
            Some(Self::Off)
        } else if text.starts_with(b"solid") {
            Some(Self::Stl)
        } else {
            is_obj(text).then_some(Self::Obj)
        }
    }
}

/// A binary STL says nothing but its triangle count, which must fit the length exactly.
fn is_binary_stl(bytes: &[u8]) -> bool {
    let Some(count) = bytes
        .get(80..84)
        .and_then(|b| b.try_into().ok())
        .map(u32::from_le_bytes)
    else {
        return false;
    };
    bytes.len() as u64 == 84 + 50 * u64::from(count)
}

fn is_off(text: &[u8]) -> bool {
    let word = text.split(|b| b.is_ascii_whitespace()).next().unwrap_or_default();
    // ST, C, N, 4 and n may stand before OFF: texture coordinates, colours, normals, dimensions.
    word.ends_with(b"OFF") && word[..word.len() - 3].iter().all(|b| b"STCN4n".contains(b))
}

fn is_obj(text: &[u8]) -> bool {
    const KEYWORDS: [&[u8]; 9] = [b"v", b"vn", b"vt", b"f", b"o", b"g", b"s", b"mtllib", b"usemtl"];
    text.split(|&b| b == b'\n' || b == b'\r')
        .map(|line| line.trim_ascii())
        .find(|line| !line.is_empty() && !line.starts_with(b"#"))
        .and_then(|line| line.split(|b| b.is_ascii_whitespace()).next())
        .is_some_and(|word| KEYWORDS.contains(&word))
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
