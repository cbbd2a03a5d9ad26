//! Numbers and triangles of unit tests.

use glam::DVec3;

/// Numbers from 0 to 1, the same for each seed.
pub fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Triangles of about one size in a box, in no order, each with corners of its own.
pub fn scattered_triangles(count: usize, size: DVec3, seed: u64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut next = random(seed);
    let mut point = || DVec3::new(next(), next(), next());
    let mut points = Vec::new();
    for _ in 0..count {
        let middle = point() * size;
        points.extend((0..3).map(|_| middle + 0.1 * point()));
    }
    let faces = (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    (points, faces)
}
