//! Making a flat triangulation Delaunay by exchanging edges (Lawson).

use super::planar::{coord, turn};
use crate::progress::{Cancelled, Progress, check};
use glam::DVec2;
use std::collections::BTreeMap;

/// Exchanges inner edges until each triangle's circle is empty of its neighbours' corners. Triangles without area go
/// first. Edges that already exist are never made twice.
pub(super) fn make_delaunay(
    at: &[DVec2],
    triangles: &mut [[u32; 3]],
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    let mut owner: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut queue: Vec<(u32, u32)> = Vec::new();
    for (t, i) in triangles.iter().zip(0u32..) {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if owner.insert((a, b), i).is_some() {
                // Entangled loops: leave them as they are.
                return Ok(());
            }
            queue.push((a.min(b), a.max(b)));
        }
    }
    let place = |p: u32| at[p as usize];
    let far = |t: [u32; 3], a: u32, b: u32| t.into_iter().find(|&p| p != a && p != b);
    // Lawson's flips end by themselves; the count guards against rounding in places that are not numbers.
    let mut budget = 64 * triangles.len() + 4096;
    while let Some((a, b)) = queue.pop() {
        let (Some(&f), Some(&g)) = (owner.get(&(a, b)), owner.get(&(b, a))) else {
            continue;
        };
        let (Some(p), Some(q)) = (far(triangles[f as usize], a, b), far(triangles[g as usize], a, b)) else {
            continue;
        };
        if p == q || owner.contains_key(&(p, q)) || owner.contains_key(&(q, p)) {
            continue;
        }
        // f is (a, b, p), g is (b, a, q).
        let [point_a, point_b, pp, pq] = [a, b, p, q].map(place);
        if turn(point_a, pq, pp) <= 0.0 || turn(pq, point_b, pp) <= 0.0 {
            continue;
        }
        let flat = turn(point_a, point_b, pp) <= 0.0 || turn(point_b, point_a, pq) <= 0.0;
        if !flat && robust::incircle(coord(point_a), coord(point_b), coord(pp), coord(pq)) <= 0.0 {
            continue;
        }
        budget -= 1;
        if budget == 0 {
            return Ok(());
        }
        if budget.is_multiple_of(256) {
            check(progress)?;
        }
        triangles[f as usize] = [a, q, p];
        triangles[g as usize] = [q, b, p];
        owner.remove(&(a, b));
        owner.remove(&(b, a));
        for (edge, face) in [
            ((a, q), f),
            ((q, p), f),
            ((p, a), f),
            ((q, b), g),
            ((b, p), g),
            ((p, q), g),
        ] {
            owner.insert(edge, face);
        }
        queue.extend([(a, q), (q, b), (b, p), (p, a)].map(|(x, y): (u32, u32)| (x.min(y), x.max(y))));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn a_fan_over_a_strip_becomes_its_ladder() {
        // Two rows of six places; the fan from the first has slivers, one triangle in it has no area.
        let at: Vec<DVec2> = (0..6)
            .map(|k| DVec2::new(f64::from(k), 0.0))
            .chain((0..6).rev().map(|k| DVec2::new(f64::from(k), 1.0)))
            .collect();
        let mut triangles: Vec<[u32; 3]> = (1..11).map(|k| [0, k, k + 1]).collect();
        make_delaunay(&at, &mut triangles, &Silent).expect("not cancelled");
        for t in &triangles {
            let [a, b, c] = t.map(|p| at[p as usize]);
            assert_eq!(turn(a, b, c), 1.0, "{t:?}");
            assert!(
                (a.x - b.x).abs().max((b.x - c.x).abs()).max((c.x - a.x).abs()) == 1.0,
                "{t:?}"
            );
        }
    }
}
