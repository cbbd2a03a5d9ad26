//! Cutting along a curve on the surface.

use super::curve::{Curve, draw};
use super::draft::key;
use super::lid::lid;
use super::local::{points_of, trails};
use super::plane::Keep;
use super::{Error, Patch, Surface};
use crate::mesh::{Components, NONE};
use crate::progress::Progress;
use std::collections::BTreeSet;

/// Cuts along a curve. Left of it, seen from outside in its direction, is above, right is below.
///
/// A curve that closes, or runs from rim to rim, and parts the surface: what is not kept goes. One that does not part
/// the surface opens a slit; then only both sides can be kept. With `fill` the openings are closed; `hard` as in
/// [`cut_plane`](super::cut_plane).
///
/// # Errors
/// As [`insert_curve`](super::insert_curve); [`Error::Impossible`] when one side is wanted and the curve does not part
/// the surface.
pub fn cut_path(
    surface: &Surface<'_>,
    curve: &Curve<'_>,
    closed: bool,
    keep: Keep,
    fill: bool,
    hard: &[bool],
    progress: &dyn Progress,
) -> Result<Patch, Error> {
    let field = match curve {
        Curve::Drawn(_) => "cut.polyline",
        Curve::Along(_) => "cut.path",
    };
    let drawn = draw(surface, curve, closed, field, progress)?;
    let (mut draft, chain) = (drawn.draft, drawn.chain);
    let (mut left, mut right): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
    for pair in chain.windows(2) {
        for f in draft.along(pair[0], pair[1]) {
            let face = &draft.faces[f as usize];
            let forward = face
                .corner_of(pair[0])
                .is_some_and(|k| face.corners[(k + 1) % 3] == pair[1]);
            if forward { &mut left } else { &mut right }.push(f);
        }
    }
    let cuts: BTreeSet<(u32, u32)> = draft.marked.clone();
    draft.open(&cuts);

    // Do both sides still hang together? Over points, untouched triangles included.
    let mut gone: Vec<u32> = Vec::new();
    if keep != Keep::Both || fill {
        let old = draft.local.points.len();
        let number = |p: u32| match draft.local.points.get(p as usize) {
            Some(&p) => p,
            None => surface.points + (p - old as u32),
        };
        let mut faces: Vec<[u32; 3]> = Vec::with_capacity(surface.triangles.len() + draft.faces.len());
        for (t, f) in surface.triangles.iter().zip(0u32..) {
            match points_of(surface, t) {
                Some(p) if draft.local.faces.binary_search(&f).is_err() => faces.push(p),
                _ => {}
            }
        }
        faces.extend(draft.faces.iter().filter(|f| f.alive).map(|f| f.corners.map(number)));
        let parts = Components::of_triangles(surface.points as usize + draft.positions.len() - old, &faces).of_vertex;
        let part = |f: &u32| parts[number(draft.faces[*f as usize].corners[0]) as usize];
        let lefts: BTreeSet<u32> = left.iter().map(part).collect();
        let rights: BTreeSet<u32> = right.iter().map(part).collect();
        let parted = lefts.is_disjoint(&rights);
        if !parted && keep != Keep::Both {
            return Err(Error::Impossible {
                problem:
                    "the curve does not part the surface, so it has no sides to choose from; close it, run it from \
                          rim to rim, or keep both"
                        .to_owned(),
                place: format!("the curve of {} points", chain.len()),
            });
        }
        if !parted && fill && !closed {
            return Err(Error::Impossible {
                problem:
                    "a curve that does not part the surface opens a slit, which has nothing to fill; leave fill out"
                        .to_owned(),
                place: format!("the curve of {} points", chain.len()),
            });
        }
        if keep == Keep::Above && lefts.is_empty() || keep == Keep::Below && rights.is_empty() {
            return Err(Error::Impossible {
                problem: "the curve runs along the surface's rim and has nothing on the side to keep".to_owned(),
                place: format!("the curve of {} points", chain.len()),
            });
        }
        let away = match keep {
            Keep::Both => BTreeSet::new(),
            Keep::Above => rights,
            Keep::Below => lefts,
        };
        if !away.is_empty() {
            for (t, f) in surface.triangles.iter().zip(0u32..) {
                let point = t.iter().map(|&v| surface.point_of[v as usize]).find(|&p| p != NONE);
                if point.is_some_and(|p| away.contains(&parts[p as usize]))
                    && draft.local.faces.binary_search(&f).is_err()
                {
                    gone.push(f);
                }
            }
            let dead: Vec<u32> = (draft.faces.iter().zip(0u32..))
                .filter(|(f, _)| f.alive && away.contains(&parts[number(f.corners[0]) as usize]))
                .map(|(_, f)| f)
                .collect();
            dead.into_iter().for_each(|f| draft.kill(f));
        }
    }
    if fill {
        let rim = draft.rim(|a, b| cuts.contains(&key(draft.root[a as usize], draft.root[b as usize])));
        let edges: Vec<[u32; 2]> = rim.iter().map(|&(from, to, _)| [to, from]).collect();
        let (rings, loose) = trails(&edges);
        for trail in loose {
            draft.warnings.push((
                "open-section".to_owned(),
                format!(
                    "the cut runs from rim to rim over {} edges and encloses nothing to fill",
                    trail.len() - 1
                ),
                format!("{}", draft.positions[trail[0] as usize]),
            ));
        }
        for ring in rings.iter().filter(|r| r.len() > 2) {
            lid(&mut draft, ring, hard, progress)?;
        }
    }
    Ok(draft.finish(gone)?.0)
}
