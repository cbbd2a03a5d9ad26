//! Models for tests of edits: generated shapes, and the data meshes in a plain reading.
#![allow(dead_code)]

use crate::support::data::{data_bytes, data_path, report_skipped};
pub use crate::support::shapes;

use glam::DVec3;
use pliant::edit::{
    CutOptions, CutPlane, Error, KeptSide, PatchedSurface, SurfaceCurve, SurfacePatch, SurfaceTopology, SurfaceView,
    apply_patch, cut_along_curve, cut_by_plane, delete_faces, fill_holes, insert_curve, verify_surface,
};
use pliant::mesh::{Mesh, Weld};
use pliant::progress::Silent;
pub use shapes::*;

/// A surface with its arrays.
#[derive(Debug, Clone)]
pub struct Model {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    pub primitive_of: Vec<u32>,
    pub point_of: Vec<u32>,
    pub points: u32,
    pub first_vertex: Vec<u32>,
}

impl Model {
    /// One primitive, welded exactly; triangles that weld away are left out.
    pub fn of((positions, triangles): Shape) -> Self {
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        let kept: Vec<[u32; 3]> = mesh.source_triangle.iter().map(|&t| triangles[t as usize]).collect();
        let mut used = vec![false; positions.len()];
        kept.iter().flatten().for_each(|&v| used[v as usize] = true);
        let point_of = mesh
            .solver_from_render
            .iter()
            .zip(&used)
            .map(|(&p, &u)| if u { p } else { u32::MAX });
        Self {
            point_of: point_of.collect(),
            primitive_of: vec![0; kept.len()],
            points: mesh.positions.len() as u32,
            triangles: kept,
            positions,
            first_vertex: vec![0],
        }
    }

    pub fn surface(&self) -> SurfaceView<'_> {
        SurfaceView {
            positions: &self.positions,
            triangles: &self.triangles,
            primitive_of: &self.primitive_of,
            point_of: &self.point_of,
            points: self.points,
        }
    }

    pub fn cut(&self, plane: &CutPlane, options: &CutOptions<'_>) -> Result<SurfacePatch, Error> {
        cut_by_plane(&self.surface(), plane, options, &Silent)
    }

    pub fn cut_along(
        &self,
        curve: &SurfaceCurve<'_>,
        closed: bool,
        options: &CutOptions<'_>,
    ) -> Result<SurfacePatch, Error> {
        cut_along_curve(&self.surface(), curve, closed, options, &Silent)
    }

    pub fn insert(&self, drawn: &[DVec3], closed: bool) -> Result<SurfacePatch, Error> {
        insert_curve(&self.surface(), &SurfaceCurve::Drawn(drawn), closed, &Silent)
    }

    pub fn delete(&self, faces: &[u32], fill: bool) -> Result<SurfacePatch, Error> {
        delete_faces(&self.surface(), faces, fill, &Silent)
    }

    pub fn fill(&self, faces: Option<&[u32]>) -> Result<SurfacePatch, Error> {
        fill_holes(&self.surface(), faces, &Silent)
    }

    /// The numbers of the triangles that fit.
    pub fn triangles_where(&self, fits: impl Fn(&[u32; 3]) -> bool) -> Vec<u32> {
        let numbered = self.triangles.iter().zip(0u32..);
        numbered.filter(|(t, _)| fits(t)).map(|(_, i)| i).collect()
    }
}

pub fn topology(model: &Model) -> SurfaceTopology {
    SurfaceTopology::from_surface(&model.surface())
}

/// What a cut does with its sides, in one line.
pub fn cut_options(keep: KeptSide, fill: bool, hard_caps: &[bool]) -> CutOptions<'_> {
    CutOptions {
        keep,
        fill,
        hard_caps,
        own_caps: None,
    }
}

/// The volume that a model encloses.
pub fn volume(model: &Model) -> f64 {
    let origin = model.positions.first().copied().unwrap_or(DVec3::ZERO);
    let part = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| model.positions[v as usize] - origin);
        a.dot(b.cross(c))
    };
    model.triangles.iter().map(part).sum::<f64>() / 6.0
}

/// What an edit made of a model, as a model, after the arrays were checked.
pub fn after(model: &Model, patch: &SurfacePatch) -> Model {
    let applied: PatchedSurface = apply_patch(&model.surface(), patch, &model.first_vertex).expect("the patch applies");
    verify_surface(&applied.surface()).expect("the result is consistent");
    Model {
        positions: applied.positions,
        triangles: applied.triangles,
        primitive_of: applied.primitive_of,
        point_of: applied.point_of,
        points: applied.points,
        first_vertex: applied.first_vertex,
    }
}

/// The model with the moves of a patch and nothing else of it.
pub fn only_moved(model: &Model, patch: &SurfacePatch) -> Model {
    let moved = SurfacePatch {
        moved: patch.moved.clone(),
        ..Default::default()
    };
    after(model, &moved)
}

/// Reads the vertices and faces of an OFF or OBJ file of the data folder; polygons become fans. `None`, with a line that
/// says so, when the folder is missing.
pub fn data(name: &str) -> Option<Model> {
    let bytes = match name.ends_with(".xz") {
        true => unpacked(name)?,
        false => data_bytes(&format!("meshes/{name}"))?,
    };
    let text = String::from_utf8(bytes).expect("a text");
    let shape = if name.ends_with(".obj") { obj(&text) } else { off(&text) };
    Some(Model::of(shape))
}

/// The bytes in an xz file of the data folder; `None`, with a line that says so, when it or the program `xz` is missing.
fn unpacked(name: &str) -> Option<Vec<u8>> {
    let path = data_path(name, &format!("meshes/{name}"))?;
    match std::process::Command::new("xz").arg("-dc").arg(&path).output() {
        Ok(done) if done.status.success() => Some(done.stdout),
        Ok(done) => panic!("{}: {}", path.display(), String::from_utf8_lossy(&done.stderr)),
        Err(e) => {
            report_skipped(name, &format!("the program xz does not start: {e}"));
            None
        }
    }
}

fn obj(text: &str) -> Shape {
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let x: Vec<f64> = words.take(3).map(|w| w.parse().expect("a number")).collect();
                positions.push(DVec3::new(x[0], x[1], x[2]));
            }
            Some("f") => {
                let index = |w: &str| -> u32 { w.split('/').next().and_then(|n| n.parse().ok()).expect("an index") };
                fan(&words.map(|w| index(w) - 1).collect::<Vec<u32>>(), &mut faces);
            }
            _ => {}
        }
    }
    (positions, faces)
}

fn off(text: &str) -> Shape {
    let body = text
        .lines()
        .map(|l| l.split('#').next().unwrap_or(""))
        .collect::<Vec<_>>()
        .join("\n");
    let mut words = body
        .split_whitespace()
        .skip(1)
        .map(|w| w.parse::<f64>().expect("a number"));
    let mut next = || words.next().expect("a longer file");
    let (vertices, count, _) = (next() as usize, next() as usize, next());
    let positions = (0..vertices).map(|_| DVec3::new(next(), next(), next())).collect();
    let mut faces = Vec::new();
    for _ in 0..count {
        let n = next() as usize;
        fan(&(0..n).map(|_| next() as u32).collect::<Vec<u32>>(), &mut faces);
    }
    (positions, faces)
}

fn fan(corners: &[u32], faces: &mut Vec<[u32; 3]>) {
    faces.extend((2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]));
}
