//! Second-pass systems of real models: everything that a solve needs, for a pose and for one a step on.

use glam::DVec3;
use pliant::asset::FileSet;
use pliant::batch::pose_steps;
use pliant::deform::{DeformableBody, HandleSystem, Transform};
use pliant::engine::{Deformer, DeformerLimits};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::solver::{Constraints, Hierarchy, LinearSystem, WeightedGraph};
use pliant::wire::pb::create_options::volume_graph::Kind;
use pliant::wire::{self, json, pb};
use std::path::{Path, PathBuf};

use crate::shapes;

/// Displacement of the handle that moves most from the first pose to the second, fraction of the diagonal.
const STEP: f64 = 0.01;

/// What one pose asks for, by node.
pub struct Pose {
    pub transforms: Vec<Transform>,
    pub rhs: Vec<f64>,
    /// Given nodes where they are held, all others in the rest pose.
    pub given: Vec<f64>,
}

/// A model with its handles, and the equations of two poses over all nodes.
pub struct Rung {
    pub name: &'static str,
    bench: Deformer,
    /// Rest positions of all nodes, solving coordinates.
    pub rest: Vec<[f64; 3]>,
    pub stiffness: Option<Vec<f64>>,
    /// Diagonal of the model's box in solving units.
    pub diagonal: f64,
    pub frames: Vec<[f32; 9]>,
    pub poses: [Pose; 2],
}

impl Rung {
    /// Opens a model with a job's handles and an interior of this kind, as a session does.
    fn open(name: &'static str, files: FileSet, job: &pb::Job, kind: Kind) -> Rung {
        let pool = Pool::new(2).unwrap();
        let mut create = job.create.clone().unwrap_or_default();
        create.volume_graph.get_or_insert_default().set_kind(kind);
        let mut bench = Deformer::open(
            files,
            &wire::open_options(&create).unwrap(),
            &DeformerLimits::default(),
            &Exec::new(&pool, &Silent),
        )
        .unwrap();
        let request = pb::SetHandlesRequest {
            handles: job.handles.clone(),
            ..Default::default()
        };
        bench
            .set_handles(wire::handle_set(&request).unwrap(), &Exec::new(&pool, &Silent))
            .unwrap();
        let mut poses = bench.initial_poses();
        for pose in pose_steps(job).unwrap() {
            poses = wire::change_poses(&bench, &poses, &pose).unwrap();
        }
        let first = bench.transforms(&poses).unwrap();
        let (body, rig) = (bench.body(), bench.handle_system().unwrap());
        let second = one_step_on(body, rig, &first);
        let equations = [&first, &second].map(|t| rig.equations(body, t, &pool));
        let center = DVec3::from_array(equations[0].center);
        let stiffness = rig.stiffness();
        assert!(
            stiffness.is_none(),
            "{name}: right-hand sides of soft handles depend on the centre"
        );
        let diagonal = body.diagonal / body.unit();
        let frames = equations[0].frames.clone();
        let mut transforms = [first, second].into_iter();
        let poses = equations.map(|e| {
            // Both poses around the first one's centre, as a drag sees them.
            let shift = DVec3::from_array(e.center) - center;
            let given = e.given.iter().flat_map(|p| (DVec3::from_array(*p) + shift).to_array());
            Pose {
                transforms: transforms.next().unwrap(),
                rhs: e.rhs.as_flattened().to_vec(),
                given: given.collect(),
            }
        });
        let rest = body.rest_of_all(&pool);
        Rung {
            name,
            rest,
            bench,
            stiffness,
            diagonal,
            frames,
            poses,
        }
    }

    pub fn body(&self) -> &DeformableBody {
        self.bench.body()
    }

    pub fn rig(&self) -> &HandleSystem {
        self.bench.handle_system().unwrap()
    }

    pub fn nodes(&self) -> usize {
        self.body().nodes()
    }

    pub fn free(&self) -> usize {
        self.rig().given().iter().filter(|given| !**given).count()
    }

    /// The graph as the solver sees it.
    pub fn graph(&self) -> WeightedGraph<'_> {
        let graph = &self.body().graph;
        WeightedGraph {
            offsets: &graph.offsets,
            neighbours: &graph.neighbours,
            weights: graph.weights.as_deref(),
            positions: Some(&self.rest),
        }
    }

    pub fn constrain(&self, hierarchy: &Hierarchy, pool: &Pool) -> LinearSystem {
        let constraints = Constraints {
            fixed: self.rig().given(),
            stiffness: self.stiffness.as_deref(),
        };
        hierarchy.constrain(&constraints, pool).unwrap()
    }

    /// Neighbours of a node and the weights of the edges to them.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let graph = &self.body().graph;
        let row = graph.offsets[i] as usize..graph.offsets[i + 1] as usize;
        row.map(|e| {
            let w = graph.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
            (graph.neighbours[e] as usize, w)
        })
    }

    /// `x` with the given nodes where a pose has them.
    pub fn placed(&self, pose: usize, mut x: Vec<f64>) -> Vec<f64> {
        for i in (0..self.nodes()).filter(|&i| self.rig().given()[i]) {
            x[3 * i..3 * i + 3].copy_from_slice(&self.poses[pose].given[3 * i..3 * i + 3]);
        }
        x
    }

    /// Largest distance of any node between two solutions, fraction of the diagonal.
    pub fn apart(&self, a: &[f64], b: &[f64]) -> f64 {
        let squared = |(a, b): (&[f64], &[f64])| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        let most = a.chunks(3).zip(b.chunks(3)).map(squared).fold(0.0, f64::max);
        most.sqrt() / self.diagonal
    }
}

/// The transforms moved further along their way by about [`STEP`].
fn one_step_on(body: &DeformableBody, rig: &HandleSystem, transforms: &[Transform]) -> Vec<Transform> {
    let scaled = |by: f64| -> Vec<Transform> {
        let further = |t: &Transform| Transform {
            translation: t.translation * by,
            rotation: t.rotation * by,
            log_scale: t.log_scale * by,
            pivot: t.pivot,
        };
        transforms.iter().map(further).collect()
    };
    let next = scaled(1.0 + STEP);
    let mut moved = 0.0f64;
    for (hold, (a, b)) in rig.setup().handles.iter().zip(transforms.iter().zip(&next)) {
        let (from, to) = (a.map(), b.map());
        let nodes = hold.nodes.iter().map(|n| body.graph.positions[*n as usize]);
        moved = nodes.map(|p| from(p).distance(to(p))).fold(moved, f64::max);
    }
    assert!(moved > 0.0, "the job moves a handle");
    scaled(1.0 + STEP * STEP * body.diagonal / moved)
}

/// The folder of models, as for all data tests.
fn data() -> PathBuf {
    std::env::var_os("PLIANT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    )
}

/// The systems of three models and their handles; of a generated one where models are missing. The paper's graph is large on
/// small models too.
pub fn rungs() -> Vec<Rung> {
    let (paper, shape) = (Kind::Paper, Kind::Shape);
    let tiny = "armadillo-tiny.json";
    let models = [
        ("arm, both ends", "arm.obj", "arm.json", paper),
        ("camel head, both ends", "camelhead.off", "camelhead.json", paper),
        ("armadillo, two handles of 3 vertices", "armadillo.obj", tiny, paper),
        ("armadillo, interior of the shape", "armadillo.obj", tiny, shape),
    ];
    let mut rungs = Vec::new();
    for (name, model, job, kind) in models {
        let path = data().join("meshes").join(model);
        let Ok(bytes) = std::fs::read(&path) else {
            println!("skipped: {name}: {} is missing; set PLIANT_DATA", path.display());
            continue;
        };
        let jobs = Path::new(env!("CARGO_MANIFEST_DIR")).join("loadtest/jobs");
        let job: pb::Job = json::from_json(&std::fs::read(jobs.join(job)).unwrap()).unwrap();
        rungs.push(Rung::open(name, FileSet::single(model, bytes), &job, kind));
    }
    if rungs.len() < models.len() {
        println!("a generated ring takes the place of what was skipped");
        rungs.push(ring());
    }
    rungs
}

/// A ring held on one side and turned on the other.
fn ring() -> Rung {
    const JOB: &str = r#"{"handles": [
        {"id": "base", "region": {"halfSpace": {"normal": [-1, 0, 0], "offset": 0.9}}},
        {"id": "top", "region": {"halfSpace": {"normal": [1, 0, 0], "offset": 0.9}},
         "pose": {"rotationVector": [0.4, 0.9, 0], "translation": [0, 0.3, 0.1]}}]}"#;
    let (points, faces) = shapes::torus(150, 56, 1.0, 0.36);
    let mut off = format!("OFF\n{} {} 0\n", points.len(), faces.len());
    points.iter().for_each(|p| off += &format!("{} {} {}\n", p.x, p.y, p.z));
    faces
        .iter()
        .for_each(|f| off += &format!("3 {} {} {}\n", f[0], f[1], f[2]));
    let job = json::from_json(JOB.as_bytes()).unwrap();
    Rung::open(
        "generated ring",
        FileSet::single("ring.off", off.into_bytes()),
        &job,
        Kind::Paper,
    )
}
