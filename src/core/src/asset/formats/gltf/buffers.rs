//! The bytes behind buffers and buffer views, wherever they are kept.

use super::compressed;
use super::document::GltfDocument;
use super::uri::{self, UriTarget};
use crate::asset::files::ReadWatch;
use crate::asset::{Error, FileSet};
use bytes::Bytes;
use std::collections::{BTreeMap, BTreeSet};

/// Where a buffer's bytes are kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum BufferOrigin {
    /// The BIN chunk of the GLB.
    Bin,
    /// A data URI.
    Embedded,
    /// A companion file of this name.
    Companion(String),
    /// Nowhere: it only gives the size of what decompression yields, or leaves its bytes to some extension.
    Nowhere,
}

/// One buffer.
pub(super) struct StoredBuffer {
    pub(super) origin: BufferOrigin,
    /// At least as many bytes as the buffer declares; `None` when there are none.
    pub(super) bytes: Option<Bytes>,
}

/// All buffers of a document, and the decompressed views that were asked for.
pub(super) struct BufferBytes<'w> {
    pub(super) stored: Vec<StoredBuffer>,
    decoded: BTreeMap<usize, Vec<u8>>,
    watch: ReadWatch<'w>,
    /// Bytes that are reserved for what is decoded.
    reserved: u64,
}

impl<'w> BufferBytes<'w> {
    /// Finds every buffer's bytes.
    pub(super) fn load(doc: &GltfDocument<'_>, files: &FileSet, watch: &ReadWatch<'w>) -> Result<Self, Error> {
        let mut buffers = Self {
            stored: Vec::with_capacity(doc.buffers.len()),
            decoded: BTreeMap::new(),
            watch: watch.clone(),
            reserved: 0,
        };
        for i in 0..doc.buffers.len() {
            let stored = buffers.load_one(doc, files, i)?;
            buffers.stored.push(stored);
        }
        Ok(buffers)
    }

    fn load_one(&mut self, doc: &GltfDocument<'_>, files: &FileSet, i: usize) -> Result<StoredBuffer, Error> {
        let buffer = &doc.buffers.values[i];
        let place = format!("buffers/{i}/uri");
        let fallback = buffer.is_fallback();
        let (origin, bytes) = match &buffer.uri {
            None if i == 0 && !fallback && doc.container.is_some() => {
                let Some(bin) = doc.container.as_ref().and_then(|c| c.bin) else {
                    return Err(doc.fault.malformed(place, "absent, and the GLB has no BIN chunk"));
                };
                (BufferOrigin::Bin, files.main.slice_ref(bin))
            }
            None => {
                return Ok(StoredBuffer {
                    origin: BufferOrigin::Nowhere,
                    bytes: None,
                });
            }
            Some(text) => match uri::resolve(text, &place, doc.fault, &mut |bytes| self.reserve(bytes))? {
                UriTarget::Embedded(bytes) => (BufferOrigin::Embedded, Bytes::from(bytes)),
                UriTarget::Companion(name) => match files.companions.get(&name) {
                    Some(bytes) => (BufferOrigin::Companion(name), bytes.clone()),
                    None if fallback => {
                        return Ok(StoredBuffer {
                            origin: BufferOrigin::Nowhere,
                            bytes: None,
                        });
                    }
                    None => {
                        return Err(doc.fault.unsupported(
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
            return Err(doc.fault.malformed(format!("buffers/{i}/byteLength"), problem));
        }
        Ok(StoredBuffer {
            origin,
            bytes: Some(bytes),
        })
    }

    /// Reserves bytes that decoding is about to take; released when this is dropped.
    pub(super) fn reserve(&mut self, bytes: u64) -> Result<(), Error> {
        self.watch.reserve(bytes)?;
        self.reserved += bytes;
        Ok(())
    }

    /// Gives back bytes that were reserved and are not held any more.
    pub(super) fn release(&mut self, bytes: u64) {
        self.watch.release(bytes);
        self.reserved -= bytes;
    }

    /// Decompresses what the given accessors need.
    pub(super) fn decode_for(&mut self, doc: &GltfDocument<'_>, accessors: &BTreeSet<usize>) -> Result<(), Error> {
        let needed: BTreeSet<usize> = accessors
            .iter()
            .filter_map(|&a| doc.accessors.get(a))
            .flat_map(|a| {
                let sparse = a
                    .sparse
                    .iter()
                    .flat_map(|s| [s.indices.buffer_view, s.values.buffer_view]);
                a.buffer_view.into_iter().chain(sparse).map(|v| v.index())
            })
            .collect();
        for view in needed {
            let Some(compression) = doc.views.get(view).and_then(|v| v.compression()) else {
                continue;
            };
            if !self.decoded.contains_key(&view) {
                // The filters make a second copy of what the codec gives.
                let bytes = compression.count.0.saturating_mul(compression.byte_stride.0);
                self.reserve(bytes.saturating_mul(2))?;
                let source = self.bytes_of(
                    doc,
                    compression.buffer.index(),
                    compression.offset(),
                    compression.byte_length.0,
                );
                let decoded = compressed::decode(source?, compression, &format!("bufferViews/{view}"), doc.fault)?;
                self.release(bytes);
                self.decoded.insert(view, decoded);
            }
        }
        Ok(())
    }

    /// The bytes of a view; compressed ones must have been asked for with [`BufferBytes::decode_for`].
    pub(super) fn view(&self, doc: &GltfDocument<'_>, index: usize) -> Result<&[u8], Error> {
        if let Some(bytes) = self.decoded.get(&index) {
            return Ok(bytes);
        }
        let Some(view) = doc.views.get(index) else {
            return Err(doc.fault.malformed(format!("bufferViews/{index}"), "does not exist"));
        };
        self.bytes_of(doc, view.buffer.index(), view.offset(), view.byte_length.0)
    }

    fn bytes_of(&self, doc: &GltfDocument<'_>, buffer: usize, offset: u64, length: u64) -> Result<&[u8], Error> {
        let place = || format!("buffers/{buffer}");
        let Some(bytes) = self.stored.get(buffer).and_then(|s| s.bytes.as_ref()) else {
            return Err(doc
                .fault
                .malformed(place(), "holds geometry but has neither a URI nor a BIN chunk"));
        };
        let range = usize::try_from(offset).ok().zip(usize::try_from(length).ok());
        range.and_then(|(o, n)| bytes.get(o..o.checked_add(n)?)).ok_or_else(|| {
            doc.fault
                .malformed(place(), format!("has no {length} bytes from {offset} on"))
        })
    }

    /// The first buffer that new data may be appended to.
    pub(super) fn growing_buffer(&self, doc: &GltfDocument<'_>) -> Option<usize> {
        (0..self.stored.len())
            .find(|&i| self.stored[i].bytes.is_some() && self.is_exclusive(i) && !doc.buffers.values[i].is_fallback())
    }

    /// Whether changing this buffer's bytes changes nothing else: no other buffer is kept in the same place.
    pub(super) fn is_exclusive(&self, index: usize) -> bool {
        let Some(stored) = self.stored.get(index) else {
            return false;
        };
        match &stored.origin {
            BufferOrigin::Nowhere => false,
            BufferOrigin::Bin | BufferOrigin::Embedded => true,
            companion => self.stored.iter().filter(|s| s.origin == *companion).count() == 1,
        }
    }
}

impl Drop for BufferBytes<'_> {
    fn drop(&mut self) {
        self.watch.release(self.reserved);
    }
}
