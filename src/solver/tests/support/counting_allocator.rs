//! An allocator that counts what is asked of it.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};

/// Hands everything to the system's allocator, and counts while [`COUNTING`].
pub struct CountingAllocator;

static COUNTING: AtomicBool = AtomicBool::new(false);
static CALLS: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);
/// Where the first few calls came from.
static TRACES: Mutex<Vec<String>> = Mutex::new(Vec::new());

thread_local! {
    /// Set while a trace is taken, which allocates itself.
    static TRACING: Cell<bool> = const { Cell::new(false) };
}

impl CountingAllocator {
    fn count(size: usize) {
        if !COUNTING.load(SeqCst) || TRACING.get() {
            return;
        }
        BYTES.fetch_add(size, SeqCst);
        let before = CALLS.fetch_add(1, SeqCst);
        // The first few, and large ones.
        if before < 8 || (size >= 4096 && before < 64) {
            TRACING.set(true);
            let trace = std::backtrace::Backtrace::force_capture().to_string();
            let ours = trace.lines().filter(|l| l.contains("pliant_") || l.contains("rayon"));
            let ours: Vec<&str> = ours.take(6).collect();
            TRACES
                .lock()
                .unwrap()
                .push(format!("{size} bytes from\n{}", ours.join("\n")));
            TRACING.set(false);
        }
    }
}

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::count(layout.size());
        // SAFETY: by the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        Self::count(layout.size());
        // SAFETY: by the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        Self::count(size);
        // SAFETY: by the caller's promise.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: by the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// What was asked of the allocator.
pub struct Asked {
    pub calls: usize,
    pub bytes: usize,
    /// Where the first few calls came from.
    pub traces: Vec<String>,
}

/// Counts what `work` asks for. One caller at a time, and no other thread of the process at work.
pub fn counted<R>(work: impl FnOnce() -> R) -> (R, Asked) {
    CALLS.store(0, SeqCst);
    BYTES.store(0, SeqCst);
    COUNTING.store(true, SeqCst);
    let result = work();
    COUNTING.store(false, SeqCst);
    let asked = Asked {
        calls: CALLS.load(SeqCst),
        bytes: BYTES.load(SeqCst),
        traces: std::mem::take(&mut *TRACES.lock().unwrap()),
    };
    (result, asked)
}
