//! Numbers that every room shares about how rows are stored, and vectors with room to grow.

/// No aggregate: the row has no neighbours, so its own equation already determines it. Also: no vertex, a row of filling.
pub(crate) const NO_ROW: u32 = u32::MAX;

/// Rows that are swept together. No two of them are adjacent.
pub(crate) const SLICE_ROWS: usize = 4;

/// One part in this many of a vector is kept as room for more.
pub(crate) const SLACK: usize = 16;

/// Lengthens `v`. There is always some room left, so that repairs rarely move what they add to; one that is empty is
/// made anew, which leaves it to those who write it first to touch its memory.
pub(crate) fn grow<T: Clone>(v: &mut Vec<T>, more: usize, value: T) {
    if v.is_empty() {
        *v = vec![value; more + more / SLACK];
        v.truncate(more);
        return;
    }
    if v.capacity() - v.len() < more {
        v.reserve_exact(more + v.len() / SLACK);
    }
    v.resize(v.len() + more, value);
}
