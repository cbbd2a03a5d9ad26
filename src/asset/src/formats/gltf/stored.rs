//! The bytes of buffers, where they are kept, and what of them is decompressed.

use crate::Error;
use crate::apart::{ParserCalls, ParserStarter};
use crate::files::ReadWatch;
use bytes::Bytes;
use pliant_exec::progress::Progress;
use std::cell::{Cell, OnceCell, RefCell};

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

/// How views are decompressed.
#[derive(Clone, Copy, Default)]
pub(super) struct ViewDecoding<'w> {
    /// What starts the process that decompresses; without it, views are decompressed in this one.
    pub(super) apart: Option<ParserStarter>,
    /// Who waits for that process; without it, its own time ends the wait.
    pub(super) progress: Option<&'w dyn Progress>,
}

/// The bytes of all buffers of a document, and the decompressed views that were asked for.
#[derive(Default)]
pub(super) struct BufferBytes<'w> {
    pub(super) stored: Vec<StoredBuffer>,
    /// By view.
    pub(super) decoded: Vec<OnceCell<Vec<u8>>>,
    /// Allows the bytes of what is decoded; without it they are not counted.
    pub(super) watch: Option<ReadWatch<'w>>,
    pub(super) decoding: ViewDecoding<'w>,
    /// The process that decompresses, once it was needed.
    pub(super) calls: RefCell<Option<ParserCalls>>,
    /// Bytes that are reserved for what is decoded.
    reserved: Cell<u64>,
}

impl BufferBytes<'_> {
    /// Reserves bytes that decoding is about to take; released when this is dropped.
    pub(super) fn reserve(&self, bytes: u64) -> Result<(), Error> {
        if let Some(watch) = &self.watch {
            watch.reserve(bytes)?;
            self.reserved.set(self.reserved.get() + bytes);
        }
        Ok(())
    }

    /// Gives back bytes that were reserved and are not held any more.
    pub(super) fn release(&self, bytes: u64) {
        if let Some(watch) = &self.watch {
            watch.release(bytes);
            self.reserved.set(self.reserved.get() - bytes);
        }
    }
}

impl Drop for BufferBytes<'_> {
    fn drop(&mut self) {
        self.release(self.reserved.get());
    }
}
