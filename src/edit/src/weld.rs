//! Points that lie close together become one.
//!
//! [`weld_points`] does so everywhere, [`weld_boundaries`] along the rim of a model that was appended. A join is left out, and
//! warned of, where it would give an edge a third face, make two faces touch at a point only, lay two faces on one
//! another, or turn one over.

use super::patch::{EditWarning, SurfacePatch};
use super::surface::{BitSet, SurfaceView};
use super::topology::boundary_points;
use super::triangle;
use glam::DVec3;
use pliant_exec::progress::{Cancelled, Progress, check};
use pliant_mesh::query::closest_surface_point::group_fans;
use pliant_mesh::{BoundingBox, Error, Mesh, NONE, Weld};
use std::collections::BTreeSet;

/// The code of the warning that no two points are close enough.
pub const NOTHING_TO_WELD: &str = "weld-nothing";

/// Joins points no further apart than `tolerance`: each, in order of number, to the nearest earlier one that joined none.
/// Triangles that lose a corner by it go. Says with `weld-nothing` when there is nothing to join, and with `weld-left`
/// what was left out.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite; [`Error::Impossible`] when no triangle would be left;
/// [`Error::Cancelled`].
pub fn weld_points(surface: &SurfaceView, tolerance: f64, progress: &dyn Progress) -> Result<SurfacePatch, Error> {
    check_tolerance(tolerance, "weld.tolerance")?;
    let positions = surface.point_positions();
    let corners: Vec<[u32; 3]> = (surface.triangles.iter())
        .map(|t| t.map(|v| surface.point_of[v as usize]))
        .filter(|p| !p.contains(&NONE))
        .collect();
    let classes = Mesh::build(&positions, &corners, Weld::Tolerance(tolerance)).map_err(|e| {
        let problem = format!("welding within {tolerance} leaves nothing: {e}");
        Error::impossible(problem, "the whole surface")
    })?;
    check(progress)?;
    let mut pairs = Vec::new();
    for (p, &class) in classes.solver_from_render.iter().enumerate() {
        if class == NONE {
            continue;
        }
        let first = classes.render_vertices_of(class)[0];
        if first as usize != p {
            pairs.push((p as u32, first));
        }
    }
    join_pairs(surface, &positions, pairs, progress)
}

/// Joins the rim of an appended model, whose points are those from `first_new_point` on, to rims of the old one: each
/// point to the nearest within `tolerance`, the closest pairs first, one to one. The old points stay where they are.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite or a part is empty; [`Error::Impossible`] when one of
/// the models has no rim or no two points of both are close enough; [`Error::Cancelled`].
pub fn weld_boundaries(
    surface: &SurfaceView,
    first_new_point: u32,
    tolerance: f64,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    check_tolerance(tolerance, "merge.tolerance")?;
    let rim = boundary_points(surface);
    let (old, new) = rim.split_at(rim.partition_point(|&p| p < first_new_point));
    for (part, name) in [(old, "model"), (new, "appended model")] {
        if part.is_empty() {
            return Err(Error::impossible(
                format!("the {name} has no boundary to weld; cut it open, or merge without joining"),
                format!("the {name}"),
            ));
        }
    }
    check(progress)?;
    let positions = surface.point_positions();
    let at = |p: u32| positions[p as usize];
    let matches = find_close_pairs(new, old, tolerance, at, progress)?;
    if matches.is_empty() {
        let (distance, p, q) = find_closest(new, old, at);
        return Err(Error::impossible(
            format!(
                "no boundary point of the appended model is within {tolerance} of a boundary of the model, the closest is {distance} away; \
                 place it nearer, raise the tolerance or stitch"
            ),
            format!("{} and {}", at(p), at(q)),
        ));
    }
    let mut patch = join_pairs(surface, &positions, matches, progress)?;
    let open = new.len()
        - new
            .iter()
            .filter(|p| patch.joined.binary_search_by_key(*p, |j| j.0).is_ok())
            .count();
    if open > 0 {
        patch.warnings.push(EditWarning::new(
            "weld-open",
            format!(
                "{open} of {} boundary points of the appended model stay unjoined",
                new.len()
            ),
            "the appended model",
        ));
    }
    Ok(patch)
}

fn check_tolerance(tolerance: f64, field: &str) -> Result<(), Error> {
    if tolerance >= 0.0 && tolerance.is_finite() {
        return Ok(());
    }
    let problem = format!("{tolerance} is not a distance, it must be finite and at least 0");
    Err(Error::invalid(field, problem))
}

/// Makes the joins that may be made, the closest first, into a patch.
fn join_pairs(
    surface: &SurfaceView,
    positions: &[DVec3],
    mut pairs: Vec<(u32, u32)>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let distance = |&(p, q): &(u32, u32)| positions[p as usize].distance(positions[q as usize]);
    pairs.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
    let mut patch = SurfacePatch::default();
    if pairs.is_empty() {
        let message = "no two points are within the tolerance";
        patch
            .warnings
            .push(EditWarning::new(NOTHING_TO_WELD, message, "the whole surface"));
        return Ok(patch);
    }
    let mut joins = PointJoins::gather_faces(surface, positions, &pairs);
    for (i, &(p, q)) in pairs.iter().enumerate() {
        if i % 4096 == 0 {
            check(progress)?;
        }
        joins.join_points(p, q);
    }
    joins.undo_pinching_joins();
    patch.joined = joins.joined_pairs();
    patch.removed = joins.collapsed_triangles();
    let left: Vec<&(u32, u32)> = (pairs.iter())
        .filter(|pair| patch.joined.binary_search_by_key(&pair.0, |j| j.0).is_err())
        .collect();
    if let Some(first) = left.first() {
        patch.warnings.push(EditWarning::new(
            "weld-left",
            format!(
                "{} of {} pairs of points were left apart: joined, faces would overlap, turn over or meet at an edge with more than two faces",
                left.len(),
                pairs.len()
            ),
            format!("{}", positions[first.0 as usize]),
        ));
    }
    if patch.removed.len() == surface.triangles.len() {
        return Err(Error::impossible(
            "the weld would leave no triangle; a smaller tolerance keeps some",
            "the whole surface",
        ));
    }
    Ok(patch)
}

/// At most this many points become one: more are of no use, and comparing all of them takes long.
const MOST_MEMBERS: usize = 64;

/// The faces around the points of some pairs, with the joins made so far. A point that another joins joins none.
struct PointJoins {
    /// The surface's numbers of the points here, rising.
    points: Vec<u32>,
    positions: Vec<DVec3>,
    /// The surface's numbers of the faces here, and their points.
    numbers: Vec<u32>,
    faces: Vec<[u32; 3]>,
    /// Faces around each point; of points in no pair, only some.
    around: Vec<Vec<u32>>,
    /// The point that each has become.
    now: Vec<u32>,
    /// Those that have become each point, itself first.
    members: Vec<Vec<u32>>,
}

impl PointJoins {
    /// Gathers the faces around all points of `pairs`.
    pub fn gather_faces(surface: &SurfaceView, positions: &[DVec3], pairs: &[(u32, u32)]) -> Self {
        let mut bits = BitSet::new(surface.points as usize);
        for &(p, q) in pairs {
            bits.insert(p);
            bits.insert(q);
        }
        let touching = surface.triangles_touching(&bits);
        let proper = touching.iter().filter_map(|&t| Some((t, surface.proper_points(t)?)));
        let (numbers, corners): (Vec<u32>, Vec<[u32; 3]>) = proper.unzip();
        let mut points: Vec<u32> = corners.iter().flatten().copied().collect();
        points.extend(pairs.iter().flat_map(|&(p, q)| [p, q]));
        points.sort_unstable();
        points.dedup();
        let local = |p: u32| points.binary_search(&p).unwrap_or(0) as u32;
        let faces: Vec<[u32; 3]> = corners.iter().map(|c| c.map(local)).collect();
        let mut around = vec![Vec::new(); points.len()];
        for (f, corners) in faces.iter().enumerate() {
            corners.iter().for_each(|&p| around[p as usize].push(f as u32));
        }
        let count = points.len() as u32;
        Self {
            positions: points.iter().map(|&p| positions[p as usize]).collect(),
            points,
            numbers,
            faces,
            around,
            now: (0..count).collect(),
            members: (0..count).map(|p| vec![p]).collect(),
        }
    }

    /// Joins the surface's point `p` to `q`, unless edges would get too many faces or a face would turn over.
    pub fn join_points(&mut self, p: u32, q: u32) {
        let (Ok(p), Ok(q)) = (self.points.binary_search(&p), self.points.binary_search(&q)) else {
            return;
        };
        let (p, q) = (p as u32, q as u32);
        let free = self.now[p as usize] == p && self.now[q as usize] == q && self.members[p as usize].len() == 1;
        if p == q || !free || self.members[q as usize].len() >= MOST_MEMBERS {
            return;
        }
        self.now[p as usize] = q;
        self.members[q as usize].push(p);
        if !self.has_sound_edges(q) || self.turns_a_face(p) {
            self.undo_join(p, q);
        }
    }

    fn undo_join(&mut self, p: u32, q: u32) {
        self.now[p as usize] = p;
        self.members[q as usize].retain(|&m| m != p);
    }

    /// Parts again what makes faces meet at a point only, until nothing does.
    pub fn undo_pinching_joins(&mut self) {
        let joined = (0..self.points.len() as u32).filter(|&q| self.members[q as usize].len() > 1);
        let mut open: BTreeSet<u32> = joined.collect();
        while let Some(q) = open.pop_first() {
            while let Some(&last) = self.members[q as usize].last()
                && last != q
                && !(self.has_sound_edges(q) && self.is_fan(q))
            {
                // What lies around loses an edge by it.
                for m in [last, q] {
                    let faces = self.around[m as usize].iter();
                    let beside = faces
                        .flat_map(|&f| self.faces[f as usize])
                        .map(|p| self.now[p as usize]);
                    open.extend(beside.filter(|&p| p != q && self.members[p as usize].len() > 1));
                }
                self.undo_join(last, q);
            }
        }
    }

    /// The joins made, as pairs of the surface's points, rising.
    pub fn joined_pairs(&self) -> Vec<(u32, u32)> {
        let pairs = (0..self.points.len()).filter(|&p| self.now[p] as usize != p);
        pairs
            .map(|p| (self.points[p], self.points[self.now[p] as usize]))
            .collect()
    }

    /// The surface's triangles that have lost a corner, rising.
    pub fn collapsed_triangles(&self) -> Vec<u32> {
        let faces = self.faces.iter().zip(&self.numbers);
        faces
            .filter(|(f, _)| self.corners_now(f).is_none())
            .map(|(_, &n)| n)
            .collect()
    }

    /// The corners of a face as they are now; `None` when two are one.
    fn corners_now(&self, face: &[u32; 3]) -> Option<[u32; 3]> {
        let [a, b, c] = face.map(|p| self.now[p as usize]);
        (a != b && b != c && c != a).then_some([a, b, c])
    }

    /// For each face at the joined point `q` the corner after and the corner before it.
    fn fan_links(&self, q: u32) -> Vec<(u32, u32)> {
        let mut faces: Vec<u32> = Vec::new();
        for &m in &self.members[q as usize] {
            faces.extend(&self.around[m as usize]);
        }
        faces.sort_unstable();
        faces.dedup();
        let link = |&f: &u32| {
            let c = self.corners_now(&self.faces[f as usize])?;
            let i = c.iter().position(|&p| p == q)?;
            Some((c[(i + 1) % 3], c[(i + 2) % 3]))
        };
        faces.iter().filter_map(link).collect()
    }

    /// The same for one point before any join.
    fn fan_links_before(&self, m: u32) -> Vec<(u32, u32)> {
        let link = |&f: &u32| {
            let c = self.faces[f as usize];
            let i = c.iter().position(|&p| p == m)?;
            Some((c[(i + 1) % 3], c[(i + 2) % 3]))
        };
        self.around[m as usize].iter().filter_map(link).collect()
    }

    /// Whether each edge at `q` has at most one face on either side, or was no better before, and no two faces lie on
    /// one another.
    fn has_sound_edges(&self, q: u32) -> bool {
        let links = self.fan_links(q);
        let crowd = |at: u32, after: bool| {
            let same = |l: &&(u32, u32)| if after { l.0 == at } else { l.1 == at };
            links.iter().filter(same).count()
        };
        let before = |at: u32, after: bool| {
            let most = self.members[q as usize].iter().map(|&m| {
                let links = self.fan_links_before(m);
                let others = self.members[at as usize].iter();
                let count = |o: &u32| {
                    links
                        .iter()
                        .filter(|l| if after { l.0 == *o } else { l.1 == *o })
                        .count()
                };
                others.map(count).max().unwrap_or(0)
            });
            most.max().unwrap_or(0)
        };
        for &(next, last) in &links {
            for (at, after) in [(next, true), (last, false)] {
                let count = crowd(at, after);
                if count > 1 && count > before(at, after) {
                    return false;
                }
            }
        }
        let folded = |links: &[(u32, u32)]| links.iter().filter(|l| links.contains(&(l.1, l.0))).count();
        let before = self.members[q as usize]
            .iter()
            .map(|&m| folded(&self.fan_links_before(m)));
        folded(&links) <= before.max().unwrap_or(0)
    }

    /// Whether moving `p` to where it is joined turns over a face that stays.
    fn turns_a_face(&self, p: u32) -> bool {
        self.around[p as usize].iter().any(|&f| {
            let face = self.faces[f as usize];
            let Some(now) = self.corners_now(&face) else {
                return false;
            };
            let at = |c: [u32; 3]| triangle::area_normal(c.map(|p| self.positions[p as usize]));
            at(face).dot(at(now)) < 0.0
        })
    }

    /// Whether the faces around `q` hang together by edges no worse than those around its worst member did.
    fn is_fan(&self, q: u32) -> bool {
        let before = self.members[q as usize]
            .iter()
            .map(|&m| count_fans(&self.fan_links_before(m)));
        count_fans(&self.fan_links(q)) <= before.max().unwrap_or(1).max(1)
    }
}

/// Into how many fans the faces around a point fall.
fn count_fans(links: &[(u32, u32)]) -> usize {
    let spokes = links
        .iter()
        .zip(0u32..)
        .flat_map(|(&(a, b), face)| [(a, face), (b, face)]);
    group_fans(links.len(), spokes).1
}

/// How often a point whose nearest was taken looks for another.
const ROUNDS: usize = 8;
/// Points compared between two looks at the progress: about a millisecond.
const COMPARED: usize = 1 << 16;

/// Pairs of a point of `from` and one of `to` no further apart than `tolerance`, each point in one pair at most, the
/// closest first.
///
/// A tolerance as long as both are compares each with each, so the progress is asked on the way.
fn find_close_pairs(
    from: &[u32],
    to: &[u32],
    tolerance: f64,
    at: impl Fn(u32) -> DVec3,
    progress: &dyn Progress,
) -> Result<Vec<(u32, u32)>, Cancelled> {
    // Sorted along the axis in which they are spread most, so that a rim in a plane does not fall together.
    let places: Vec<DVec3> = to.iter().map(|&p| at(p)).collect();
    let size = BoundingBox::of(&places).size();
    let axis = (0..3).max_by(|&i, &j| size[i].total_cmp(&size[j])).unwrap_or(0);
    let mut order: Vec<(f64, u32)> = to.iter().map(|&p| (at(p)[axis], p)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut free_from: Vec<u32> = from.to_vec();
    let mut taken = BTreeSet::new();
    let mut chosen: Vec<(f64, u32, u32)> = Vec::new();
    let mut since_check = 0;
    // Who finds its nearest taken looks again in the next round.
    for _ in 0..ROUNDS {
        let mut pairs: Vec<(f64, u32, u32)> = Vec::new();
        for &p in &free_from {
            let (near, compared) = find_nearest(at(p), axis, &order, tolerance, &at, &taken);
            since_check += compared + 1;
            if since_check > COMPARED {
                since_check = 0;
                check(progress)?;
            }
            pairs.extend(near.map(|(distance, q)| (distance, p, q)));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        if pairs.is_empty() {
            break;
        }
        for pair in pairs {
            if taken.insert(pair.2) {
                chosen.push(pair);
            }
        }
        let mut done: Vec<u32> = chosen.iter().map(|c| c.1).collect();
        done.sort_unstable();
        free_from.retain(|p| done.binary_search(p).is_err());
    }
    chosen.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Ok(chosen.into_iter().map(|(_, p, q)| (p, q)).collect())
}

/// The nearest point to `x` of those sorted along `axis`, within `tolerance` and not taken; and how many were compared.
fn find_nearest(
    x: DVec3,
    axis: usize,
    order: &[(f64, u32)],
    tolerance: f64,
    at: impl Fn(u32) -> DVec3,
    taken: &BTreeSet<u32>,
) -> (Option<(f64, u32)>, usize) {
    let middle = order.partition_point(|o| o.0 < x[axis]);
    let mut best: Option<(f64, u32)> = None;
    let mut compared = 0;
    let mut look = |o: &(f64, u32)| {
        compared += 1;
        let reach = best.map_or(tolerance, |b| b.0);
        if (o.0 - x[axis]).abs() > reach {
            return false;
        }
        let distance = x.distance(at(o.1));
        if distance <= reach && best.is_none_or(|b| (distance, o.1) < b) && !taken.contains(&o.1) {
            best = Some((distance, o.1));
        }
        true
    };
    order[..middle].iter().rev().all(&mut look);
    order[middle..].iter().all(&mut look);
    (best, compared)
}

/// The closest two points of both, or of a sample of both, with their distance. Neither is empty.
fn find_closest(from: &[u32], to: &[u32], at: impl Fn(u32) -> DVec3) -> (f64, u32, u32) {
    const SAMPLE: usize = 2000;
    let mut best = (f64::INFINITY, from[0], to[0]);
    for &p in from.iter().step_by(from.len().div_ceil(SAMPLE)) {
        for &q in to.iter().step_by(to.len().div_ceil(SAMPLE)) {
            let distance = at(p).distance(at(q));
            if distance < best.0 {
                best = (distance, p, q);
            }
        }
    }
    best
}

#[cfg(test)]
mod close_pairs_tests {
    use super::*;
    use pliant_exec::progress::{CancelFlag, Silent};

    #[test]
    fn a_comparison_of_each_with_each_ends_when_cancelled() {
        let flag = CancelFlag::default();
        flag.cancel();
        let (from, to): (Vec<u32>, Vec<u32>) = ((0..1000).collect(), (1000..2000).collect());
        let at = |p: u32| DVec3::X * f64::from(p % 10);
        assert_eq!(find_close_pairs(&from, &to, 100.0, at, &flag), Err(Cancelled));
    }

    #[test]
    fn pairs_are_one_to_one_and_closest_first() {
        let x = [0.0, 1.0, 2.0, 0.1, 0.2, 1.9];
        let at = |p: u32| DVec3::X * x[p as usize];
        let pairs = find_close_pairs(&[3, 4, 5], &[0, 1, 2], 0.25, at, &Silent);
        assert_eq!(pairs, Ok(vec![(3, 0), (5, 2)]));
        assert_eq!(find_closest(&[3, 4], &[1, 2], at), (0.8, 4, 1));
    }
}
