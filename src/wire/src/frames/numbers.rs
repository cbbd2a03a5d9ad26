//! The numbers of vertices as bytes.
//!
//! Vertices are taken in tiles that stay in the nearest cache and go from there to where they are sent from, so each number is
//! read once and written once. Bytes depend on the vertices alone, never on how they are cut into tiles.

use bytes::BufMut;
use glam::{DVec3, Vec3, Vec4};

/// Vertices that are taken at once: whole turns of [`LANES`] numbers, three or four a vertex.
const TILE: usize = 252;

/// What a vertex has: `N` numbers.
pub(super) trait VertexNumbers<const N: usize>: Copy + Default {
    /// Rounded to 32 bits.
    fn floats(self) -> [f32; N];
    /// As they are.
    fn doubles(self) -> [f64; N];
}

impl VertexNumbers<3> for DVec3 {
    fn floats(self) -> [f32; 3] {
        self.as_vec3().to_array()
    }
    fn doubles(self) -> [f64; 3] {
        self.to_array()
    }
}

impl VertexNumbers<3> for Vec3 {
    fn floats(self) -> [f32; 3] {
        self.to_array()
    }
    fn doubles(self) -> [f64; 3] {
        self.as_dvec3().to_array()
    }
}

impl VertexNumbers<4> for Vec4 {
    fn floats(self) -> [f32; 4] {
        self.to_array()
    }
    fn doubles(self) -> [f64; 4] {
        self.as_dvec4().to_array()
    }
}

/// Vertices to write: some that follow one another, or those that a list names.
#[derive(Debug, Clone, Copy)]
pub(super) enum PickedVertices<'a, V> {
    Run(&'a [V]),
    Listed { all: &'a [V], list: &'a [u32] },
}

impl<V: Copy + Default> PickedVertices<'_, V> {
    fn for_each_tile(self, mut take: impl FnMut(&[V])) {
        match self {
            Self::Run(vertices) => vertices.chunks(TILE).for_each(take),
            Self::Listed { all, list } => {
                let mut tile = [V::default(); TILE];
                for list in list.chunks(TILE) {
                    for (to, &v) in tile.iter_mut().zip(list) {
                        *to = all[v as usize];
                    }
                    take(&tile[..list.len()]);
                }
            }
        }
    }
}

/// Writes little-endian 32-bit floats.
pub(super) fn put_floats<const N: usize, V: VertexNumbers<N>>(vertices: PickedVertices<'_, V>, out: &mut impl BufMut) {
    let mut bytes = [[[0u8; 4]; N]; TILE];
    vertices.for_each_tile(|tile| {
        for (to, vertex) in bytes.iter_mut().zip(tile) {
            *to = vertex.floats().map(f32::to_le_bytes);
        }
        out.put_slice(bytes[..tile.len()].as_flattened().as_flattened());
    });
}

/// Writes little-endian 16-bit steps.
pub(super) fn put_steps<const N: usize, V: VertexNumbers<N>>(
    vertices: PickedVertices<'_, V>,
    steps: &Steps<N>,
    out: &mut impl BufMut,
) {
    let (mut nearest, mut bytes) = ([[0u16; N]; TILE], [[[0u8; 2]; N]; TILE]);
    vertices.for_each_tile(|tile| {
        steps.nearest(tile, &mut nearest);
        for (to, steps) in bytes.iter_mut().zip(&nearest) {
            *to = steps.map(u16::to_le_bytes);
        }
        out.put_slice(bytes[..tile.len()].as_flattened().as_flattened());
    });
}

/// Writes 16-bit steps, four a vertex, those that it does not have 0, as meshopt takes them.
pub(super) fn push_padded_steps<const N: usize, V: VertexNumbers<N>>(
    vertices: PickedVertices<'_, V>,
    steps: &Steps<N>,
    out: &mut Vec<[u16; 4]>,
) {
    let mut nearest = [[0u16; N]; TILE];
    vertices.for_each_tile(|tile| {
        steps.nearest(tile, &mut nearest);
        out.extend(nearest[..tile.len()].iter().map(|steps| {
            let mut padded = [0; 4];
            padded[..N].copy_from_slice(&steps.map(u16::to_le));
            padded
        }));
    });
}

/// Replaces steps by how far they are from those held, modulo 65536, and these by them.
pub(super) fn take_differences(steps: &mut [[u16; 4]], held: &mut [[u16; 4]]) {
    for (step, held) in steps.as_flattened_mut().iter_mut().zip(held.as_flattened_mut()) {
        let now = u16::from_le(*step);
        *step = now.wrapping_sub(u16::from_le(*held)).to_le();
        *held = now.to_le();
    }
}

/// Numbers that are rounded at once: whole vertices of three as of four numbers.
const LANES: usize = 12;

/// The 65536 steps of each number of a vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steps<const N: usize> {
    /// Of number `k` of a vertex in every place that is `k` modulo `N`.
    low: [f64; LANES],
    span: [f64; LANES],
}

impl<const N: usize> Steps<N> {
    /// From `low` to `high`. A number without extent is step 0.
    pub fn between(low: [f64; N], high: [f64; N]) -> Self {
        let mut steps = Self {
            low: std::array::from_fn(|k| low[k % N]),
            span: [1.0; LANES],
        };
        for k in 0..LANES {
            let span = high[k % N] - low[k % N];
            if span > 0.0 {
                steps.span[k] = span;
            } else {
                // Every number lies below the first step.
                steps.low[k] = f64::INFINITY;
            }
        }
        steps
    }

    /// The nearest steps of as many vertices as are given, at most a tile of them.
    fn nearest<V: VertexNumbers<N>>(&self, vertices: &[V], steps: &mut [[u16; N]; TILE]) {
        let mut numbers = [[0.0f64; N]; TILE];
        for (to, vertex) in numbers.iter_mut().zip(vertices) {
            *to = vertex.doubles();
        }
        let count = (vertices.len() * N).next_multiple_of(LANES);
        let numbers = numbers.as_flattened()[..count].chunks_exact(LANES);
        for (steps, numbers) in steps.as_flattened_mut().chunks_exact_mut(LANES).zip(numbers) {
            for k in 0..LANES {
                steps[k] = nearest_step(numbers[k], self.low[k], self.span[k]);
            }
        }
    }
}

/// The nearest of 65536 steps from `low` over `span`, the upper of two that are as near; NaN is step 0. `f64::round`
/// gives the same with a call for each number.
fn nearest_step(value: f64, low: f64, span: f64) -> u16 {
    let place = (value - low) / span * 65535.0;
    let place = if place > 0.0 { place } else { 0.0 };
    let place = if place < 65535.0 { place } else { 65535.0 };
    // Numbers between this and twice this are whole, and their last bits count from it.
    const WHOLE: f64 = (1u64 << 52) as f64;
    let even = place + WHOLE;
    // Of two that are as near the sum has taken the even one; the difference is exact.
    let is_below = place - (even - WHOLE) == 0.5;
    (even.to_bits() + u64::from(is_below)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// As it is defined.
    fn defined(value: f64, low: f64, high: f64) -> u16 {
        let span = high - low;
        if span > 0.0 {
            ((value - low) / span * 65535.0).round().clamp(0.0, 65535.0) as u16
        } else {
            0
        }
    }

    fn step(value: f64, low: f64, high: f64) -> u16 {
        let mut steps = [[0; 3]; TILE];
        Steps::between([low; 3], [high; 3]).nearest(&[DVec3::splat(value)], &mut steps);
        assert!(steps[0].iter().all(|&step| step == steps[0][0]), "{:?}", steps[0]);
        steps[0][0]
    }

    proptest! {
        #[test]
        fn steps_are_rounded_as_they_are_defined(value in any::<f64>(), low in any::<f64>(), high in any::<f64>()) {
            prop_assert_eq!(step(value, low, high), defined(value, low, high));
        }

        #[test]
        fn so_are_those_within_a_box_and_between_two_steps(at in 0u32..131_071, off in -2i64..3, low in -1e3f64..1e3, span in 0.0f64..1e3) {
            // Halves of steps, and the numbers next to them.
            let half = f64::from_bits((f64::from(at) * 0.5).to_bits().saturating_add_signed(off));
            prop_assert_eq!(step(half, 0.0, 65535.0), defined(half, 0.0, 65535.0));
            let value = low + span * half / 65535.0;
            prop_assert_eq!(step(value, low, low + span), defined(value, low, low + span));
        }
    }

    #[test]
    fn what_is_no_number_or_has_no_end_has_a_step_too() {
        for value in [
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            -0.0,
            0.499_999_999_999_999_94,
        ] {
            for (low, high) in [
                (0.0, 65535.0),
                (0.0, 0.0),
                (1.0, f64::INFINITY),
                (f64::NAN, 1.0),
                (0.0, f64::MIN_POSITIVE),
            ] {
                assert_eq!(
                    step(value, low, high),
                    defined(value, low, high),
                    "{value} in {low} to {high}"
                );
            }
        }
    }

    #[test]
    fn steps_of_tiles_join_without_a_seam() {
        let vertices: Vec<Vec4> = (0..2 * TILE + 7)
            .map(|i| (Vec4::new(0.1, -0.2, 0.3, -1.0) * i as f32).clamp(Vec4::NEG_ONE, Vec4::ONE))
            .collect();
        let mut written = Vec::new();
        let steps = Steps::between([-1.0, -1.0, -0.5, -1.0], [1.0, 1.0, 2.0, -1.0]);
        put_steps(PickedVertices::Run(&vertices), &steps, &mut written);
        let of = |v: &Vec4| {
            let [x, y, z, w] = v.as_dvec4().to_array();
            let steps = [
                defined(x, -1.0, 1.0),
                defined(y, -1.0, 1.0),
                defined(z, -0.5, 2.0),
                defined(w, -1.0, -1.0),
            ];
            steps.map(u16::to_le_bytes)
        };
        let one_by_one: Vec<u8> = vertices.iter().flat_map(of).flatten().collect();
        assert!(written == one_by_one);
        let mut padded = Vec::new();
        push_padded_steps(PickedVertices::Run(&vertices), &steps, &mut padded);
        let padded: Vec<u8> = padded.iter().flatten().flat_map(|step| step.to_ne_bytes()).collect();
        assert!(padded == one_by_one);
    }

    #[test]
    fn tiles_join_without_a_seam() {
        let vertices: Vec<DVec3> = (0..2 * TILE + 3).map(|i| DVec3::splat(i as f64) / 3.0).collect();
        let mut written = Vec::new();
        put_floats(PickedVertices::Run(&vertices), &mut written);
        let one_by_one: Vec<u8> = vertices
            .iter()
            .flat_map(|v| v.floats().map(f32::to_le_bytes))
            .flatten()
            .collect();
        assert!(written == one_by_one);
        let list: Vec<u32> = (0..vertices.len() as u32).collect();
        let (all, list) = (&vertices[..], &list[..]);
        let mut listed = Vec::new();
        put_floats(PickedVertices::Listed { all, list }, &mut listed);
        assert!(written == listed);
    }
}
