//! Four columns side by side, and rows that several threads write.
//!
//! Constants of row storage, and how vectors get their memory.

use bytemuck::{Zeroable, zeroed_vec};
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Mul, Range, Sub, SubAssign};

/// Columns that are iterated together.
pub(crate) const WIDTH: usize = 4;

/// One row of up to four columns in single precision.
#[derive(Debug, Clone, Copy, Default, PartialEq, Zeroable)]
#[repr(C, align(16))]
pub struct Lanes(pub [f32; 4]);

/// One row of up to four columns in double precision.
pub(crate) type WideLanes = [f64; WIDTH];

impl Lanes {
    /// All 0.
    pub const ZERO: Lanes = Lanes([0.0; WIDTH]);

    #[inline(always)]
    pub(crate) fn splat(v: f32) -> Lanes {
        Lanes([v; WIDTH])
    }

    #[inline(always)]
    pub(crate) fn from_wide(v: WideLanes) -> Lanes {
        Lanes([v[0] as f32, v[1] as f32, v[2] as f32, v[3] as f32])
    }

    #[inline(always)]
    pub(crate) fn to_wide(self) -> WideLanes {
        let a = self.0;
        [f64::from(a[0]), f64::from(a[1]), f64::from(a[2]), f64::from(a[3])]
    }

    /// Itself if `keep`, else 0.
    #[inline(always)]
    pub(crate) fn masked_by(self, keep: bool) -> Lanes {
        let mask = u32::from(keep).wrapping_neg();
        let [a, b, c, d] = self.0;
        let masked = |v: f32| f32::from_bits(v.to_bits() & mask);
        Lanes([masked(a), masked(b), masked(c), masked(d)])
    }

    /// Sum of the lanes.
    #[inline(always)]
    pub(crate) fn sum_lanes(self) -> f32 {
        let a = self.0;
        (a[0] + a[1]) + (a[2] + a[3])
    }
}

impl Add for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn add(self, o: Lanes) -> Lanes {
        let (a, b) = (self.0, o.0);
        Lanes([a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]])
    }
}

impl Sub for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn sub(self, o: Lanes) -> Lanes {
        let (a, b) = (self.0, o.0);
        Lanes([a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]])
    }
}

impl Mul for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn mul(self, o: Lanes) -> Lanes {
        let (a, b) = (self.0, o.0);
        Lanes([a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]])
    }
}

impl Mul<f32> for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn mul(self, o: f32) -> Lanes {
        self * Lanes::splat(o)
    }
}

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, o: Lanes) {
        *self = *self + o;
    }
}

impl SubAssign for Lanes {
    #[inline(always)]
    fn sub_assign(&mut self, o: Lanes) {
        *self = *self - o;
    }
}

/// Adds `b` to `a` lane by lane.
#[inline(always)]
pub(crate) fn add_wide(a: &mut WideLanes, b: WideLanes) {
    for c in 0..WIDTH {
        a[c] += b[c];
    }
}

pub(crate) fn per_lane(mut value: impl FnMut(usize) -> f64) -> WideLanes {
    [value(0), value(1), value(2), value(3)]
}

/// a / b, or 0 where that makes no sense: a lane without residual takes no step.
pub(crate) fn ratio(a: f64, b: f64) -> f64 {
    let q = a / b;
    if b > 0.0 && q.is_finite() { q } else { 0.0 }
}

/// Work on many numbers that [`eight_wide`] does.
pub(crate) trait NumberWork {
    type Output;
    /// Does it. Has to be `#[inline(always)]`, with all that counts in it.
    fn run(self) -> Self::Output;
}

/// Does `work` in instructions for eight numbers at a time where the processor has them; they give the same bits.
#[inline(always)]
pub(crate) fn eight_wide<W: NumberWork>(work: W) -> W::Output {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        #[target_feature(enable = "avx2")]
        fn with_avx2<W: NumberWork>(work: W) -> W::Output {
            work.run()
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has them.
            return unsafe { with_avx2(work) };
        }
    }
    work.run()
}

/// Asks for the line of a cache that holds element `i`, if there is one, long before it is read. What follows an order that
/// no hardware foresees waits for memory otherwise. Nothing comes of it but time.
#[inline(always)]
pub fn prefetch<T>(slice: &[T], i: usize) {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint reads nothing, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(slice.as_ptr().wrapping_add(i).cast()) };
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    let _ = (slice, i);
}

/// A slice whose elements several threads read and write, each element by one thread at a time.
///
/// This is the solver's one unsafe tool, hints to a cache aside. A Gauss–Seidel sweep writes the rows of one block while it reads rows of
/// blocks of other colours, which borrows cannot express.
pub(crate) struct SharedRows<'a, T> {
    pointer: *mut T,
    len: usize,
    marker: PhantomData<&'a mut [T]>,
}

// SAFETY: a `SharedRows` only hands out elements through unsafe functions whose callers promise that no element is written
// by one thread while another one uses it.
unsafe impl<T: Send + Sync> Send for SharedRows<'_, T> {}
// SAFETY: as above.
unsafe impl<T: Send + Sync> Sync for SharedRows<'_, T> {}

impl<T> Clone for SharedRows<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for SharedRows<'_, T> {}

impl<'a, T: Copy> SharedRows<'a, T> {
    /// Takes the whole slice for as long as the borrow lasts.
    pub(crate) fn new(slice: &'a mut [T]) -> Self {
        Self {
            pointer: slice.as_mut_ptr(),
            len: slice.len(),
            marker: PhantomData,
        }
    }

    /// Element `i`.
    ///
    /// # Safety
    /// `i` is below the length and no thread writes element `i` at this time.
    #[inline(always)]
    pub(crate) unsafe fn get(self, i: usize) -> T {
        debug_assert!(i < self.len);
        // SAFETY: in range, and not written now, by the caller's promise.
        unsafe { *self.pointer.add(i) }
    }

    /// Replaces element `i`.
    ///
    /// # Safety
    /// `i` is below the length and no other thread uses element `i` at this time.
    #[inline(always)]
    pub(crate) unsafe fn set(self, i: usize, value: T) {
        debug_assert!(i < self.len);
        // SAFETY: in range, and used by this thread only, by the caller's promise.
        unsafe { *self.pointer.add(i) = value }
    }
}

/// Vectors of as many elements, of which several threads use disjoint ranges of rows at the same time.
pub(crate) trait RowVectors: Sized {
    /// The vectors as all threads see them.
    type Shared: Copy + Send + Sync;

    /// Gives the vectors to all threads for as long as their borrow lasts.
    fn share(self) -> Self::Shared;

    /// The elements of `range`.
    ///
    /// # Panics
    /// If `range` leaves a vector.
    ///
    /// # Safety
    /// Nothing else uses these elements while the result lives.
    unsafe fn rows(shared: Self::Shared, range: Range<usize>) -> Self;
}

/// No vector.
impl RowVectors for () {
    type Shared = ();

    fn share(self) {}

    #[inline(always)]
    unsafe fn rows(_: (), _: Range<usize>) {}
}

impl<'a, T: Copy + Send + Sync> RowVectors for &'a mut [T] {
    type Shared = SharedRows<'a, T>;

    fn share(self) -> SharedRows<'a, T> {
        SharedRows::new(self)
    }

    #[inline(always)]
    unsafe fn rows(shared: SharedRows<'a, T>, range: Range<usize>) -> &'a mut [T] {
        assert!(range.start <= range.end && range.end <= shared.len);
        // SAFETY: in range by the assertion, exclusive by the caller's promise.
        unsafe { std::slice::from_raw_parts_mut(shared.pointer.add(range.start), range.len()) }
    }
}

impl<A: RowVectors, B: RowVectors> RowVectors for (A, B) {
    type Shared = (A::Shared, B::Shared);

    fn share(self) -> Self::Shared {
        (self.0.share(), self.1.share())
    }

    #[inline(always)]
    unsafe fn rows(shared: Self::Shared, range: Range<usize>) -> Self {
        // SAFETY: by the caller's promise, which holds for both.
        unsafe { (A::rows(shared.0, range.clone()), B::rows(shared.1, range)) }
    }
}

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
