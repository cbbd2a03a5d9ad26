//! Cutting along a curve on the surface.

use super::curve::{SurfaceCurve, draw_curve};
use super::flat_cap::warn_of_open_section;
use super::matching_cap::cap_opening_alike;
use super::options::{CutOptions, KeptSide};
use crate::edit::boundary::split_into_loops;
use crate::edit::error::{EditSubject, Error};
use crate::edit::patch::SurfacePatch;
use crate::edit::region_mesh::{RegionMesh, edge_key};
use crate::edit::surface::SurfaceView;
use crate::mesh::{Components, NONE};
use crate::progress::Progress;
use std::collections::BTreeSet;

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
    let subject = match curve {
        SurfaceCurve::Drawn(_) => EditSubject::CutCurve,
        SurfaceCurve::Along(_) => EditSubject::CutPath,
    };
    let drawn = draw_curve(surface, curve, closed, subject, progress)?;
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
            cap_opening_alike(&mut mesh, ring, options.hard_caps, progress)?;
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
