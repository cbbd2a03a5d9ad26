//! What every client deforms: a model, one end of it held, the other end moving.

use crate::failure::LoadtestFailure;
use glam::DVec3;
use pliant::asset::{FileSet, Limits, Model, sample, shapes};
use pliant::mesh::BoundingBox;
use pliant::wire::{self, pb};
use std::collections::BTreeMap;
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
    bounds: BoundingBox,
}

impl DragScene {
    /// Reads `path`, or takes the built-in creature.
    pub fn load(path: Option<&Path>) -> Result<Self, LoadtestFailure> {
        let (name, bytes) = match path {
            None => ("creature.glb".to_owned(), sample::creature_glb().to_vec()),
            Some(path) => (path.display().to_string(), read_file(path)?),
        };
        Self::of_file(name, bytes)
    }

    /// A small closed bar: what a session of it takes is mostly what any session takes.
    pub fn small_bar() -> Result<Self, LoadtestFailure> {
        let (points, triangles) = shapes::box_with_cells(DVec3::new(0.5, 0.5, 4.0), [4, 4, 32]);
        Self::of_file("bar.obj".into(), write_obj(&points, &triangles).into_bytes())
    }

    fn of_file(name: String, bytes: Vec<u8>) -> Result<Self, LoadtestFailure> {
        let model = Model::read(FileSet::single(name.clone(), bytes.clone()), None, &Limits::default())
            .map_err(|e| LoadtestFailure::Usage(format!("{name}: {e}")))?;
        Ok(Self {
            bytes: Arc::new(bytes),
            vertices: model.positions.len(),
            bounds: BoundingBox::of(&model.positions),
        })
    }

    /// The lowest end along the longest axis, held, and the highest, which moves.
    pub fn handles(&self) -> Vec<pb::Handle> {
        end_handles(&self.bounds, END).into()
    }

    /// Both handles as a job, with that pose if there is one.
    pub fn job(&self, pose: Option<u64>) -> pb::Job {
        let step = |seq| pb::Step {
            step: Some(pb::step::Step::Pose(self.pose_number(seq))),
        };
        pb::Job {
            handles: self.handles(),
            steps: pose.map(step).into_iter().collect(),
            ..Default::default()
        }
    }

    /// Makes the pose number `seq`: the moving end swings about an axis across the model and is lifted with it.
    pub fn pose_number(&self, seq: u64) -> pb::Pose {
        let axis = longest_axis(&self.bounds);
        let swing = (TAU * seq as f64 / SWING).sin();
        let (mut turn, mut lift) = (vec![0.0; 3], vec![0.0; 3]);
        turn[(axis + 2) % 3] = TURN * swing;
        lift[(axis + 1) % 3] = END * self.bounds.size()[axis] * swing;
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
            ..pb::Pose::default()
        }
    }
}

/// The longest axis of a box.
pub(crate) fn longest_axis(bounds: &BoundingBox) -> usize {
    let size = bounds.size();
    (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best })
}

/// Handles of the lowest and the highest end along the longest axis of a box, each a share of it.
pub(crate) fn end_handles(bounds: &BoundingBox, share: f64) -> [pb::Handle; 2] {
    let axis = longest_axis(bounds);
    let margin = share * bounds.size()[axis];
    let end = |id: &str, sign: f64, offset: f64| {
        let mut normal = vec![0.0; 3];
        normal[axis] = sign;
        let region = pb::region::Region::HalfSpace(pb::region::HalfSpace { normal, offset });
        pb::Handle {
            id: id.into(),
            region: Some(pb::Region { region: Some(region) }),
            ..Default::default()
        }
    };
    [
        end("base", -1.0, -(bounds.min[axis] + margin)),
        end("top", 1.0, bounds.max[axis] - margin),
    ]
}

/// Reads a model of one file.
pub(crate) fn read_model_file(path: &Path) -> Result<FileSet, LoadtestFailure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(FileSet::single(name, read_file(path)?))
}

/// Reads a job.
pub(crate) fn read_job_file(path: &Path) -> Result<pb::Job, LoadtestFailure> {
    wire::json::from_json(&read_file(path)?).map_err(|e| LoadtestFailure::Usage(format!("{}: {e}", path.display())))
}

fn read_file(path: &Path) -> Result<Vec<u8>, LoadtestFailure> {
    std::fs::read(path).map_err(|e| LoadtestFailure::Usage(format!("cannot read {}: {e}", path.display())))
}

/// Most times that a model is subdivided: 4¹⁰ is a million triangles from one.
pub(crate) const MOST_SUBDIVISIONS: u8 = 10;

/// The model with its triangles cut `times` times, as a file of its own. Its vertices come first and keep their
/// numbers; midpoints of edges follow. Edges whose ends coincide have bit-identical midpoints.
pub(crate) fn subdivide_model(files: FileSet, times: u8) -> Result<FileSet, LoadtestFailure> {
    if times == 0 {
        return Ok(files);
    }
    let name = files.name.clone();
    let model =
        Model::read(files, None, &Limits::default()).map_err(|e| LoadtestFailure::Usage(format!("{name}: {e}")))?;
    let (mut positions, mut triangles) = (model.positions.clone(), model.triangles.clone());
    for _ in 0..times {
        if triangles.len() * 4 > Limits::default().triangles as usize {
            let most = Limits::default().triangles;
            let problem = format!(
                "{name}: {} triangles cannot be cut again, at most {most} are allowed",
                triangles.len()
            );
            return Err(LoadtestFailure::Usage(problem));
        }
        triangles = split_triangles(&mut positions, &triangles);
    }
    Ok(FileSet::single(
        format!("{name}.subdivided.ply"),
        write_ply(&positions, &triangles),
    ))
}

/// One round: appends the midpoints and returns the new triangles.
fn split_triangles(positions: &mut Vec<DVec3>, triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut middles = BTreeMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            positions.push((positions[a as usize] + positions[b as usize]) * 0.5);
            positions.len() as u32 - 1
        })
    };
    triangles
        .iter()
        .flat_map(|&[a, b, c]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        })
        .collect()
}

/// An OBJ file.
pub(crate) fn write_obj(positions: &[DVec3], triangles: &[[u32; 3]]) -> String {
    let vertices = positions.iter().map(|p| format!("v {} {} {}\n", p.x, p.y, p.z));
    let faces = triangles
        .iter()
        .map(|[a, b, c]| format!("f {} {} {}\n", a + 1, b + 1, c + 1));
    vertices.chain(faces).collect()
}

/// A binary PLY file with positions in double precision.
pub(crate) fn write_ply(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<u8> {
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        positions.len(),
        triangles.len()
    );
    let mut bytes = Vec::with_capacity(header.len() + positions.len() * 24 + triangles.len() * 13);
    bytes.extend_from_slice(header.as_bytes());
    for v in positions.iter().flat_map(|p| p.to_array()) {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    for corners in triangles {
        bytes.push(3);
        corners.iter().for_each(|c| bytes.extend_from_slice(&c.to_le_bytes()));
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_keeps_its_vertices_and_its_shape() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
        let file = || FileSet::single("four.obj", text);
        let read = |files| Model::read(files, None, &Limits::default()).unwrap();
        let (rest, twice) = (read(file()), read(subdivide_model(file(), 2).unwrap()));
        // V − E + F stays 2: 4 − 6 + 4, then 34 − 96 + 64.
        assert_eq!((twice.positions.len(), twice.triangles.len()), (34, 64));
        assert_eq!(twice.positions[..4], rest.positions[..]);
        let area = |m: &Model| -> f64 {
            let of = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| m.positions[v as usize]);
                (b - a).cross(c - a).length() / 2.0
            };
            m.triangles.iter().map(of).sum()
        };
        assert!((area(&rest) - area(&twice)).abs() < 1e-14);
    }
}
