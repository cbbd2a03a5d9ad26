//! Constants of row storage, and how vectors get their memory.

use bytemuck::{Zeroable, zeroed_vec};

/// No aggregate: the row has no neighbours, so its own equation already determines it. Also: no vertex, a row of filling.
pub(crate) const NO_ROW: u32 = u32::MAX;

/// Rows that are swept together. No two of them are adjacent.
pub(crate) const SLICE_ROWS: usize = 4;

/// One part in this many of a vector is kept as room for more.
pub(crate) const SLACK: usize = 16;

/// Sets the length of `v`; its contents are then unspecified, old values or zeros. New memory is not touched yet: its
/// first writers do that, on all threads, which for large vectors takes longer than the writing.
///
/// A vector that grows gets some spare room, as edits let it grow again; room costs nothing until it is touched.
pub(crate) fn resize_untouched<T: Zeroable + Clone>(v: &mut Vec<T>, n: usize) {
    if v.capacity() < n {
        let room = if v.capacity() > 0 { n / SLACK } else { 0 };
        *v = Vec::new();
        *v = zeroed_vec(n + room);
        v.truncate(n);
    } else {
        v.resize(n, T::zeroed());
    }
}

/// Lengthens `v`, with some spare room, so that repairs rarely move it. An empty one is reallocated, so that its first
/// writers touch its memory.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Lanes;

    #[test]
    fn vectors_have_the_length_that_was_asked_for_and_zeros_where_they_are_new() {
        let mut v: Vec<Lanes> = Vec::new();
        resize_untouched(&mut v, 5);
        assert_eq!(v, [Lanes::ZERO; 5]);
        v.fill(Lanes([1.0; 4]));
        resize_untouched(&mut v, 2);
        resize_untouched(&mut v, 4);
        assert!(v.len() == 4 && v[2..] == [Lanes::ZERO; 2]);
        resize_untouched(&mut v, 1000);
        assert_eq!(v, [Lanes::ZERO; 1000]);
    }
}
