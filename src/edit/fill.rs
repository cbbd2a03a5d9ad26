//! Deleting faces and filling holes.

use super::draft::Draft;
use super::hole::fill_loop;
use super::local::{Local, touching, trails};
use super::rims::rims;
use super::{Error, Patch, Surface};
use crate::progress::Progress;
use std::collections::BTreeSet;

/// Removes the triangles `faces` (rising numbers). With `fill`, the holes that this leaves are closed by new triangles
/// as large as those around, faired; where the hole runs into a rim of the surface it stays open, with a warning.
///
/// # Errors
/// [`Error::Impossible`] when nothing or everything is named, [`Error::TooLarge`] for a hole with too long a rim,
/// [`Error::Cancelled`].
pub fn delete(surface: &Surface<'_>, faces: &[u32], fill: bool, progress: &dyn Progress) -> Result<Patch, Error> {
    let mut faces = faces.to_vec();
    faces.sort_unstable();
    faces.dedup();
    faces.retain(|&f| (f as usize) < surface.triangles.len());
    if faces.is_empty() || faces.len() == surface.triangles.len() {
        return Err(Error::Impossible {
            problem: format!(
                "the region holds {} of {} faces; name at least one and leave at least one",
                faces.len(),
                surface.triangles.len()
            ),
            place: "delete.region".to_owned(),
        });
    }
    let local = Local::around(surface, &faces, 1);
    let mut draft = Draft::new(surface, local);
    let doomed: Vec<u32> = (0..draft.local.faces.len() as u32)
        .filter(|&f| faces.binary_search(&draft.local.faces[f as usize]).is_ok())
        .collect();
    doomed.iter().for_each(|&f| draft.kill(f));
    if fill {
        let mut open: BTreeSet<[u32; 2]> = BTreeSet::new();
        for &f in &doomed {
            let t = draft.faces[f as usize].corners;
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                let mut along = draft.along(a, b);
                if let (Some(g), None) = (along.next(), along.next()) {
                    let there = &draft.faces[g as usize];
                    let forward = there.corner_of(a).is_some_and(|k| there.corners[(k + 1) % 3] == b);
                    open.insert(if forward { [b, a] } else { [a, b] });
                }
            }
        }
        let edges: Vec<[u32; 2]> = open.into_iter().collect();
        let (closed, loose) = trails(&edges);
        for trail in loose {
            draft.warnings.push((
                "open-rim".to_owned(),
                format!(
                    "the hole runs into the surface's rim over {} edges and is not filled",
                    trail.len() - 1
                ),
                format!("{}", draft.positions[trail[0] as usize]),
            ));
        }
        for ring in closed.iter().filter(|r| r.len() > 2) {
            fill_loop(&mut draft, ring, progress)?;
        }
    }
    draft.open(&BTreeSet::new());
    // Triangles without area are not in the draft.
    Ok(draft.finish(faces)?.0)
}

/// Fills the holes whose rim touches a point of the triangles `region`, or all holes. New triangles are as large as
/// those around and faired.
///
/// # Errors
/// [`Error::Impossible`] when there is no such hole, [`Error::TooLarge`] for one with too long a rim,
/// [`Error::Cancelled`].
pub fn fill(surface: &Surface<'_>, region: Option<&[u32]>, progress: &dyn Progress) -> Result<Patch, Error> {
    let (mut closed, open) = rims(surface);
    let total = closed.len();
    let mut marked = vec![region.is_none(); surface.points as usize];
    for &f in region.unwrap_or_default() {
        for &v in surface.triangles.get(f as usize).into_iter().flatten() {
            if let Some(mark) = marked.get_mut(surface.point_of[v as usize] as usize) {
                *mark = true;
            }
        }
    }
    closed.retain(|ring| ring.len() > 2 && ring.iter().any(|&p| marked[p as usize]));
    if closed.is_empty() {
        let problem = match (total, open.len()) {
            (0, 0) => "the surface has no hole".to_owned(),
            (0, n) => format!("none of the surface's {n} rims closes to a loop"),
            (n, _) => format!("none of the surface's {n} holes touches the region; widen it up to a rim"),
        };
        return Err(Error::Impossible {
            problem,
            place: "fill.region".to_owned(),
        });
    }
    if progress.cancelled() {
        return Err(Error::Cancelled);
    }
    marked.fill(false);
    closed.iter().flatten().for_each(|&p| marked[p as usize] = true);
    let mut local = Local::of(surface, touching(surface, &marked));
    local.whole = local.points.iter().map(|&p| marked[p as usize]).collect();
    let mut draft = Draft::new(surface, local);
    for ring in &closed {
        let ring: Vec<u32> = ring.iter().filter_map(|&p| draft.local.find(p)).collect();
        fill_loop(&mut draft, &ring, progress)?;
    }
    draft.open(&BTreeSet::new());
    Ok(draft.finish(Vec::new())?.0)
}
