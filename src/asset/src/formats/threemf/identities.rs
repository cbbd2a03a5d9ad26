//! UUIDs of the production extension, which asks for one on each build, item, object and component.

use sha2::{Digest as _, Sha256};

/// The namespace of the extension.
const PRODUCTION: &str = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06";

/// Makes the UUIDs of what is written a second time: from the part and from what each is of, so that the same file comes out each time.
#[derive(Default)]
pub(super) struct Identities {
    /// The prefix of the extension; without one the part does not know it.
    prefix: Option<String>,
    /// A digest of the part as it was read.
    seed: [u8; 32],
    made: u32,
}

impl Identities {
    /// For a part, of which `head` begins with its element `model`.
    pub fn of_part(part: &[u8], head: &[u8]) -> Self {
        let text = String::from_utf8_lossy(head);
        let declared = text.find(PRODUCTION).and_then(|at| {
            let before = text[..at].trim_end_matches(['"', '\'']).trim_end();
            let before = before.strip_suffix('=')?.trim_end();
            let name = before.rsplit(|c: char| c.is_ascii_whitespace()).next()?;
            name.strip_prefix("xmlns:").map(str::to_owned)
        });
        Self {
            prefix: declared,
            seed: Sha256::digest(part.strip_prefix(b"\xef\xbb\xbf").unwrap_or(part)).into(),
            made: 0,
        }
    }

    /// The attributes of an element, with a UUID where the part needs one and they have none.
    pub fn with_uuid(&mut self, attributes: &str) -> String {
        let Some(prefix) = &self.prefix else {
            return attributes.to_owned();
        };
        let name = format!(" {prefix}:UUID=");
        if attributes.contains(&name) {
            return attributes.to_owned();
        }
        let mut hash = Sha256::new_with_prefix(self.seed);
        hash.update(self.made.to_le_bytes());
        self.made += 1;
        format!("{attributes}{name}\"{}\"", uuid_of(&hash.finalize()))
    }
}

/// A UUID of version 8, of a digest (RFC 9562, section 5.8).
fn uuid_of(digest: &[u8]) -> String {
    let mut text = String::new();
    for (k, byte) in digest.iter().take(16).enumerate() {
        let byte = match k {
            6 => byte & 0x0f | 0x80,
            8 => byte & 0x3f | 0x80,
            _ => *byte,
        };
        if matches!(k, 4 | 6 | 8 | 10) {
            text.push('-');
        }
        text.push_str(&format!("{byte:02x}"));
    }
    text
}

/// The attributes of the element `build` of a part, each with a blank before it.
pub(super) fn attributes_of_build(part: &[u8]) -> String {
    let text = String::from_utf8_lossy(part);
    let Some(at) = text.rfind("<build") else {
        return String::new();
    };
    let rest = &text[at + "<build".len()..];
    let end = rest.find('>').unwrap_or(0);
    let words = rest[..end].trim_end_matches('/').trim();
    if words.is_empty() {
        String::new()
    } else {
        format!(" {words}")
    }
}
