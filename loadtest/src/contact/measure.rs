//! A pose committed without and with contact avoided, and what became of it.

use super::scenes::ContactScene;
use crate::failure::LoadtestFailure;
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::engine::{Contact, Deformer, DeformerLimits, OpenOptions, SolveSettings};
use pliant::exec::Exec;
use pliant::graph::WindingTree;
use pliant::mesh::query::TriangleBvh;
use pliant::mesh::{Mesh, signed_volume};
use pliant::pool::Pool;
use pliant::progress::Silent;

/// How far out of the surface a point is that says whether a vertex lies inside of another part, median edges.
const LIFT: f64 = 0.02;

/// A shape and what it took.
struct MeasuredCommit {
    positions: Vec<DVec3>,
    /// Pairs that cross and do not in the rest pose, not held wholly,
    pairs: u64,
    /// and held wholly.
    held: u64,
    /// How far edges are from their rest lengths, on the mean.
    strain: f64,
    volume: f64,
    /// Of the processor.
    seconds: f64,
}

/// A pose without and with contact avoided.
pub(super) struct ContactOutcome {
    pub degrees: f64,
    /// Pairs that cross without and with.
    pub pairs: [u64; 2],
    /// How deep surfaces are in each other without, median edges.
    pub depth: f64,
    /// The mean change of edges, over that without.
    pub edges: f64,
    /// Points between both.
    pub volume: f64,
    /// Seconds of the processor without and with.
    pub seconds: [f64; 2],
}

/// A model with the handles of a scene.
pub(super) struct ContactStage<'a> {
    deformer: Deformer,
    scene: &'a ContactScene,
    edge: f64,
    pool: &'a Pool,
}

impl<'a> ContactStage<'a> {
    pub fn set(mut deformer: Deformer, scene: &'a ContactScene, pool: &'a Pool) -> Result<Self, LoadtestFailure> {
        deformer.set_handles(scene.handles(deformer.mesh()), &Exec::new(pool, &Silent))?;
        Ok(Self {
            edge: median_edge(deformer.mesh()),
            deformer,
            scene,
            pool,
        })
    }

    /// The first pose of the scene that crosses; with a limit, no deeper than so many median edges, and without what is held on both
    /// sides. `None` where there is none.
    pub fn measure(&mut self, deepest: Option<f64>) -> Result<Option<ContactOutcome>, LoadtestFailure> {
        for degrees in self.scene.angles.clone() {
            let before = self.commit(degrees, Contact::Ignored)?;
            let depth = self.depth(&before.positions);
            if before.pairs == 0 || (deepest.is_some() && before.held > 0) || deepest.is_some_and(|most| depth > most) {
                continue;
            }
            let after = self.commit(degrees, Contact::Avoided { clearance: None })?;
            let rest = signed_volume(&self.deformer.mesh().positions, &self.deformer.mesh().triangles);
            return Ok(Some(ContactOutcome {
                degrees,
                pairs: [before.pairs, after.pairs],
                depth,
                edges: after.strain / before.strain,
                volume: 100.0 * (after.volume - before.volume).abs() / rest.abs(),
                seconds: [before.seconds, after.seconds],
            }));
        }
        Ok(None)
    }

    /// The model, for another scene.
    pub fn into_deformer(self) -> Deformer {
        self.deformer
    }

    fn commit(&mut self, degrees: f64, contact: Contact) -> Result<MeasuredCommit, LoadtestFailure> {
        let exec = Exec::new(self.pool, &Silent);
        let settings = SolveSettings {
            contact,
            ..SolveSettings::default()
        };
        let start = processor_seconds();
        let shape = self
            .deformer
            .commit([("turned", self.scene.pose(degrees))], &settings, &exec)?;
        let seconds = processor_seconds() - start;
        let found = self.deformer.crossing_pairs(&shape.positions, 0, &exec)?;
        let mesh = self.deformer.mesh();
        let positions: Vec<DVec3> = (0..mesh.positions.len() as u32)
            .map(|v| shape.positions[mesh.render_vertices_of(v)[0] as usize])
            .collect();
        Ok(MeasuredCommit {
            pairs: found.new,
            held: found.held,
            strain: strain(mesh, &positions),
            volume: signed_volume(&positions, &mesh.triangles),
            positions,
            seconds,
        })
    }

    /// How far vertices that lie inside of another part of the surface are from its outside at most, median edges.
    fn depth(&self, at: &[DVec3]) -> f64 {
        let triangles = &self.deformer.mesh().triangles;
        let normal = |t: usize| {
            let [a, b, c] = triangles[t].map(|v| at[v as usize]);
            (b - a).cross(c - a)
        };
        let mut normals = vec![DVec3::ZERO; at.len()];
        for (t, corners) in triangles.iter().enumerate() {
            corners.iter().for_each(|v| normals[*v as usize] += normal(t));
        }
        let winding = WindingTree::build(at, triangles, self.pool);
        let tree = TriangleBvh::build(at, triangles, self.pool);
        let mut deepest: f64 = 0.0;
        for (place, n) in at.iter().zip(&normals) {
            let n = n.normalize_or_zero();
            if winding.winding_number(*place + n * (LIFT * self.edge)) > 0.75 {
                let faces = |t: u32| normal(t as usize).dot(n) < 0.0;
                let out = tree.closest_point_where(*place, f64::INFINITY, &faces);
                deepest = out.map_or(deepest, |out| deepest.max(out.distance));
            }
        }
        deepest / self.edge
    }
}

/// Opens a model.
pub(super) fn open(files: FileSet, pool: &Pool) -> Result<Deformer, LoadtestFailure> {
    Ok(Deformer::open(
        files,
        &OpenOptions::default(),
        &DeformerLimits::default(),
        &Exec::new(pool, &Silent),
    )?)
}

fn median_edge(mesh: &Mesh) -> f64 {
    let length = |t: &[u32; 3]| mesh.positions[t[0] as usize].distance(mesh.positions[t[1] as usize]);
    let mut lengths: Vec<f64> = mesh.triangles.iter().map(length).collect();
    lengths.sort_unstable_by(f64::total_cmp);
    lengths[lengths.len() / 2]
}

/// How far edges are from their rest lengths, relative to these, on the mean.
fn strain(mesh: &Mesh, at: &[DVec3]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for [a, b] in mesh
        .triangles
        .iter()
        .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
    {
        let length = |at: &[DVec3]| at[a as usize].distance(at[b as usize]);
        let rest = length(&mesh.positions);
        if rest > 0.0 {
            sum += (length(at) / rest - 1.0).abs();
            count += 1.0;
        }
    }
    sum / count
}

/// Seconds that the threads of this process have had a processor for; 0 where the system does not say.
fn processor_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let spent = |task: std::fs::DirEntry| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).unwrap_or_default();
        text.split(' ').next().and_then(|n| n.parse::<u64>().ok()).unwrap_or(0)
    };
    tasks.map(spent).sum::<u64>() as f64 * 1e-9
}
