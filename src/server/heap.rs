//! How the process of a server keeps its heap.

/// Keeps one heap for all threads, where the C library would give each thread a part of its own.
///
/// What one thread has freed another does not use then, and a server, whose sessions wander over its threads, creeps up to what
/// all of them have needed at some time. With one part its memory stays level (`loadtest soak`); large blocks are the operating system's
/// either way. To be called when the process starts.
pub fn use_one_heap() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: sets a number that the allocator reads when a thread first asks for memory; it has no other effect.
        unsafe { libc::mallopt(libc::M_ARENA_MAX, 1) };
    }
}
