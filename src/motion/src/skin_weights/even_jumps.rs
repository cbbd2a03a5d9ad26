//! Weights that change little from one vertex of a mesh to the next, on coarse meshes too.

use super::HeaviestWeights;
use crate::decomposition::JoinedVertices;
use crate::skeleton::BoneInfluences;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// The largest difference of a weight across an edge that is left alone.
const JUMP: f64 = 0.45;
/// Times that weights beside jumps take the mean of what is around them.
const ROUNDS: usize = 48;
/// Rounds after which the vertices around those are evened out too.
const WIDER: usize = 16;

/// Evens weights out where one changes by more than 0.45 along an edge. `few` are those that a point follows of all that it could.
pub(super) fn even_jumps(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    few: impl Fn(&HeaviestWeights, DVec3) -> BoneInfluences,
    influences: &mut [BoneInfluences],
    exec: &Exec<'_>,
) -> Result<(), Cancelled> {
    let joined = JoinedVertices::of_triangles(positions, triangles);
    for round in 0..ROUNDS {
        exec.check()?;
        let chosen = joined.beside_jumps(influences, JUMP, round / WIDER);
        if chosen.is_empty() {
            break;
        }
        let means = joined.means(influences, 1, exec)?;
        for vertex in chosen {
            let vertex = vertex as usize;
            let mut heaviest = HeaviestWeights::default();
            means[vertex]
                .iter()
                .for_each(|(bone, weight)| heaviest.add(*bone, *weight));
            influences[vertex] = few(&heaviest, positions[vertex]);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{SkinBone, SkinWeightOptions, skin_weights};
    use super::*;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    #[test]
    fn weights_of_a_mesh_as_coarse_as_its_bones_do_not_jump() {
        let corners = [[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]];
        let ring = |k: u32| corners.map(|[x, z]| DVec3::new(x, f64::from(k), z));
        let positions: Vec<DVec3> = (0..6).flat_map(ring).collect();
        let side = |k: u32, i: u32| {
            let [a, b] = [4 * k + i, 4 * k + (i + 1) % 4];
            [[a, a + 4, b], [b, a + 4, b + 4]]
        };
        let sides = (0..5).flat_map(|k| (0..4).flat_map(move |i| side(k, i)));
        let triangles: Vec<[u32; 3]> = sides.collect();
        let bone = |k: usize| SkinBone {
            ends: [-0.4, 0.4].map(|y| DVec3::Y * (k as f64 + y)),
            parent: k.checked_sub(1),
        };
        let bones: Vec<SkinBone> = (0..6).map(bone).collect();
        let pool = Pool::new(1).expect("a pool");
        let options = SkinWeightOptions {
            cells: 1 << 12,
            ..SkinWeightOptions::default()
        };
        let found =
            skin_weights(&positions, &triangles, &bones, &options, &Exec::new(&pool, &Silent)).expect("weights");
        let joined = JoinedVertices::of_triangles(&positions, &triangles);
        assert!(joined.beside_jumps(&found, 0.5, 0).is_empty(), "{found:?}");
        assert!((0..24).all(|v| found[v].bones[0] as usize == v / 4), "{found:?}");
    }
}
