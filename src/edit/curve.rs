//! Drawing curves into a surface: points are laid onto it and joined by lines that become edges.

use super::draft::{Draft, key};
use super::local::{Local, points_of, touching};
use super::places::{Place, Runs};
use super::trace::{SNAP, Step, Stuck, along_edges, straight};
use super::{Error, Patch, Surface};
use crate::mesh::Components;
use crate::mesh::query::closest_point::barycentric_coordinates;
use crate::progress::Progress;
use glam::DVec3;
use std::collections::BTreeMap;

/// A curve on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Curve<'a> {
    /// Places that are laid onto the nearest place of the surface and joined by straight lines over it.
    Drawn(&'a [DVec3]),
    /// Points of the surface, joined by the shortest way along edges.
    Along(&'a [u32]),
}

impl Curve<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Drawn(places) => places.len(),
            Self::Along(points) => points.len(),
        }
    }
}

/// The most points that a curve may be given by.
pub const MOST_POINTS: usize = 4096;

/// How far around each stretch of the curve faces are taken, in stretches; the last: all faces.
const REACH: [f64; 4] = [0.25, 1.5, 6.0, f64::INFINITY];

/// A draft with a curve in it.
pub(super) struct Drawn<'a> {
    pub draft: Draft<'a>,
    /// The curve's points, each joined to the next by a marked edge; a closed curve ends where it began.
    pub chain: Vec<u32>,
}

/// Makes a curve an edge path of the surface, without opening it. With `closed` the last point is joined to the first.
/// Answers the patch and the numbers, after the edit, of the points along the curve (the first is not repeated).
///
/// # Errors
/// [`Error::Invalid`] for fewer than two (closed: three) points, or too many, or ones that do not exist;
/// [`Error::Impossible`] when points lie on parts that do not hang together; [`Error::Cancelled`].
pub fn insert_curve(
    surface: &Surface<'_>,
    curve: &Curve<'_>,
    closed: bool,
    progress: &dyn Progress,
) -> Result<(Patch, Vec<u32>), Error> {
    let Drawn { draft, mut chain } = draw(surface, curve, closed, "insertCurve.points", progress)?;
    if closed && chain.len() > 1 {
        chain.pop();
    }
    let (patch, number) = draft.finish(Vec::new())?;
    // Nothing goes, so old points keep their numbers and new ones follow in the order of the patch.
    Ok((patch, chain.iter().map(|&p| number[p as usize]).collect()))
}

/// Draws a curve into a draft of the faces around it, which grows until the curve finds its way. `field` is the name of
/// the points in the request.
pub(super) fn draw<'a>(
    surface: &'a Surface<'a>,
    curve: &Curve<'_>,
    closed: bool,
    field: &str,
    progress: &dyn Progress,
) -> Result<Drawn<'a>, Error> {
    let least = if closed { 3 } else { 2 };
    let invalid = |problem: String| Error::Invalid {
        field: field.to_owned(),
        problem,
    };
    if !(least..=MOST_POINTS).contains(&curve.len()) {
        return Err(invalid(format!(
            "{} points; between {least} and {MOST_POINTS} are allowed",
            curve.len()
        )));
    }
    let runs = Runs::of(surface);
    let mut places: Vec<Place> = Vec::with_capacity(curve.len());
    match *curve {
        Curve::Drawn(drawn) => {
            for (k, &x) in drawn.iter().enumerate() {
                if !x.is_finite() {
                    return Err(invalid(format!("point {k} is {x}; coordinates must be finite")));
                }
                if progress.cancelled() {
                    return Err(Error::Cancelled);
                }
                let place = runs.nearest(surface, x);
                places.push(place.ok_or_else(|| invalid("there is no surface to draw on".to_owned()))?);
            }
        }
        Curve::Along(points) => {
            let mut marked = vec![false; surface.points as usize];
            for &p in points {
                match marked.get_mut(p as usize) {
                    Some(mark) => *mark = true,
                    None => return Err(invalid(format!("point {p}; there are {}", surface.points))),
                }
            }
            let mut found: BTreeMap<u32, Place> = BTreeMap::new();
            for face in touching(surface, &marked) {
                for v in surface.triangles[face as usize] {
                    let position = surface.positions[v as usize];
                    found
                        .entry(surface.point_of[v as usize])
                        .or_insert(Place { face, position });
                }
            }
            for &p in points {
                let place = found.get(&p).copied();
                places.push(place.ok_or_else(|| invalid(format!("point {p} is in no face")))?);
            }
        }
    }
    if places.iter().all(|p| p.position == places[0].position) {
        return Err(invalid(format!(
            "all points lie at one place of the surface, {}; a curve has a length",
            places[0].position
        )));
    }
    let mut stuck = 0;
    for (round, reach) in REACH.into_iter().enumerate() {
        let local = around(surface, &runs, &places, closed, reach, progress)?;
        match attempt(Draft::new(surface, local), curve, &places, closed, progress)? {
            Ok(drawn) => return Ok(drawn),
            Err((at, why)) => {
                stuck = at;
                // Only more faces can help, and only when they hang together with these.
                if why == Stuck::Blocked || round == 0 && !one_part(surface, &places) {
                    break;
                }
            }
        }
    }
    let (from, to) = (places[stuck].position, places[(stuck + 1) % places.len()].position);
    Err(Error::Impossible {
        problem: format!(
            "no way over the surface leads from point {stuck} of the curve to the next; they lie on different parts"
        ),
        place: format!("{from} to {to}"),
    })
}

/// Whether all places lie on faces that hang together.
fn one_part(surface: &Surface<'_>, places: &[Place]) -> bool {
    let faces: Vec<[u32; 3]> = surface.triangles.iter().filter_map(|t| points_of(surface, t)).collect();
    let parts = Components::of_triangles(surface.points as usize, &faces).of_vertex;
    let part = |p: &Place| {
        let vertex = surface.triangles[p.face as usize][0];
        parts.get(surface.point_of[vertex as usize] as usize).copied()
    };
    places.windows(2).all(|w| part(&w[0]) == part(&w[1]))
}

/// The faces around all stretches of the curve, and a ring more.
fn around(
    surface: &Surface<'_>,
    runs: &Runs,
    places: &[Place],
    closed: bool,
    reach: f64,
    progress: &dyn Progress,
) -> Result<Local, Error> {
    let mut faces: Vec<u32> = Vec::new();
    if reach.is_finite() {
        let stretches = places.len() - usize::from(!closed);
        for k in 0..stretches {
            let (a, b) = (places[k], places[(k + 1) % places.len()]);
            let size = |p: Place| {
                let [x, y, z] = surface.triangles[p.face as usize].map(|v| surface.positions[v as usize]);
                x.distance(y).max(y.distance(z)).max(z.distance(x))
            };
            let margin = DVec3::splat(reach * a.position.distance(b.position) + size(a).max(size(b)));
            let (low, high) = (a.position.min(b.position) - margin, a.position.max(b.position) + margin);
            runs.within(surface, low, high, &mut faces);
            // Stretches of a long curve overlap.
            if faces.len() > 2 * surface.triangles.len() {
                faces.sort_unstable();
                faces.dedup();
            }
            if progress.cancelled() {
                return Err(Error::Cancelled);
            }
        }
        faces.extend(places.iter().map(|p| p.face));
        faces.sort_unstable();
        faces.dedup();
    } else {
        faces.extend(0..surface.triangles.len() as u32);
    }
    Ok(Local::around(surface, &faces, 1))
}

/// One try on the faces of a draft: the drawn curve, or at which point it got stuck.
fn attempt<'a>(
    mut draft: Draft<'a>,
    curve: &Curve<'_>,
    places: &[Place],
    closed: bool,
    progress: &dyn Progress,
) -> Result<Result<Drawn<'a>, (usize, Stuck)>, Error> {
    let mut stops: Vec<u32> = Vec::with_capacity(places.len() + 1);
    for (k, place) in places.iter().enumerate() {
        let stop = match *curve {
            Curve::Along(points) => draft.local.find(points[k]),
            Curve::Drawn(_) => lay(&mut draft, place),
        };
        match stop {
            Some(p) => stops.push(p),
            None => return Ok(Err((k, Stuck::Leaves))),
        }
    }
    if closed {
        stops.push(stops[0]);
    }
    let mut chain = vec![stops[0]];
    for (k, pair) in stops.windows(2).enumerate() {
        if progress.cancelled() {
            return Err(Error::Cancelled);
        }
        let (from, to) = (pair[0], pair[1]);
        if from == to {
            continue;
        }
        let start = chain.len() - 1;
        let across = match curve {
            Curve::Drawn(_) => straight(&draft, from, to),
            Curve::Along(_) => Err(Stuck::Blocked),
        };
        match across {
            Ok(steps) => {
                for step in steps {
                    let next = match step {
                        Step::Point(p) => p,
                        Step::Edge { a, b, t } => {
                            let x = draft.positions[a as usize].lerp(draft.positions[b as usize], t);
                            draft.split_edge(a, b, t, x)
                        }
                    };
                    let last = chain[chain.len() - 1];
                    if draft.has_edge(last, next) {
                        chain.push(next);
                    } else {
                        // Folded or doubled faces: the split did not join the two.
                        match along_edges(&draft, last, next) {
                            Ok(way) => chain.extend(way),
                            Err(stuck) => return Ok(Err((k, stuck))),
                        }
                    }
                }
            }
            Err(Stuck::Leaves) => return Ok(Err((k, Stuck::Leaves))),
            Err(Stuck::Blocked) => match along_edges(&draft, from, to) {
                Ok(way) => chain.extend(way),
                Err(stuck) => return Ok(Err((k, stuck))),
            },
        }
        // Mark what is new, so that later stretches that cross it split it and are remembered.
        for pair in chain[start..].windows(2) {
            draft.marked.insert(key(pair[0], pair[1]));
        }
    }
    let mut whole_chain = vec![chain[0]];
    for pair in chain.windows(2) {
        whole_chain.extend_from_slice(&draft.unfold(pair[0], pair[1])[1..]);
    }
    let marked = draft.marked.clone();
    draft.improve(|a, b| marked.contains(&key(a, b)));
    Ok(Ok(Drawn {
        draft,
        chain: whole_chain,
    }))
}

/// Makes a place a point of the draft: a corner or an edge that it is next to, or the inside of a face.
fn lay(draft: &mut Draft<'_>, place: &Place) -> Option<u32> {
    let source = draft.local.faces.binary_search(&place.face).ok()?;
    let old = draft.faces[source].alive.then_some(source);
    let pieces = (draft.local.faces.len()..draft.faces.len()).filter(|&f| {
        let face = &draft.faces[f];
        face.alive && face.source as usize == source
    });
    let at = |f: usize| draft.faces[f].corners.map(|p| draft.positions[p as usize]);
    let inside = |f: &usize| {
        let s = barycentric_coordinates(at(*f), place.position);
        if s.iter().all(|s| s.is_finite()) {
            s[0].min(s[1]).min(s[2])
        } else {
            f64::NEG_INFINITY
        }
    };
    let f = pieces
        .chain(old)
        .max_by(|a, b| inside(a).total_cmp(&inside(b)).then(b.cmp(a)))?;
    let face = draft.faces[f];
    let share = barycentric_coordinates(at(f), place.position);
    if !share.iter().all(|s| s.is_finite()) {
        // No area: the nearest corner.
        let far = |p: &u32| draft.positions[*p as usize].distance_squared(place.position);
        return face.corners.into_iter().min_by(|a, b| far(a).total_cmp(&far(b)));
    }
    if let Some(k) = (0..3).find(|&k| share[k] > 1.0 - SNAP) {
        return Some(face.corners[k]);
    }
    if let Some(k) = (0..3).find(|&k| share[k] < SNAP) {
        let (a, b) = (face.corners[(k + 1) % 3], face.corners[(k + 2) % 3]);
        let (sa, sb) = (share[(k + 1) % 3].max(0.0), share[(k + 2) % 3].max(0.0));
        let t = sb / (sa + sb);
        if !(SNAP..=1.0 - SNAP).contains(&t) {
            return Some(if t < SNAP { a } else { b });
        }
        let x = draft.positions[a as usize].lerp(draft.positions[b as usize], t);
        return Some(draft.split_edge(a, b, t, x));
    }
    Some(draft.split_face(f as u32, share, place.position))
}
