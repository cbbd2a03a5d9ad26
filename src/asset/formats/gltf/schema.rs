//! The parts of a glTF document that placing and reading triangles needs, as typed values.
//!
//! Everything else in the document is never looked at here, so that an exotic animation or material cannot fail a read.

use serde::Deserialize;
use serde::de::{Deserializer, Error as _, IgnoredAny, Visitor};
use std::collections::BTreeMap;
use std::fmt;

/// A whole number from zero; `3.0` and `3e0` are the same number as `3`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Whole(pub(super) u64);

impl Whole {
    /// As an index or size; what does not fit is larger than everything there is.
    pub(super) fn index(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl Visitor<'_> for Read {
            type Value = Whole;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number from 0")
            }
            fn visit_u64<E: serde::de::Error>(self, v: u64) -> Result<Whole, E> {
                Ok(Whole(v))
            }
            fn visit_f64<E: serde::de::Error>(self, v: f64) -> Result<Whole, E> {
                // Above 2^53 a float no longer says which whole number was meant.
                if (0.0..=9_007_199_254_740_992.0).contains(&v) && v.fract() == 0.0 {
                    Ok(Whole(v as u64))
                } else {
                    Err(E::custom(format_args!("{v:?} is not a whole number from 0")))
                }
            }
            fn visit_i64<E: serde::de::Error>(self, v: i64) -> Result<Whole, E> {
                Err(E::custom(format_args!("{v} is below 0")))
            }
        }
        deserializer.deserialize_any(Read)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Asset {
    pub(super) version: String,
    pub(super) min_version: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
    pub(super) byte_length: Whole,
    pub(super) extensions: Option<BufferExtensions>,
}

impl Buffer {
    /// Whether it only says how large the decompressed data would be.
    pub(super) fn is_fallback(&self) -> bool {
        let marked = |mark: &Option<FallbackMark>| mark.as_ref().is_some_and(|m| m.fallback == Some(true));
        self.extensions
            .as_ref()
            .is_some_and(|e| marked(&e.ext) || marked(&e.khr))
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct BufferExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    ext: Option<FallbackMark>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr: Option<FallbackMark>,
}

#[derive(Debug, Deserialize)]
struct FallbackMark {
    fallback: Option<bool>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    pub(super) buffer: Whole,
    byte_offset: Option<Whole>,
    pub(super) byte_length: Whole,
    pub(super) byte_stride: Option<Whole>,
    extensions: Option<ViewExtensions>,
}

impl View {
    pub(super) fn offset(&self) -> u64 {
        self.byte_offset.map_or(0, |o| o.0)
    }

    /// How its bytes are compressed, when they are.
    pub(super) fn compression(&self) -> Option<&Compression> {
        self.extensions.as_ref().and_then(|e| e.khr.as_ref().or(e.ext.as_ref()))
    }
}

#[derive(Debug, Deserialize)]
struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    ext: Option<Compression>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr: Option<Compression>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compression {
    pub(super) buffer: Whole,
    byte_offset: Option<Whole>,
    pub(super) byte_length: Whole,
    pub(super) byte_stride: Whole,
    pub(super) count: Whole,
    pub(super) mode: String,
    pub(super) filter: Option<String>,
}

impl Compression {
    pub(super) fn offset(&self) -> u64 {
        self.byte_offset.map_or(0, |o| o.0)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<Whole>,
    byte_offset: Option<Whole>,
    pub(super) component_type: Whole,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: Whole,
    #[serde(rename = "type")]
    pub(super) shape: String,
    pub(super) sparse: Option<Sparse>,
}

impl Accessor {
    pub(super) fn offset(&self) -> u64 {
        self.byte_offset.map_or(0, |o| o.0)
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub(super) count: Whole,
    pub(super) indices: SparseIndices,
    pub(super) values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub(super) buffer_view: Whole,
    #[serde(default = "zero")]
    pub(super) byte_offset: Whole,
    pub(super) component_type: Whole,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub(super) buffer_view: Whole,
    #[serde(default = "zero")]
    pub(super) byte_offset: Whole,
}

fn zero() -> Whole {
    Whole(0)
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    pub(super) name: Option<String>,
    pub(super) primitives: Vec<MeshPrimitive>,
}

/// Accessors by attribute name.
pub(super) type Attributes = BTreeMap<String, Whole>;

#[derive(Debug, Deserialize)]
pub(super) struct MeshPrimitive {
    pub(super) attributes: Attributes,
    pub(super) indices: Option<Whole>,
    mode: Option<Whole>,
    #[serde(default)]
    pub(super) targets: Vec<Attributes>,
    extensions: Option<PrimitiveExtensions>,
}

impl MeshPrimitive {
    /// Triangles when not said otherwise.
    pub(super) fn mode(&self) -> u64 {
        self.mode.map_or(4, |m| m.0)
    }

    pub(super) fn has_draco(&self) -> bool {
        self.extensions.as_ref().is_some_and(|e| e.draco.is_some())
    }

    /// The accessor of an attribute.
    pub(super) fn attribute(&self, name: &str) -> Option<usize> {
        self.attributes.get(name).map(|a| a.index())
    }
}

#[derive(Debug, Deserialize)]
struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    draco: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Node {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) children: Vec<Whole>,
    pub(super) mesh: Option<Whole>,
    pub(super) skin: Option<Whole>,
    #[serde(default, deserialize_with = "numbers")]
    pub(super) matrix: Option<[f64; 16]>,
    #[serde(default, deserialize_with = "numbers")]
    pub(super) translation: Option<[f64; 3]>,
    #[serde(default, deserialize_with = "numbers")]
    pub(super) rotation: Option<[f64; 4]>,
    #[serde(default, deserialize_with = "numbers")]
    pub(super) scale: Option<[f64; 3]>,
    extensions: Option<NodeExtensions>,
}

impl Node {
    pub(super) fn has_gpu_instances(&self) -> bool {
        self.extensions.as_ref().is_some_and(|e| e.gpu_instancing.is_some())
    }
}

#[derive(Debug, Deserialize)]
struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    gpu_instancing: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub(super) nodes: Vec<Whole>,
}

/// A list of exactly `N` numbers.
fn numbers<'de, const N: usize, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; N]>, D::Error> {
    let list = Vec::<f64>::deserialize(deserializer)?;
    let seen = list.len();
    list.try_into()
        .map(Some)
        .map_err(|_| D::Error::custom(format_args!("{seen} numbers, {N} are needed")))
}
