//! What every client deforms: a model, one end of it held, the other end moving.

use crate::failure::LoadtestFailure;
use glam::DVec3;
use pliant::asset::{FileSet, Limits, Model, sample, shapes};
use pliant::wire::pb;
use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

/// Share of the longest side of the bounding box that each handle takes.
const END: f64 = 0.1;
/// Largest turn of the moving end, radians.
const TURN: f64 = 0.5;
/// Poses of one swing there and back.
const SWING: f64 = 120.0;

/// The pose at which the moving end is farthest from rest.
pub(crate) const FARTHEST_POSE: u64 = SWING as u64 / 4;

/// A drag scene is a model with two handles. It is cheap to clone.
#[derive(Debug, Clone)]
pub(crate) struct DragScene {
    /// The model file.
    pub bytes: Arc<Vec<u8>>,
    /// Render vertices.
    pub vertices: usize,
    /// Lowest and highest corner.
    low: [f64; 3],
    high: [f64; 3],
}

impl DragScene {
    /// Reads `path`, or takes the built-in creature.
    pub fn load(path: Option<&Path>) -> Result<Self, LoadtestFailure> {
        let (name, bytes) = match path {
            None => ("creature.glb".to_owned(), sample::creature_glb().to_vec()),
            Some(path) => {
                let refuse = |e: std::io::Error| LoadtestFailure::Usage(format!("cannot read {}: {e}", path.display()));
                (path.display().to_string(), std::fs::read(path).map_err(refuse)?)
            }
        };
        Self::of_file(name, bytes)
    }

    /// A small closed bar: what a session of it takes is mostly what any session takes.
    pub fn small_bar() -> Result<Self, LoadtestFailure> {
        let (points, triangles) = shapes::box_with_cells(DVec3::new(0.5, 0.5, 4.0), [4, 4, 32]);
        let mut text = String::new();
        for p in points {
            text += &format!("v {} {} {}\n", p.x, p.y, p.z);
        }
        for [a, b, c] in triangles {
            text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        }
        Self::of_file("bar.obj".into(), text.into_bytes())
    }

    fn of_file(name: String, bytes: Vec<u8>) -> Result<Self, LoadtestFailure> {
        let model = Model::read(FileSet::single(name.clone(), bytes.clone()), None, &Limits::default())
            .map_err(|e| LoadtestFailure::Usage(format!("{name}: {e}")))?;
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in &model.positions {
            for (k, v) in p.to_array().into_iter().enumerate() {
                low[k] = low[k].min(v);
                high[k] = high[k].max(v);
            }
        }
        Ok(Self {
            bytes: Arc::new(bytes),
            vertices: model.positions.len(),
            low,
            high,
        })
    }

    /// The longest axis of the bounding box.
    fn longest_axis(&self) -> usize {
        let side = |k: usize| self.high[k] - self.low[k];
        (0..3).fold(0, |best, k| if side(k) > side(best) { k } else { best })
    }

    /// The lowest end along the longest axis, held, and the highest, which moves.
    pub fn handles(&self) -> Vec<pb::Handle> {
        let axis = self.longest_axis();
        let margin = END * (self.high[axis] - self.low[axis]);
        let end = |id: &str, sign: f64, offset: f64| {
            let mut normal = vec![0.0; 3];
            normal[axis] = sign;
            let region = pb::region::Region::HalfSpace(pb::region::HalfSpace { normal, offset });
            let region = Some(pb::Region { region: Some(region) });
            pb::Handle {
                id: id.to_owned(),
                region,
                ..Default::default()
            }
        };
        vec![
            end("base", -1.0, -(self.low[axis] + margin)),
            end("top", 1.0, self.high[axis] - margin),
        ]
    }

    /// Makes the pose number `seq`: the moving end swings about an axis across the model and is lifted with it.
    pub fn pose_number(&self, seq: u64) -> pb::Pose {
        let axis = self.longest_axis();
        let swing = (TAU * seq as f64 / SWING).sin();
        let (mut turn, mut lift) = (vec![0.0; 3], vec![0.0; 3]);
        turn[(axis + 2) % 3] = TURN * swing;
        lift[(axis + 1) % 3] = END * (self.high[axis] - self.low[axis]) * swing;
        let pose = pb::HandlePose {
            rotation_vector: turn,
            translation: lift,
            ..Default::default()
        };
        let entry = pb::pose::Entry {
            id: "top".into(),
            pose: Some(pose),
        };
        pb::Pose {
            seq,
            handles: vec![entry],
            commit: false,
            idempotency_key: String::new(),
        }
    }
}
