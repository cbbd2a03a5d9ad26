//! An engine whose shapes follow from handles and poses alone, in microseconds, and that refuses at times with an error about memory.
//!
//! A model is the text `points N`; the bar is a real one. Vertex `v` belongs to handle `v % handles` and goes where that handle's translation takes it.

use crate::faults::Faults;
use glam::DVec3;
use pliant_asset::{FileSet, Format, WrittenFiles};
use pliant_core::engine::{
    DeformerFacts, DeformerLimits, Error, HandleFacts, HandlePose, HandlePoses, HandleSet, MeshCounts, ModelFacts,
    ModelShape, OpenOptions, PoseStats, Shader, SolveMode, SolveSettings, SolveUpdate, SolverFacts,
};
use pliant_exec::Exec;
use pliant_session::{Engine, EngineOpener, OpenDeformer};
use std::sync::Arc;

/// Of a thousand pieces of work so many are refused memory.
const REFUSED: u64 = 10;
/// What a refusal says.
pub const NO_MEMORY: &str = "bytes that a simulation refuses";

/// Bytes that a vertex is said to need.
const BYTES_PER_VERTEX: u64 = 80_000;

/// Opens engines of points, and the product's engine on other models.
#[derive(Debug, Clone)]
pub struct OpenPoints(pub Faults);

#[derive(Debug)]
struct Points {
    rest: Arc<Vec<DVec3>>,
    handles: HandleSet,
    faults: Faults,
}

fn ask_for_memory(faults: &Faults) -> Result<(), Error> {
    match faults.happens(REFUSED) {
        true => Err(Error::TooLarge {
            what: NO_MEMORY,
            seen: 2,
            limit: 1,
        }),
        false => Ok(()),
    }
}

impl EngineOpener for OpenPoints {
    fn open(
        &self,
        files: FileSet,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, Error> {
        ask_for_memory(&self.0)?;
        let text = String::from_utf8_lossy(&files.main).into_owned();
        let points = text.strip_prefix("points ").and_then(|n| n.trim().parse::<u32>().ok());
        let Some(points) = points else {
            return OpenDeformer.open(files, options, limits, exec);
        };
        Ok(Box::new(Points {
            rest: Arc::new((0..points).map(|v| DVec3::new(f64::from(v), 0.5, 0.25)).collect()),
            handles: HandleSet::default(),
            faults: self.0.split(),
        }))
    }
}

impl Engine for Points {
    fn facts(&self) -> DeformerFacts {
        let facts = |id: &String| HandleFacts {
            id: id.clone(),
            vertices: 0,
            interior_nodes: 0,
            centroid: DVec3::ZERO,
            pivot: DVec3::ZERO,
        };
        DeformerFacts {
            model: ModelFacts {
                format: Format::OBJ,
                file_bytes: 0,
                sha256: String::new(),
                counts: MeshCounts::default(),
            },
            primitives: Vec::new(),
            solver: SolverFacts::default(),
            handles: self.handles.handles.iter().map(|h| facts(&h.id)).collect(),
            warnings: Vec::new(),
            origin: DVec3::ZERO,
        }
    }

    fn rest_shape(&self) -> ModelShape {
        ModelShape::from_positions(Arc::clone(&self.rest))
    }

    fn diagonal(&self) -> f64 {
        1.0
    }

    fn byte_size(&self) -> u64 {
        BYTES_PER_VERTEX * self.rest.len() as u64
    }

    fn format(&self) -> Format {
        Format::OBJ
    }

    fn set_handles(&mut self, handles: &HandleSet, _: &Exec<'_>) -> Result<(), Error> {
        ask_for_memory(&self.faults)?;
        self.handles = handles.clone();
        Ok(())
    }

    fn initial_poses(&self) -> HandlePoses {
        let poses = self.handles.handles.iter().map(|h| h.pose.clone().unwrap_or_default());
        HandlePoses(Arc::new(poses.collect()))
    }

    fn change_poses(&self, poses: &HandlePoses, changes: &[(String, HandlePose)]) -> Result<HandlePoses, Error> {
        let mut all = poses.0.as_ref().clone();
        for (k, (id, pose)) in changes.iter().enumerate() {
            let at = self.handles.handles.iter().position(|h| h.id == *id);
            let unknown = || Error::invalid(format!("pose.handles[{k}].id"), format!("no handle {id}"));
            all[at.ok_or_else(unknown)?] = pose.clone();
        }
        Ok(HandlePoses(Arc::new(all)))
    }

    fn solve(
        &mut self,
        poses: &HandlePoses,
        _: &SolveSettings,
        _: SolveMode,
        _: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        ask_for_memory(&self.faults)?;
        let handles = self.handles.handles.len().max(1);
        let moved = |(v, &p): (usize, &DVec3)| p + poses.0[v % handles].translation.unwrap_or_default();
        let positions: Vec<DVec3> = self.rest.iter().enumerate().map(moved).collect();
        watch(&SolveUpdate {
            refined: 0,
            cycle: 1,
            residual: 0.0,
            max_error: 0.0,
            positions: &|| positions.clone(),
        });
        Ok(ModelShape {
            stats: PoseStats {
                cycles: 1,
                refined: 0,
                residual: 0.0,
                max_error: 0.0,
                solver: "points",
            },
            ..ModelShape::from_positions(Arc::new(positions))
        })
    }

    fn write(&self, positions: &[DVec3], _: Format, _: &Exec<'_>) -> Result<WrittenFiles, Error> {
        Ok(WrittenFiles {
            main: format!("{positions:?}").into_bytes(),
            ..Default::default()
        })
    }

    fn shader(&self) -> Shader {
        Shader::default()
    }
}

/// An upright bar of square section, three units high, closed, as OBJ.
pub fn bar() -> String {
    let (rings, corners) = (9, [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]);
    let mut text = String::new();
    for (ring, (x, y)) in (0..=rings).flat_map(|ring| corners.map(|corner| (ring, corner))) {
        text += &format!("v {x} {y} {}\n", f64::from(ring) * 3.0 / f64::from(rings));
    }
    let at = |ring: i32, corner: i32| ring * 4 + corner % 4 + 1;
    for (ring, corner) in (0..rings).flat_map(|ring| [0, 1, 2, 3].map(|corner| (ring, corner))) {
        let (next, above) = (corner + 1, ring + 1);
        text += &format!(
            "f {} {} {} {}\n",
            at(ring, corner),
            at(ring, next),
            at(above, next),
            at(above, corner)
        );
    }
    text + &format!(
        "f 4 3 2 1\nf {} {} {} {}\n",
        at(rings, 0),
        at(rings, 1),
        at(rings, 2),
        at(rings, 3)
    )
}
