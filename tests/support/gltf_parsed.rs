//! A second, plain reading of glTF files to compare with.

use std::collections::BTreeMap;

/// A glTF document as the test sees it: parsed with other code than the one under test.
pub struct Parsed {
    pub json: serde_json::Value,
    pub buffers: Vec<Vec<u8>>,
}

/// Parses a written or uploaded file.
pub fn parse(main: &[u8], companions: &BTreeMap<String, Vec<u8>>) -> Parsed {
    use base64::Engine as _;
    let (json, bin) = if main.starts_with(b"glTF") {
        let glb = gltf::binary::Glb::from_slice(main).expect("a valid GLB");
        (glb.json.into_owned(), glb.bin.map(|b| b.into_owned()))
    } else {
        (main.to_vec(), None)
    };
    let json: serde_json::Value = serde_json::from_slice(&json).expect("valid JSON");
    let buffers = json["buffers"].as_array().map_or(&[][..], Vec::as_slice).iter();
    let buffers = buffers.map(|buffer| match buffer["uri"].as_str() {
        None => bin.clone().unwrap_or_default(),
        Some(uri) => match uri.split_once(";base64,") {
            Some((_, payload)) => base64::engine::general_purpose::STANDARD
                .decode(payload)
                .expect("base64"),
            None => {
                let name = percent_encoding::percent_decode_str(uri)
                    .decode_utf8_lossy()
                    .into_owned();
                companions.get(&name).cloned().unwrap_or_default()
            }
        },
    });
    let buffers = buffers.collect();
    Parsed { json, buffers }
}
