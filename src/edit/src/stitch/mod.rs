//! A strip of triangles between two boundary loops.

mod strip;

use super::patch::{NewTriangle, NewVertex, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::surface::{BitSet, SurfaceView};
use super::topology::boundary_points;
use super::triangle;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Components, Error, NONE};
use std::collections::BTreeMap;
use strip::StitchLoop;

/// Which loops to join.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoopPair {
    /// The loops that pass these points.
    Points(u32, u32),
    /// The two nearest loops of which one has only points below the number given and the other only others: one of the
    /// model and one of what was appended.
    Appended(u32),
    /// The two nearest loops of different parts.
    Parts,
}

/// A loop longer than this times the other does not match it, unless both are named.
const LONGER: f64 = 5.0;

/// Loops further apart than this times the length of the longer one do not match, unless both are named.
const FURTHER: f64 = 1.0;

/// Joins two boundary loops by triangles whose edges from loop to loop have the least length in all. The strip belongs to
/// the primitive that most of the first loop's edges (of the model, or of the smaller part number) belong to; where the
/// other loop is of another primitive, its points get vertices of this one, with the attributes of the nearest vertex
/// that is. Normals of both parts must face the same side.
///
/// # Errors
/// [`Error::Impossible`] when there are no two such loops, they share a point or touch, they do not match in length or
/// distance, the parts face opposite ways, or the strip would repeat edges; [`Error::Cancelled`].
pub fn stitch_boundaries(
    surface: &SurfaceView,
    between: LoopPair,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let rim = boundary_points(surface);
    let mut bits = BitSet::new(surface.points as usize);
    rim.iter().for_each(|&p| bits.insert(p));
    let touching = surface.triangles_touching(&bits);
    let near: Vec<u32> = (touching.into_iter())
        .filter(|&t| surface.proper_points(t).is_some())
        .collect();
    if near.is_empty() {
        return Err(Error::impossible(
            "the surface has no boundary loop",
            "the whole surface",
        ));
    }
    let mesh = RegionMesh::with_frozen_ring(surface, &near)?;
    check(progress)?;
    let found = strip::find_loops(&mesh);
    let (a, b) = choose_loops(surface, &mesh, &found, between, progress)?;
    check_match(&mesh, a, b, matches!(between, LoopPair::Points(..)))?;
    check(progress)?;
    let strip = strip::find_shortest_strip(&mesh, a, b, progress)?.ok_or_else(|| {
        let problem = "no strip between the two loops has only new edges; they are joined by edges already";
        Error::impossible(problem, describe_place(&mesh, a, b))
    })?;
    let turned: Vec<u32> = b.points.iter().rev().copied().collect();
    let other_way = strip::find_shortest_strip(
        &mesh,
        a,
        &StitchLoop {
            points: turned,
            ..b.clone()
        },
        progress,
    )?;
    if other_way.is_some_and(|o| o.cost * 2.0 < strip.cost) {
        let problem = "the two parts face opposite ways: one of them is inside out, turn its triangles over";
        return Err(Error::impossible(problem, describe_place(&mesh, a, b)));
    }
    write_patch(surface, &mesh, a, b, &strip.triangles)
}

fn describe_place(mesh: &RegionMesh, a: &StitchLoop, b: &StitchLoop) -> String {
    format!(
        "loops at {} and {}",
        mesh.position(a.points[0]),
        mesh.position(b.points[0])
    )
}

/// The two loops that are meant.
fn choose_loops<'a>(
    surface: &SurfaceView,
    mesh: &RegionMesh,
    found: &'a [StitchLoop],
    between: LoopPair,
    progress: &dyn Progress,
) -> Result<(&'a StitchLoop, &'a StitchLoop), Error> {
    let old = |l: &StitchLoop| {
        l.points
            .iter()
            .map(|&p| mesh.points[p as usize].old)
            .min()
            .unwrap_or(NONE)
    };
    let newest = |l: &StitchLoop| l.points.iter().map(|&p| mesh.points[p as usize].old).max().unwrap_or(0);
    match between {
        LoopPair::Points(p, q) => {
            let at = |p: u32| {
                let passes = |l: &&StitchLoop| l.points.iter().any(|&x| mesh.points[x as usize].old == p);
                let hint = "is on no closed boundary loop; name a point on a loop";
                let missing = || Error::impossible(format!("point {p} {hint}"), format!("point {p}"));
                found.iter().find(passes).ok_or_else(missing)
            };
            Ok((at(p)?, at(q)?))
        }
        LoopPair::Appended(first) => {
            let (model, appended): (Vec<_>, Vec<_>) = found.iter().partition(|l| newest(l) < first);
            let appended: Vec<_> = appended.into_iter().filter(|l| old(l) >= first).collect();
            let pair = strip::nearest_pair(mesh, &model, &appended, |_, _| true, progress)?;
            pair.ok_or_else(|| {
                let (m, n) = (model.len(), appended.len());
                let problem =
                    format!("the model has {m} closed boundary loops and the appended one {n}; both need one");
                Error::impossible(&problem, "both models")
            })
        }
        LoopPair::Parts => {
            let corners: Vec<[u32; 3]> = (0..surface.triangles.len() as u32)
                .filter_map(|t| surface.proper_points(t))
                .collect();
            let parts = Components::of_triangles(surface.points as usize, &corners);
            let all: Vec<&StitchLoop> = found.iter().collect();
            let part: Vec<u32> = found.iter().map(|l| parts.of_vertex[old(l) as usize]).collect();
            let pair = strip::nearest_pair(mesh, &all, &all, |i, j| part[i] < part[j], progress)?;
            pair.ok_or_else(|| {
                let problem = format!(
                    "there are {} closed boundary loops and no two of different parts; to join loops of one part name a point on each",
                    found.len()
                );
                Error::impossible(&problem, "the whole surface")
            })
        }
    }
}

fn check_match(mesh: &RegionMesh, a: &StitchLoop, b: &StitchLoop, named: bool) -> Result<(), Error> {
    let place = describe_place(mesh, a, b);
    let mut others = b.points.clone();
    others.sort_unstable();
    if a.points.iter().any(|p| others.binary_search(p).is_ok()) {
        let problem = if a == b {
            "both points are on the same boundary loop; name one on each of two, or fill the hole"
        } else {
            "the two loops share a point; weld them or fill the holes"
        };
        return Err(Error::impossible(problem, &place));
    }
    let distance = strip::loop_distance(mesh, a, b);
    let (la, lb) = (a.length, b.length);
    if distance == 0.0 {
        return Err(Error::impossible("the two loops touch; weld them first", &place));
    }
    let matched = la.max(lb) <= LONGER * la.min(lb) && distance <= FURTHER * la.max(lb);
    if matched || named {
        return Ok(());
    }
    let problem = format!(
        "the nearest loops do not match: lengths {la} and {lb}, distance {distance}; lengths may differ {LONGER} times, the distance may be the \
         longer length; move the parts together or name a point on each loop"
    );
    Err(Error::impossible(&problem, &place))
}

/// Makes triangles of points into a patch.
fn write_patch(
    surface: &SurfaceView,
    mesh: &RegionMesh,
    a: &StitchLoop,
    b: &StitchLoop,
    triangles: &[strip::StripTriangle],
) -> Result<SurfacePatch, Error> {
    let primitive = a.main_primitive(mesh);
    let mut vertices = StripVertices {
        surface,
        mesh,
        primitive,
        known: Vec::new(),
        copies: BTreeMap::new(),
        patch: SurfacePatch::default(),
    };
    let points = a.points.iter().chain(&b.points);
    vertices.known = points
        .filter_map(|&p| Some((p, vertices.find_vertex(p, NONE)?)))
        .collect();
    for piece in triangles {
        let corners = piece.points.map(|p| mesh.position(p));
        if triangle::area_normal(corners).try_normalize().is_none() {
            let problem = "the strip would have a triangle without area; weld points that touch first";
            return Err(Error::impossible(problem, format!("{}", corners[0])));
        }
        let corners = piece.points.map(|p| vertices.find_or_copy(p, piece.beside));
        vertices.patch.triangles.push(NewTriangle { primitive, corners });
    }
    Ok(vertices.patch)
}

/// The render vertices of a strip.
struct StripVertices<'a> {
    surface: &'a SurfaceView<'a>,
    mesh: &'a RegionMesh,
    primitive: u32,
    /// Points of both loops that have a vertex of the primitive, with one.
    known: Vec<(u32, u32)>,
    copies: BTreeMap<u32, u32>,
    patch: SurfacePatch,
}

impl StripVertices<'_> {
    /// A vertex of the primitive at point `p`: that of face `beside` when there is one, else the first.
    fn find_vertex(&self, p: u32, beside: u32) -> Option<u32> {
        let own = |f: u32| {
            let face = &self.mesh.faces[f as usize];
            let wedge = self.mesh.wedge_at(f, p).filter(|_| face.primitive == self.primitive)?;
            Some(self.mesh.wedges[wedge as usize].vertex)
        };
        let there = if beside == NONE { None } else { own(beside) };
        there.or_else(|| self.mesh.faces_around(p).iter().filter_map(|&f| own(f)).min())
    }

    fn find_or_copy(&mut self, p: u32, beside: u32) -> u32 {
        if let Some(v) = self.find_vertex(p, beside) {
            return v;
        }
        if let Some(&v) = self.copies.get(&p) {
            return v;
        }
        let here: DVec3 = self.mesh.position(p);
        let distance = |k: &(u32, u32)| self.mesh.position(k.0).distance_squared(here);
        let nearest = self.known.iter().min_by(|x, y| distance(x).total_cmp(&distance(y)));
        let source = nearest.map_or(0, |k| k.1);
        let v = self.surface.positions.len() as u32 + self.patch.vertices.len() as u32;
        self.patch.vertices.push(NewVertex {
            primitive: self.primitive,
            point: self.mesh.points[p as usize].old,
            position: here,
            of: [source; 3],
            weights: [1.0, 0.0, 0.0],
        });
        self.copies.insert(p, v);
        v
    }
}
