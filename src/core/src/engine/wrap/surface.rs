//! From the surface of an edit to a wrap and back: vertices of files become points of surfaces.

use super::command::{LandmarkPlace, WrapCommand, WrapLandmark};
use super::report::WrapReport;
use super::run::wrap;
use super::target::barycentric;
use super::task::{LandmarkPair, WrapTask};
use crate::deform::BodyOptions;
use crate::edit::SurfaceView;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use crate::mesh::{Mesh, NONE, signed_volume};
use glam::DVec3;

/// A surface that is to be wrapped.
pub(in crate::engine) struct SurfaceWrapping<'a> {
    /// The surface as it is.
    pub surface: SurfaceView<'a>,
    /// By render vertex, whether the target does not pull it; empty where it pulls all.
    pub masked: &'a [bool],
    /// What it is wrapped onto.
    pub target: Mesh,
    /// How bodies are built.
    pub body: &'a BodyOptions,
    /// What is asked for.
    pub command: &'a WrapCommand,
}

impl SurfaceWrapping<'_> {
    /// Wraps: answers where the points go, and how well they lie.
    ///
    /// # Errors
    /// [`Error::Invalid`] for landmarks that are not there, and those of a wrap.
    pub fn wrap(self, exec: &Exec<'_>) -> Result<(Vec<DVec3>, WrapReport), Error> {
        let SurfaceView {
            positions,
            triangles,
            point_of,
            points,
            ..
        } = self.surface;
        let unfit = |e: crate::mesh::Error| Error::Precondition(format!("the model cannot be wrapped: {e}"));
        let mut template = Mesh::of_points(positions, triangles, point_of.to_vec(), points as usize).map_err(unfit)?;
        turn_outwards(&mut template);
        let mut masked = vec![false; points as usize];
        for (&point, is_masked) in point_of.iter().zip(self.masked).filter(|(p, _)| **p != NONE) {
            masked[point as usize] |= is_masked;
        }
        let sides = LandmarkSurfaces {
            surfaces: [&template, &self.target],
            point_of: [point_of, &self.target.solver_from_render],
            field: "wrap.landmarks",
            sides: ["own", "target"],
        };
        let landmarks = sides.pairs(&self.command.landmarks, exec)?;
        let task = WrapTask {
            template: &template,
            masked: &masked,
            landmarks: &landmarks,
            body: self.body,
            in_place: self.command.in_place,
        };
        let (now, report) = wrap(&task, self.target, exec)?;
        if let Some(point) = now.iter().position(|p| !p.as_vec3().is_finite()) {
            return Err(Error::Precondition(format!(
                "point {point} leaves the range of numbers"
            )));
        }
        Ok((now, report))
    }
}

/// Winds the triangles of a surface outwards that is turned inside out, as some files are.
pub(in crate::engine) fn turn_outwards(mesh: &mut Mesh) {
    if signed_volume(&mesh.positions, &mesh.triangles) < 0.0 {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
}

/// Two surfaces with places that belong together.
pub(in crate::engine) struct LandmarkSurfaces<'a> {
    /// What is wrapped, and what onto.
    pub surfaces: [&'a Mesh; 2],
    /// Of each the point of each vertex of its file.
    pub point_of: [&'a [u32]; 2],
    /// The field that lists the landmarks, and what the fields of both sides begin with.
    pub field: &'a str,
    /// See `field`.
    pub sides: [&'a str; 2],
}

impl LandmarkSurfaces<'_> {
    /// Finds the places of landmarks.
    ///
    /// # Errors
    /// [`Error::Invalid`] for those that are not there, [`Error::Cancelled`].
    pub fn pairs(&self, landmarks: &[WrapLandmark], exec: &Exec<'_>) -> Result<Vec<LandmarkPair>, Error> {
        let trees = self
            .surfaces
            .map(|mesh| TriangleBvh::build(&mesh.positions, &mesh.triangles, exec.pool));
        let on = |k: usize, place: LandmarkPlace| match place {
            LandmarkPlace::Vertex(vertex) => {
                let of = self.point_of[k];
                let point = of.get(vertex as usize).copied().filter(|p| *p != NONE);
                point.map(|p| [(p, 1.0), (p, 0.0), (p, 0.0)]).ok_or_else(|| {
                    format!(
                        "is {vertex}, which no triangle uses; there are {} vertices, counted from 0",
                        of.len()
                    )
                })
            }
            LandmarkPlace::Point(place) => {
                let mesh = self.surfaces[k];
                let found = trees[k].closest_point(place).ok_or("finds no surface")?;
                let corners = mesh.triangles[found.triangle as usize];
                let weights = barycentric(found.point, corners.map(|v| mesh.positions[v as usize]));
                Ok([0, 1, 2].map(|c| (corners[c], weights[c])))
            }
        };
        let each = landmarks.iter().enumerate().map(|(k, landmark)| {
            let unfit = |side: usize, place: LandmarkPlace, problem: String| {
                let what = match place {
                    LandmarkPlace::Vertex(_) => "Vertex",
                    LandmarkPlace::Point(_) => "Point",
                };
                Error::invalid(format!("{}[{k}].{}{what}", self.field, self.sides[side]), problem)
            };
            exec.check()?;
            let own = on(0, landmark.own).map_err(|e| unfit(0, landmark.own, e))?;
            let there = on(1, landmark.target).map_err(|e| unfit(1, landmark.target, e))?;
            let target = there
                .iter()
                .map(|(v, w)| self.surfaces[1].positions[*v as usize] * *w)
                .sum();
            Ok(LandmarkPair { own, target })
        });
        each.collect()
    }
}
