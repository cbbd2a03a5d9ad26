//! How well a template lies on a target, in numbers.

use super::queries::answers;
use super::target::TargetSurface;
use crate::engine::error::Error;
use crate::engine::quality::measure_quality;
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use crate::mesh::{Adjacency, Mesh, self_intersections};
use glam::DVec3;

/// Distances, as shares of the diagonal of the target.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WrapDistances {
    /// Half of them are smaller.
    pub p50: f64,
    /// 95 of 100 are smaller.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

/// How well a template lies on a target.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WrapReport {
    /// From the vertices and the middles of the triangles of the template that the target pulls to the closest point of the target.
    pub to_target: WrapDistances,
    /// From the vertices of the target that are seen to the closest point of the template.
    pub from_target: WrapDistances,
    /// From landmarks of the template to those of the target; 0 without any.
    pub landmarks: WrapDistances,
    /// Vertices of the template's surface, and those of them that the target does not pull: hidden, or masked by the caller.
    pub vertices: u32,
    /// See [`WrapReport::vertices`].
    pub unpulled_vertices: u32,
    /// Triangles that turned over against those around them.
    pub flipped_triangles: u32,
    /// The mean of |log of the ratio of an edge's length after to that before, less the median of these logs|.
    pub edge_distortion: f64,
    /// Pairs of triangles of the template that crossed before.
    pub crossings_before: u64,
    /// Pairs that cross now.
    pub crossings: u64,
}

/// Distances above this share of the diagonal are warned of: a twentieth of a body is as thick as its arm.
const FAR: f64 = 0.05;

/// Something to be said of a template that does not lie on its target.
pub(in crate::engine) struct WrapWarning {
    /// A stable kebab-case code.
    pub code: &'static str,
    /// What it is, for people.
    pub message: String,
}

impl WrapReport {
    /// What is to be said of a template that does not lie on its target.
    pub(in crate::engine) fn warnings(&self) -> Vec<WrapWarning> {
        let percent = |share: f64| format!("{:.1} %", share * 100.0);
        let far = (self.to_target.p95 > FAR).then(|| {
            let message = format!(
                "a twentieth of the surface is farther from the target than {} of its diagonal: landmarks lead what is far, and a \
                 mask leaves out what the target has not",
                percent(self.to_target.p95)
            );
            WrapWarning { code: "wrap-far", message }
        });
        let landmarks = (self.landmarks.max > FAR).then(|| {
            let message = format!(
                "a landmark is {} of the diagonal from its place on the target: landmarks that contradict each other, or lie on the wrong \
                 side, lead a wrap astray",
                percent(self.landmarks.max)
            );
            WrapWarning { code: "wrap-landmarks", message }
        });
        let hidden = (2 * self.unpulled_vertices > self.vertices).then(|| {
            let message = format!(
                "the target does not pull {} of {} vertices, which are hidden inside of others or masked: hulls around a body hide it, \
                 and are better left out or made passengers",
                self.unpulled_vertices, self.vertices
            );
            WrapWarning { code: "wrap-hidden", message }
        });
        far.into_iter().chain(landmarks).chain(hidden).collect()
    }
}

/// What is to be measured.
pub(super) struct Told<'a> {
    pub template: &'a Mesh,
    pub now: &'a [DVec3],
    pub pulled: &'a [bool],
    pub target: &'a TargetSurface,
    pub landmarks: Vec<f64>,
}

impl Told<'_> {
    /// Measures.
    ///
    /// # Errors
    /// Those of [`answers`].
    pub fn measure(&self, exec: &Exec<'_>) -> Result<WrapReport, Error> {
        exec.progress.report("measure", 0.0);
        let unit = 1.0 / self.target.mesh.bounds().diagonal().max(f64::MIN_POSITIVE);
        let mut pulled_triangles = self.template.triangles.clone();
        pulled_triangles.retain(|t| t.iter().all(|v| self.pulled[*v as usize]));
        let middles = pulled_triangles
            .iter()
            .map(|t| t.map(|v| self.now[v as usize]).iter().sum::<DVec3>() / 3.0);
        let vertices = (self.now.iter().zip(self.pulled))
            .filter(|(_, pulled)| **pulled)
            .map(|(p, _)| *p);
        let own: Vec<DVec3> = vertices.chain(middles).collect();
        let mut is_seen = vec![false; self.target.mesh.positions.len()];
        self.target
            .seen
            .as_flattened()
            .iter()
            .for_each(|v| is_seen[*v as usize] = true);
        let theirs = self.target.mesh.positions.iter().zip(is_seen).filter(|(_, seen)| *seen);
        let theirs: Vec<DVec3> = theirs.map(|(p, _)| *p).collect();
        let to_target = distances(&own, &self.target.tree(exec), unit, exec)?;
        let tree = TriangleBvh::build(self.now, &self.template.triangles, exec.pool);
        let from_target = distances(&theirs, &tree, unit, exec)?;
        let before = &self.template.positions;
        Ok(WrapReport {
            to_target,
            from_target,
            landmarks: WrapDistances::of(self.landmarks.iter().map(|d| d * unit).collect()),
            vertices: self.now.len() as u32,
            unpulled_vertices: self.pulled.iter().filter(|pulled| !**pulled).count() as u32,
            flipped_triangles: measure_quality(self.template, false, self.now, exec.pool).flipped_triangles,
            edge_distortion: edge_distortion(self.template, self.now),
            crossings_before: self_intersections(before, &self.template.triangles, exec)?,
            crossings: self_intersections(self.now, &self.template.triangles, exec)?,
        })
    }
}

/// How unevenly edges have grown: the mean of |log of the ratio of an edge's length after to that before, less the median of these logs|.
pub(in crate::engine) fn edge_distortion(mesh: &Mesh, now: &[DVec3]) -> f64 {
    let before = &mesh.positions;
    let edges = Adjacency::build(before.len(), &mesh.triangles).edges;
    let length = |at: &[DVec3], [a, b]: [u32; 2]| at[a as usize].distance(at[b as usize]);
    let log = |edge: [u32; 2]| libm::log(length(now, edge) / length(before, edge));
    let mut logs: Vec<f64> = edges
        .iter()
        .map(|e| log(e.vertices))
        .filter(|l| l.is_finite())
        .collect();
    logs.sort_unstable_by(f64::total_cmp);
    let Some(median) = logs.get(logs.len() / 2).copied() else {
        return 0.0;
    };
    logs.iter().map(|l| (l - median).abs()).sum::<f64>() / logs.len() as f64
}

impl WrapDistances {
    fn of(mut all: Vec<f64>) -> Self {
        all.sort_unstable_by(f64::total_cmp);
        let at = |share: usize| {
            all.get((all.len() * share / 100).min(all.len().saturating_sub(1)))
                .copied()
        };
        Self {
            p50: at(50).unwrap_or(0.0),
            p95: at(95).unwrap_or(0.0),
            max: all.last().copied().unwrap_or(0.0),
        }
    }
}

fn distances(points: &[DVec3], tree: &TriangleBvh<'_>, unit: f64, exec: &Exec<'_>) -> Result<WrapDistances, Error> {
    let of = |k: usize| tree.closest_point(points[k]).map_or(0.0, |found| found.distance * unit);
    Ok(WrapDistances::of(answers(tree, points.len(), exec, of)?))
}
