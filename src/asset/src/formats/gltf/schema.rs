//! The parts of a glTF document that placing and reading triangles needs, as typed values.
//!
//! Everything else in the document is never looked at here, so that an exotic animation or material cannot fail a read.

use serde::Deserialize;
use serde::de::{Deserializer, Error as _, IgnoredAny, Visitor};
use std::collections::BTreeMap;
use std::fmt;

/// The extension of primitives that are kept in Draco.
pub(super) const DRACO: &str = "KHR_draco_mesh_compression";

/// The extensions that compress views.
pub(super) const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// A whole number from zero; `3.0` and `3e0` are the same number as `3`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct WholeNumber(pub(super) u64);

impl WholeNumber {
    /// As an index or size; what does not fit is larger than everything there is.
    pub(super) fn index(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

impl<'de> Deserialize<'de> for WholeNumber {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl Visitor<'_> for Read {
            type Value = WholeNumber;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number from 0")
            }
            fn visit_u64<E: serde::de::Error>(self, v: u64) -> Result<WholeNumber, E> {
                Ok(WholeNumber(v))
            }
            fn visit_f64<E: serde::de::Error>(self, v: f64) -> Result<WholeNumber, E> {
                // Above 2^53 a float no longer says which whole number was meant.
                if (0.0..=9_007_199_254_740_992.0).contains(&v) && v.fract() == 0.0 {
                    Ok(WholeNumber(v as u64))
                } else {
                    Err(E::custom(format_args!("{v:?} is not a whole number from 0")))
                }
            }
            fn visit_i64<E: serde::de::Error>(self, v: i64) -> Result<WholeNumber, E> {
                Err(E::custom(format_args!("{v} is below 0")))
            }
        }
        deserializer.deserialize_any(Read)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AssetHeader {
    pub(super) version: String,
    pub(super) min_version: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct GltfBuffer {
    pub(super) uri: Option<String>,
    pub(super) byte_length: WholeNumber,
    extensions: Option<MeshoptExtensions<FallbackMark>>,
}

impl GltfBuffer {
    /// Whether it only says how large the decompressed data would be.
    pub(super) fn is_fallback(&self) -> bool {
        let marked = |mark: &Option<FallbackMark>| mark.as_ref().is_some_and(|m| m.fallback == Some(true));
        self.extensions
            .as_ref()
            .is_some_and(|e| marked(&e.ext) || marked(&e.khr))
    }
}

/// What the two names of one extension hold.
#[derive(Debug, Deserialize)]
struct MeshoptExtensions<T> {
    #[serde(rename = "EXT_meshopt_compression")]
    ext: Option<T>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr: Option<T>,
}

#[derive(Debug, Deserialize)]
struct FallbackMark {
    fallback: Option<bool>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: WholeNumber,
    byte_offset: Option<WholeNumber>,
    pub(super) byte_length: WholeNumber,
    pub(super) byte_stride: Option<WholeNumber>,
    extensions: Option<MeshoptExtensions<ViewCompression>>,
}

impl BufferView {
    pub(super) fn offset(&self) -> u64 {
        self.byte_offset.map_or(0, |o| o.0)
    }

    /// How its bytes are compressed, when they are.
    pub(super) fn compression(&self) -> Option<&ViewCompression> {
        self.extensions.as_ref().and_then(|e| e.khr.as_ref().or(e.ext.as_ref()))
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ViewCompression {
    pub(super) buffer: WholeNumber,
    byte_offset: Option<WholeNumber>,
    pub(super) byte_length: WholeNumber,
    pub(super) byte_stride: WholeNumber,
    pub(super) count: WholeNumber,
    pub(super) mode: String,
    pub(super) filter: Option<String>,
}

impl ViewCompression {
    pub(super) fn offset(&self) -> u64 {
        self.byte_offset.map_or(0, |o| o.0)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct GltfAccessor {
    pub(super) buffer_view: Option<WholeNumber>,
    byte_offset: Option<WholeNumber>,
    pub(super) component_type: WholeNumber,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: WholeNumber,
    #[serde(rename = "type")]
    pub(super) shape: String,
    pub(super) sparse: Option<SparseOverrides>,
}

impl GltfAccessor {
    pub(super) fn offset(&self) -> u64 {
        self.byte_offset.map_or(0, |o| o.0)
    }

    /// The views that hold its numbers.
    pub(super) fn views(&self) -> impl Iterator<Item = usize> {
        let sparse = self.sparse.iter();
        let sparse = sparse.flat_map(|s| [s.indices.buffer_view, s.values.buffer_view]);
        self.buffer_view.into_iter().chain(sparse).map(WholeNumber::index)
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct SparseOverrides {
    pub(super) count: WholeNumber,
    pub(super) indices: SparseIndices,
    pub(super) values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub(super) buffer_view: WholeNumber,
    #[serde(default)]
    pub(super) byte_offset: WholeNumber,
    pub(super) component_type: WholeNumber,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub(super) buffer_view: WholeNumber,
    #[serde(default)]
    pub(super) byte_offset: WholeNumber,
}

#[derive(Debug, Deserialize)]
pub(super) struct GltfMesh {
    pub(super) name: Option<String>,
    pub(super) primitives: Vec<MeshPrimitive>,
}

/// Accessors by attribute name.
pub(super) type Attributes = BTreeMap<String, WholeNumber>;

#[derive(Debug, Deserialize)]
pub(super) struct MeshPrimitive {
    pub(super) attributes: Attributes,
    pub(super) indices: Option<WholeNumber>,
    mode: Option<WholeNumber>,
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
pub(super) struct GltfNode {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) children: Vec<WholeNumber>,
    pub(super) mesh: Option<WholeNumber>,
    pub(super) skin: Option<WholeNumber>,
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

impl GltfNode {
    pub(super) fn has_gpu_instances(&self) -> bool {
        self.extensions.as_ref().is_some_and(|e| e.gpu_instancing.is_some())
    }
}

#[derive(Debug, Deserialize)]
struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    gpu_instancing: Option<IgnoredAny>,
}

/// A skin; read one by one, so that a damaged one spoils no model that can do without.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct GltfSkin {
    pub(super) joints: Vec<WholeNumber>,
    pub(super) inverse_bind_matrices: Option<WholeNumber>,
}

#[derive(Debug, Deserialize)]
pub(super) struct GltfScene {
    #[serde(default)]
    pub(super) nodes: Vec<WholeNumber>,
}

/// A list of exactly `N` numbers.
fn numbers<'de, const N: usize, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; N]>, D::Error> {
    let list = Vec::<f64>::deserialize(deserializer)?;
    let seen = list.len();
    list.try_into()
        .map(Some)
        .map_err(|_| D::Error::custom(format_args!("{seen} numbers, {N} are needed")))
}
