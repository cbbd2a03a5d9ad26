//! An allocator that knows how much each thread, and the whole process, holds and held at most.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicI64, Ordering::Relaxed};

/// Hands everything to the system's allocator, and counts it for the thread that asks and for all.
pub struct PeakAllocator;

thread_local! {
    /// Bytes that the thread has taken and not given back: less than none where it gives back what others took.
    static HELD: Cell<i64> = const { Cell::new(0) };
    /// The most that this was.
    static MOST: Cell<i64> = const { Cell::new(0) };
}

/// The same of all threads together.
static HELD_BY_ALL: AtomicI64 = AtomicI64::new(0);
static MOST_BY_ALL: AtomicI64 = AtomicI64::new(0);

fn count(bytes: i64) {
    let held = HELD_BY_ALL.fetch_add(bytes, Relaxed) + bytes;
    MOST_BY_ALL.fetch_max(held, Relaxed);
    // Gone while a thread ends.
    let _ = HELD.try_with(|held| {
        held.set(held.get() + bytes);
        let _ = MOST.try_with(|most| most.set(most.get().max(held.get())));
    });
}

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for PeakAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: by the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: by the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Where the block moves, both are held for a moment.
        count(size as i64);
        // SAFETY: by the caller's promise.
        let moved = unsafe { System.realloc(pointer, layout, size) };
        count(-(layout.size() as i64));
        moved
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as i64));
        // SAFETY: by the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// What `work` gives, and the bytes that this thread held at most beside what it held before.
#[allow(dead_code, reason = "each program has a use for one of the two")]
pub fn peak_of<R>(work: impl FnOnce() -> R) -> (R, u64) {
    let before = HELD.get();
    MOST.set(before);
    let result = work();
    (result, u64::try_from(MOST.get() - before).unwrap_or(0))
}

/// What `work` gives, and the bytes that all threads together held at most beside what they held before. Nothing else may run.
#[allow(dead_code, reason = "each program has a use for one of the two")]
pub fn peak_of_all<R>(work: impl FnOnce() -> R) -> (R, u64) {
    let before = HELD_BY_ALL.load(Relaxed);
    MOST_BY_ALL.store(before, Relaxed);
    let result = work();
    (result, u64::try_from(MOST_BY_ALL.load(Relaxed) - before).unwrap_or(0))
}
