//! A short text that is equal for two shapes with the same bits.

use glam::DVec3;

/// Digest of positions: `xxh3:` and 16 hexadecimal digits of the 64-bit XXH3 of x, y, z of each vertex as
/// little-endian 64-bit floats.
pub fn digest(positions: &[DVec3]) -> String {
    let mut hasher = xxhash_rust::xxh3::Xxh3::new();
    let mut block = [0u8; 24 * 64];
    for run in positions.chunks(64) {
        for (at, number) in block.chunks_exact_mut(8).zip(run.iter().flat_map(|p| p.to_array())) {
            at.copy_from_slice(&number.to_le_bytes());
        }
        hasher.update(&block[..run.len() * 24]);
    }
    format!("xxh3:{:016x}", hasher.digest())
}
