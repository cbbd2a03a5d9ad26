//! Drawing curves into a surface: points are laid onto it and joined by lines that become edges.
//!
//! Cutting along a curve on the surface.

use super::flat_cap::{cap_opening_alike, warn_of_open_section};
use super::trace::{FacePosition, SNAP, TraceFailure, TraceStep, TriangleRuns, trace_along_edges, trace_straight};
use super::{CutOptions, KeptSide};
use crate::patch::SurfacePatch;
use crate::region_mesh::{RegionMesh, edge_key};
use crate::surface::{BitSet, SurfaceView};
use crate::topology::split_into_loops;
use crate::triangle::longest_side;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::query::closest_point::barycentric_coordinates;
use pliant_mesh::{Components, Error, NONE};
use std::collections::{BTreeMap, BTreeSet};

/// A curve on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SurfaceCurve<'a> {
    /// Places that are laid onto the nearest place of the surface and joined by straight lines over it.
    Drawn(&'a [DVec3]),
    /// Points of the surface, joined by the shortest way along edges.
    Along(&'a [u32]),
}

impl SurfaceCurve<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Drawn(places) => places.len(),
            Self::Along(points) => points.len(),
        }
    }
}

/// The most points that a curve may be given by.
pub const MOST_POINTS: usize = 4096;

/// How far around each section of the curve faces are taken, in lengths of the section; the last: all faces.
const REACH: [f64; 4] = [0.25, 1.5, 6.0, f64::INFINITY];

/// A mesh with a curve in it.
pub(super) struct DrawnCurve {
    pub mesh: RegionMesh,
    /// The curve's points, each joined to the next by a marked edge; a closed curve ends where it began.
    pub chain: Vec<u32>,
}

/// Makes a curve an edge path of the surface, without opening it. With `closed` the last point is joined to the first.
/// The patch names the points along the curve; the first is not repeated.
///
/// # Errors
/// [`Error::Invalid`] for fewer than two (closed: three) points, or too many, or ones that do not exist;
/// [`Error::Impossible`] when points lie on parts that do not hang together; [`Error::Cancelled`].
pub fn insert_curve(
    surface: &SurfaceView<'_>,
    curve: &SurfaceCurve<'_>,
    closed: bool,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let DrawnCurve { mesh, mut chain } = draw_curve(surface, curve, closed, "insertCurve.points", progress)?;
    if closed && chain.len() > 1 {
        chain.pop();
    }
    let (mut patch, number) = mesh.into_finite_patch(surface, Vec::new())?;
    // Nothing goes, so old points keep their numbers and new ones follow in the order of the patch.
    patch.curve = chain.iter().map(|&p| number[p as usize]).collect();
    Ok(patch)
}

/// Draws a curve into a mesh of the faces around it, which grows until the curve finds its way. `field` is the path of its
/// points in a request.
fn draw_curve(
    surface: &SurfaceView<'_>,
    curve: &SurfaceCurve<'_>,
    closed: bool,
    field: &str,
    progress: &dyn Progress,
) -> Result<DrawnCurve, Error> {
    let invalid = |problem: String| Error::invalid(field, problem);
    let least = if closed { 3 } else { 2 };
    if !(least..=MOST_POINTS).contains(&curve.len()) {
        return Err(invalid(format!(
            "{} points; between {least} and {MOST_POINTS} are allowed",
            curve.len()
        )));
    }
    let runs = TriangleRuns::build(surface);
    let places = match *curve {
        SurfaceCurve::Drawn(drawn) => project_points(surface, &runs, drawn, field, progress)?,
        SurfaceCurve::Along(points) => locate_points(surface, points, field)?,
    };
    if places.iter().all(|p| p.position == places[0].position) {
        return Err(invalid(format!(
            "all points lie at one place of the surface, {}; a curve has a length",
            places[0].position
        )));
    }
    let mut stuck = 0;
    for (round, reach) in REACH.into_iter().enumerate() {
        let mesh = gather_around_curve(surface, &runs, &places, closed, reach, progress)?;
        match try_to_draw(mesh, curve, &places, closed, progress)? {
            Ok(drawn) => return Ok(drawn),
            Err((at, why)) => {
                stuck = at;
                // Only more faces can help, and only when they hang together with these.
                if why == TraceFailure::Blocked || round == 0 && !lie_on_one_part(surface, &places) {
                    break;
                }
            }
        }
    }
    let (from, to) = (places[stuck].position, places[(stuck + 1) % places.len()].position);
    Err(Error::impossible(
        format!(
            "no way over the surface leads from point {stuck} of the curve to the next; they lie on different parts"
        ),
        format!("{from} to {to}"),
    ))
}

/// Lays drawn points onto the nearest places of the surface.
fn project_points(
    surface: &SurfaceView<'_>,
    runs: &TriangleRuns,
    drawn: &[DVec3],
    field: &str,
    progress: &dyn Progress,
) -> Result<Vec<FacePosition>, Error> {
    let mut places = Vec::with_capacity(drawn.len());
    for (k, &x) in drawn.iter().enumerate() {
        if !x.is_finite() {
            let problem = format!("point {k} is {x}; coordinates must be finite");
            return Err(Error::invalid(field, problem));
        }
        check(progress)?;
        let place = runs.find_nearest(surface, x);
        places.push(place.ok_or_else(|| Error::invalid(field, "there is no surface to draw on"))?);
    }
    Ok(places)
}

/// Finds where points of the surface are, each on the first face that has it.
fn locate_points(surface: &SurfaceView<'_>, points: &[u32], field: &str) -> Result<Vec<FacePosition>, Error> {
    let mut wanted = BitSet::new(surface.points as usize);
    for &p in points {
        if p >= surface.points {
            let problem = format!("point {p}; there are {}", surface.points);
            return Err(Error::invalid(field, problem));
        }
        wanted.insert(p);
    }
    let mut found: BTreeMap<u32, FacePosition> = BTreeMap::new();
    for face in surface.triangles_touching(&wanted) {
        for v in surface.triangles[face as usize] {
            let position = surface.positions[v as usize];
            let place = FacePosition { face, position };
            found.entry(surface.point_of[v as usize]).or_insert(place);
        }
    }
    let place = |&p: &u32| {
        let place = found.get(&p).copied();
        place.ok_or_else(|| Error::invalid(field, format!("point {p} is in no face")))
    };
    points.iter().map(place).collect()
}

/// Whether all places lie on faces that hang together.
fn lie_on_one_part(surface: &SurfaceView<'_>, places: &[FacePosition]) -> bool {
    let faces: Vec<[u32; 3]> = surface.proper_faces().collect();
    let parts = Components::of_triangles(surface.points as usize, &faces).of_vertex;
    let part = |p: &FacePosition| {
        let vertex = surface.triangles[p.face as usize][0];
        parts.get(surface.point_of[vertex as usize] as usize).copied()
    };
    places.windows(2).all(|w| part(&w[0]) == part(&w[1]))
}

/// The faces around all stretches of the curve, and a ring more.
fn gather_around_curve(
    surface: &SurfaceView<'_>,
    runs: &TriangleRuns,
    places: &[FacePosition],
    closed: bool,
    reach: f64,
    progress: &dyn Progress,
) -> Result<RegionMesh, Error> {
    let mut faces: Vec<u32> = Vec::new();
    if reach.is_finite() {
        let stretches = places.len() - usize::from(!closed);
        for k in 0..stretches {
            let (a, b) = (places[k], places[(k + 1) % places.len()]);
            let size = |p: FacePosition| longest_side(surface.corner_positions(p.face));
            let margin = DVec3::splat(reach * a.position.distance(b.position) + size(a).max(size(b)));
            let (low, high) = (a.position.min(b.position) - margin, a.position.max(b.position) + margin);
            runs.collect_in_box(surface, low, high, &mut faces);
            // Stretches of a long curve overlap.
            if faces.len() > 2 * surface.triangles.len() {
                faces.sort_unstable();
                faces.dedup();
            }
            check(progress)?;
        }
        faces.extend(places.iter().map(|p| p.face));
        faces.sort_unstable();
        faces.dedup();
    } else {
        faces.extend(0..surface.triangles.len() as u32);
    }
    Ok(RegionMesh::with_ring(surface, &faces))
}

/// One try on the faces of a mesh: the drawn curve, or at which point it got stuck.
fn try_to_draw(
    mut mesh: RegionMesh,
    curve: &SurfaceCurve<'_>,
    places: &[FacePosition],
    closed: bool,
    progress: &dyn Progress,
) -> Result<Result<DrawnCurve, (usize, TraceFailure)>, Error> {
    let mut stops: Vec<u32> = Vec::with_capacity(places.len() + 1);
    for (k, place) in places.iter().enumerate() {
        let stop = match *curve {
            SurfaceCurve::Along(points) => mesh.find_point(points[k]),
            SurfaceCurve::Drawn(_) => insert_point(&mut mesh, place),
        };
        match stop {
            Some(p) => stops.push(p),
            None => return Ok(Err((k, TraceFailure::Leaves))),
        }
    }
    if closed {
        stops.push(stops[0]);
    }
    let mut chain = vec![stops[0]];
    for (k, pair) in stops.windows(2).enumerate() {
        check(progress)?;
        let (from, to) = (pair[0], pair[1]);
        if from == to {
            continue;
        }
        let start = chain.len() - 1;
        let straight = match curve {
            SurfaceCurve::Drawn(_) => trace_straight(&mesh, from, to),
            SurfaceCurve::Along(_) => Err(TraceFailure::Blocked),
        };
        let drawn = match straight {
            Ok(steps) => follow_steps(&mut mesh, steps, &mut chain),
            Err(TraceFailure::Leaves) => Err(TraceFailure::Leaves),
            Err(TraceFailure::Blocked) => trace_along_edges(&mesh, from, to).map(|way| chain.extend(way)),
        };
        if let Err(why) = drawn {
            return Ok(Err((k, why)));
        }
        // Mark what is new, so that later stretches that cross it split it and are remembered.
        for pair in chain[start..].windows(2) {
            mesh.marked.insert(edge_key(pair[0], pair[1]));
        }
    }
    let mut whole_chain = vec![chain[0]];
    for pair in chain.windows(2) {
        whole_chain.extend_from_slice(&mesh.points_along_mark(pair[0], pair[1])[1..]);
    }
    let marked = mesh.marked.clone();
    mesh.improve_split_faces(|a, b| marked.contains(&edge_key(a, b)), progress)?;
    Ok(Ok(DrawnCurve {
        mesh,
        chain: whole_chain,
    }))
}

/// Makes the steps of a straight way points of the mesh, each joined to the one before, and adds them to `chain`.
fn follow_steps(mesh: &mut RegionMesh, steps: Vec<TraceStep>, chain: &mut Vec<u32>) -> Result<(), TraceFailure> {
    for step in steps {
        let next = match step {
            TraceStep::Point(p) => p,
            TraceStep::Edge { a, b, t } => {
                let x = mesh.position(a).lerp(mesh.position(b), t);
                mesh.split_edge(a, b, t, x)
            }
        };
        let last = chain[chain.len() - 1];
        if mesh.has_edge(last, next) {
            chain.push(next);
        } else {
            // Folded or doubled faces: the split did not join the two.
            chain.extend(trace_along_edges(mesh, last, next)?);
        }
    }
    Ok(())
}

/// Makes a place a point of the mesh: a corner or an edge that it is next to, or the inside of a face.
fn insert_point(mesh: &mut RegionMesh, place: &FacePosition) -> Option<u32> {
    let source = mesh.find_face(place.face)? as usize;
    let old = mesh.faces[source].alive.then_some(source);
    let pieces = (mesh.triangles.len()..mesh.faces.len()).filter(|&f| {
        let face = &mesh.faces[f];
        face.alive && face.source as usize == source
    });
    let at = |f: usize| mesh.corner_positions(f as u32);
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
    let face = mesh.faces[f];
    let share = barycentric_coordinates(at(f), place.position);
    if !share.iter().all(|s| s.is_finite()) {
        // No area: the nearest corner.
        let far = |p: &u32| mesh.position(*p).distance_squared(place.position);
        return face.points.into_iter().min_by(|a, b| far(a).total_cmp(&far(b)));
    }
    if let Some(k) = (0..3).find(|&k| share[k] > 1.0 - SNAP) {
        return Some(face.points[k]);
    }
    if let Some(k) = (0..3).find(|&k| share[k] < SNAP) {
        let (a, b) = (face.points[(k + 1) % 3], face.points[(k + 2) % 3]);
        let (sa, sb) = (share[(k + 1) % 3].max(0.0), share[(k + 2) % 3].max(0.0));
        let t = sb / (sa + sb);
        if !(SNAP..=1.0 - SNAP).contains(&t) {
            return Some(if t < SNAP { a } else { b });
        }
        let x = mesh.position(a).lerp(mesh.position(b), t);
        return Some(mesh.split_edge(a, b, t, x));
    }
    Some(mesh.split_face(f as u32, share, place.position))
}

/// Cuts along a curve. Left of it, seen from outside in its direction, is above, right is below.
///
/// A curve that closes, or runs from boundary to boundary, and parts the surface: what is not kept goes. One that does not
/// part the surface opens a slit; then only both sides can be kept.
///
/// # Errors
/// As [`insert_curve`](super::insert_curve); [`Error::Impossible`] when one side is wanted and the curve does not part
/// the surface.
pub fn cut_along_curve(
    surface: &SurfaceView<'_>,
    curve: &SurfaceCurve<'_>,
    closed: bool,
    options: &CutOptions<'_>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let field = match curve {
        SurfaceCurve::Drawn(_) => "cut.polyline",
        SurfaceCurve::Along(_) => "cut.path",
    };
    let drawn = draw_curve(surface, curve, closed, field, progress)?;
    let (mut mesh, chain) = (drawn.mesh, drawn.chain);
    let (mut left, mut right): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
    for pair in chain.windows(2) {
        for f in mesh.faces_along(pair[0], pair[1]) {
            let forward = mesh.faces[f as usize].has_directed_edge(pair[0], pair[1]);
            if forward { &mut left } else { &mut right }.push(f);
        }
    }
    let cuts: BTreeSet<(u32, u32)> = mesh.marked.clone();
    mesh.open_fans(&cuts);

    let mut gone: Vec<u32> = Vec::new();
    if options.keep != KeptSide::Both || options.fill {
        let sides = CurveSides::find(surface, &mesh, &left, &right);
        sides.check(closed, options, chain.len())?;
        gone = sides.remove_unwanted(surface, &mut mesh, options.keep);
    }
    if options.fill {
        let root = |p: u32| mesh.points[p as usize].root;
        let open = mesh.open_sides(|a, b| cuts.contains(&edge_key(root(a), root(b))));
        let edges: Vec<[u32; 2]> = open.iter().map(|&(from, to, _)| [to, from]).collect();
        let (rings, trails) = split_into_loops(&edges);
        for trail in trails {
            let place = format!("{}", mesh.position(trail[0]));
            warn_of_open_section(&mut mesh, &trail, place);
        }
        for ring in rings.iter().filter(|r| r.len() > 2) {
            cap_opening_alike(&mut mesh, ring, options.cap_look(), progress)?;
        }
    }
    Ok(mesh.into_finite_patch(surface, gone)?.0)
}

/// The parts of the opened surface, those outside the mesh included, that lie left and right of a curve.
struct CurveSides {
    /// The part of each point: the surface's points first, then the new ones of the mesh.
    parts: Vec<u32>,
    left: BTreeSet<u32>,
    right: BTreeSet<u32>,
}

impl CurveSides {
    /// Finds which parts the faces `left` and `right` of the curve belong to.
    fn find(surface: &SurfaceView<'_>, mesh: &RegionMesh, left: &[u32], right: &[u32]) -> Self {
        let gathered = mesh.gathered_points();
        let mut faces: Vec<[u32; 3]> = Vec::with_capacity(surface.triangles.len() + mesh.faces.len());
        for t in 0..surface.triangles.len() as u32 {
            match surface.proper_points(t) {
                Some(p) if mesh.find_face(t).is_none() => faces.push(p),
                _ => {}
            }
        }
        let living = mesh.faces.iter().filter(|f| f.alive);
        faces.extend(living.map(|f| f.points.map(|p| global_number(surface, mesh, p))));
        let count = surface.points as usize + mesh.points.len() - gathered;
        let parts = Components::of_triangles(count, &faces).of_vertex;
        let part = |f: &u32| parts[global_number(surface, mesh, mesh.points_of(*f)[0]) as usize];
        Self {
            left: left.iter().map(part).collect(),
            right: right.iter().map(part).collect(),
            parts,
        }
    }

    /// Refuses what cannot be kept or filled, given that the curve parts the surface or does not.
    fn check(&self, closed: bool, options: &CutOptions<'_>, points: usize) -> Result<(), Error> {
        let parted = self.left.is_disjoint(&self.right);
        let keep = options.keep;
        let problem = if !parted && keep != KeptSide::Both {
            "the curve does not part the surface, so it has no sides to choose from; close it, run it from \
                          rim to rim, or keep both"
        } else if !parted && options.fill && !closed {
            "a curve that does not part the surface opens a slit, which has nothing to fill; leave fill out"
        } else if keep == KeptSide::Above && self.left.is_empty() || keep == KeptSide::Below && self.right.is_empty() {
            "the curve runs along the surface's rim and has nothing on the side to keep"
        } else {
            return Ok(());
        };
        Err(Error::impossible(problem, format!("the curve of {points} points")))
    }

    /// Takes the parts that do not stay out of the mesh; answers the triangles outside it that go as well.
    fn remove_unwanted(&self, surface: &SurfaceView<'_>, mesh: &mut RegionMesh, keep: KeptSide) -> Vec<u32> {
        let away = match keep {
            KeptSide::Both => return Vec::new(),
            KeptSide::Above => &self.right,
            KeptSide::Below => &self.left,
        };
        let mut gone = Vec::new();
        if away.is_empty() {
            return gone;
        }
        for (t, f) in surface.triangles.iter().zip(0u32..) {
            let point = t.iter().map(|&v| surface.point_of[v as usize]).find(|&p| p != NONE);
            if point.is_some_and(|p| away.contains(&self.parts[p as usize])) && mesh.find_face(f).is_none() {
                gone.push(f);
            }
        }
        let part = |p: u32| self.parts[global_number(surface, mesh, p) as usize];
        let dead: Vec<u32> = (mesh.living_faces())
            .filter(|&f| away.contains(&part(mesh.points_of(f)[0])))
            .collect();
        dead.into_iter().for_each(|f| mesh.remove_face(f));
        gone
    }
}

/// A number for a point of the mesh among all: that of the surface, or one after those.
fn global_number(surface: &SurfaceView<'_>, mesh: &RegionMesh, p: u32) -> u32 {
    match mesh.points[p as usize].old {
        NONE => surface.points + (p - mesh.gathered_points() as u32),
        old => old,
    }
}
