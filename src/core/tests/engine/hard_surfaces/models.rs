//! The models of the data folder that `PLIANT_DATA` names, held at one end and turned at the other.

use crate::data;
use glam::DVec3;
use pliant_core::asset::{FileSet, Format};
use pliant_core::deform::VolumeMode;
use pliant_core::engine::{Deformer, DeformerLimits, Error, Handle, HandlePose, OpenOptions, Region};
use pliant_core::exec::Exec;
use pliant_core::graph::EdgeWeights;
use pliant_core::mesh::{Mesh, Weld, shading};
use std::path::{Path, PathBuf};

/// Files of the folder; none, and a line that says what is skipped, without it.
pub fn data_models(what: &str) -> Vec<PathBuf> {
    let folder = std::env::var_os("PLIANT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let is_model = |path: &Path| Format::from_file_name(&path.to_string_lossy()).is_some();
    let mut found = data::files_below(&folder.join("meshes"), is_model);
    found.extend(data::files_below(&folder.join("gltf"), is_model));
    found.sort();
    if found.is_empty() {
        let reason = format!("{} holds no models; PLIANT_DATA names the folder", folder.display());
        data::report_skipped(what, &reason);
    }
    found
}

/// Opens a model with its companions; `None` for one that is refused.
pub fn open_model(path: &Path, exec: &Exec<'_>) -> Option<Deformer> {
    let name = path.file_name()?.to_string_lossy();
    let mut files = FileSet::single(name, std::fs::read(path).ok()?);
    if path.extension().is_some_and(|e| e == "gltf") {
        for beside in data::files_below(path.parent()?, |beside| beside.parent() == path.parent()) {
            let name = beside.file_name()?.to_string_lossy().into_owned();
            files.companions.insert(name, std::fs::read(beside).ok()?.into());
        }
    }
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).ok()
}

/// Opens a shape that is given by its vertices and triangles.
pub fn open_shape(positions: &[DVec3], triangles: &[[u32; 3]], exec: &Exec<'_>) -> Deformer {
    open_with(positions, triangles, &OpenOptions::default(), exec)
}

/// The same without interior nodes.
pub fn open_surface(positions: &[DVec3], triangles: &[[u32; 3]], weights: EdgeWeights, exec: &Exec<'_>) -> Deformer {
    let mut options = OpenOptions::default();
    options.body.volume = VolumeMode::Off;
    options.body.graph.weights = weights;
    open_with(positions, triangles, &options, exec)
}

fn open_with(positions: &[DVec3], triangles: &[[u32; 3]], options: &OpenOptions, exec: &Exec<'_>) -> Deformer {
    let mut text = String::new();
    positions
        .iter()
        .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
    triangles
        .iter()
        .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    let files = FileSet::single("shape.obj", text);
    Deformer::open(files, options, &DeformerLimits::default(), exec).expect("a shape")
}

/// The longest side of a model, and what lies at its ends.
pub struct LongSide {
    /// 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    low: f64,
    size: f64,
}

/// Which share of the long side each handle holds.
const HELD: f64 = 0.15;

impl LongSide {
    /// Finds it.
    pub fn of(positions: &[DVec3]) -> Self {
        let first = positions[0];
        let low = positions.iter().fold(first, |a, b| a.min(*b));
        let high = positions.iter().fold(first, |a, b| a.max(*b));
        let size = high - low;
        let axis = (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best });
        Self {
            axis,
            low: low[axis],
            size: size[axis],
        }
    }

    /// A handle at each end.
    pub fn ends(&self) -> [Handle; 2] {
        let along = DVec3::AXES[self.axis];
        [
            Handle::new("base", Region::half_space(-along, -(self.low + HELD * self.size))),
            Handle::new("top", Region::half_space(along, self.low + (1.0 - HELD) * self.size)),
        ]
    }

    /// Sets a handle at each end.
    pub fn hold_ends(&self, deformer: &mut Deformer, exec: &Exec<'_>) -> Result<(), Error> {
        deformer.set_handles(self.ends(), exec)
    }

    /// The top turned about another axis, radians.
    pub fn turn(&self, angle: f64) -> HandlePose {
        HandlePose::rotation(DVec3::AXES[(self.axis + 1) % 3] * angle)
    }

    /// The middle of the box around what the top holds.
    pub fn middle_of_top(&self, positions: &[DVec3]) -> DVec3 {
        let first = positions[0];
        let low = positions.iter().fold(first, |a, b| a.min(*b));
        let high = positions.iter().fold(first, |a, b| a.max(*b));
        let mut middle = 0.5 * (low + high);
        middle[self.axis] = self.low + (1.0 - 0.5 * HELD) * self.size;
        middle
    }

    fn is_held(&self, p: DVec3) -> bool {
        let share = (p[self.axis] - self.low) / self.size;
        !(HELD..=1.0 - HELD).contains(&share)
    }

    /// Triangles that turned over, further than two rings from what the handles hold.
    pub fn free_flips(&self, deformer: &Deformer, now: &[DVec3]) -> usize {
        let mesh = Mesh::build(deformer.rest(), &deformer.geometry().triangles, Weld::Exact).expect("a mesh");
        let of = |s: u32| now[mesh.render_vertices_of(s)[0] as usize];
        let deformed: Vec<DVec3> = (0..mesh.positions.len() as u32).map(of).collect();
        let corners = |shape: &[DVec3], t: &[u32; 3]| t.map(|v| shape[v as usize]);
        let mut gradients = vec![glam::DMat3::ZERO; mesh.positions.len()];
        for t in &mesh.triangles {
            let gradient = shading::area_gradient(corners(&mesh.positions, t), corners(&deformed, t));
            t.iter()
                .for_each(|&v| gradients[v as usize] += gradient.unwrap_or_default());
        }
        let mut near: Vec<bool> = mesh.positions.iter().map(|p| self.is_held(*p)).collect();
        for _ring in 0..2 {
            let was = near.clone();
            let touching = mesh.triangles.iter().filter(|t| t.iter().any(|&v| was[v as usize]));
            touching.flatten().for_each(|&v| near[v as usize] = true);
        }
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let is_flipped = |t: &&[u32; 3]| {
            let Some(rest) = normal(corners(&mesh.positions, t)).try_normalize() else {
                return false;
            };
            let carried = |v: &u32| {
                (shading::cofactor(&gradients[*v as usize]) * rest)
                    .try_normalize()
                    .unwrap_or(rest)
            };
            let carried: DVec3 = t.iter().map(carried).sum();
            carried.dot(normal(corners(&deformed, t))) < 0.0
        };
        let free = mesh.triangles.iter().filter(|t| t.iter().all(|&v| !near[v as usize]));
        free.filter(is_flipped).count()
    }
}
