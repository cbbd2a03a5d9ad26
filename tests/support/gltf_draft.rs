//! Makes glTF documents for tests.

use serde_json::{Value, json};

/// A document in the making.
#[derive(Default)]
pub struct Draft {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Draft {
    /// An accessor with a view of its own.
    pub fn add(&mut self, bytes: &[u8], component: u32, shape: &str, count: usize, more: Value) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.views
            .push(json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()}));
        self.bin.extend_from_slice(bytes);
        let mut accessor =
            json!({"bufferView": self.views.len() - 1, "componentType": component, "count": count, "type": shape});
        for (key, value) in more.as_object().expect("an object") {
            accessor[key] = value.clone();
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// An accessor of floats with its bounds.
    pub fn floats<const N: usize>(&mut self, values: &[[f32; N]], shape: &str) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let fold = |f: fn(f32, f32) -> f32, k: usize| values.iter().map(|v| v[k]).reduce(f).expect("values");
        let least: Vec<f32> = (0..N).map(|k| fold(f32::min, k)).collect();
        let most: Vec<f32> = (0..N).map(|k| fold(f32::max, k)).collect();
        self.add(&bytes, 5126, shape, values.len(), json!({"min": least, "max": most}))
    }

    /// The document as a GLB, with its buffer, views and accessors.
    pub fn glb(self, mut document: Value) -> Vec<u8> {
        document["asset"] = json!({"version": "2.0"});
        document["buffers"] = json!([{"byteLength": self.bin.len()}]);
        document["bufferViews"] = self.views.into();
        document["accessors"] = self.accessors.into();
        let glb = gltf::binary::Glb {
            header: gltf::binary::Header {
                magic: *b"glTF",
                version: 2,
                length: 0,
            },
            json: serde_json::to_vec(&document).expect("JSON").into(),
            bin: Some(self.bin.into()),
        };
        glb.to_vec().expect("a GLB")
    }
}
