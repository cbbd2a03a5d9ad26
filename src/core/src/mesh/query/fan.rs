//! Fans: the groups into which the faces around a vertex fall when neighbours share an edge at that vertex.

use crate::mesh::components::Components;

/// Groups the faces around a vertex: answers the fan of each face, numbered in the order of the first face of each, and how
/// many fans there are.
///
/// A spoke is an edge from the vertex to another, given as that other vertex and the face (below `faces`) that has the edge.
/// Faces with a common spoke are in one fan.
///
/// ```
/// use pliant_core::mesh::query::fan::group_fans;
///
/// // Faces 0 and 1 share the spoke to vertex 8; face 2 has spokes of its own.
/// let spokes = [(7, 0), (8, 0), (8, 1), (9, 1), (4, 2), (5, 2)];
/// assert_eq!(group_fans(3, spokes), (vec![0, 0, 1], 2));
/// ```
pub fn group_fans(faces: usize, spokes: impl IntoIterator<Item = (u32, u32)>) -> (Vec<u32>, usize) {
    let mut spokes: Vec<(u32, u32)> = spokes.into_iter().collect();
    spokes.sort_unstable();
    let shared = spokes.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    let fans = Components::of_edges(faces, shared.map(|pair| (pair[0].1, pair[1].1)));
    (fans.of_vertex, fans.count)
}

/// Returns whether directed links make one path or one ring. Each face around a vertex gives one link, from its corner
/// after the vertex to its corner before it; so the faces make one fan, open or closed, of one winding. Sorts links.
pub fn is_single_oriented_fan(links: &mut [(u32, u32)]) -> bool {
    links.sort_unstable();
    if links.is_empty() || links.windows(2).any(|l| l[0].0 == l[1].0) {
        return false;
    }
    let mut ends: Vec<u32> = links.iter().map(|l| l.1).collect();
    ends.sort_unstable();
    if ends.windows(2).any(|e| e[0] == e[1]) {
        return false;
    }
    // An open fan begins at the one corner that no link leads to; a ring begins anywhere.
    let mut starts = links.iter().map(|l| l.0).filter(|s| ends.binary_search(s).is_err());
    let start = starts.next().unwrap_or(links[0].0);
    if starts.next().is_some() {
        return false;
    }
    let mut here = start;
    for step in 0..links.len() {
        let Ok(i) = links.binary_search_by_key(&here, |l| l.0) else {
            return false;
        };
        here = links[i].1;
        if here == start {
            return step + 1 == links.len();
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_and_paths_are_fans_and_pairs_of_them_are_not() {
        assert!(is_single_oriented_fan(&mut [(1, 2), (3, 1), (2, 3)]), "a ring");
        assert!(is_single_oriented_fan(&mut [(7, 2), (2, 5)]), "an open fan");
        assert!(!is_single_oriented_fan(&mut [(1, 2), (3, 4)]), "two leaves that touch");
        assert!(
            !is_single_oriented_fan(&mut [(1, 2), (2, 1), (3, 4), (4, 3)]),
            "two rings"
        );
        assert!(!is_single_oriented_fan(&mut [(1, 2), (3, 2)]), "a leaf turned over");
        assert!(!is_single_oriented_fan(&mut [(1, 2), (1, 3)]), "three faces at an edge");
        assert!(
            !is_single_oriented_fan(&mut [(1, 2), (3, 4), (4, 3)]),
            "a leaf and a ring"
        );
        assert!(!is_single_oriented_fan(&mut []));
    }
}
