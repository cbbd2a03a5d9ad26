//! Every model of several parts, bent: held at one end, turned by 45° at the other.

use crate::data;
use super::shapes::{obj, offset_errors, quantile, side_by_side};
use glam::DVec3;
use pliant_core::asset::FileSet;
use pliant_core::engine::{Deformer, DeformerLimits, Handle, HandlePose, OpenOptions, Region, SolveSettings};
use pliant_core::exec::Exec;
use pliant_core::mesh::{Mesh, Weld};
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::path::Path;

/// Opens a model and sets handles at both ends of its longest side.
fn opened(files: FileSet, tied: bool, exec: &Exec<'_>) -> Option<(Deformer, HandlePose)> {
    let mut options = OpenOptions::default();
    if !tied {
        options.body.ties = None;
    }
    let mut deformer = Deformer::open(files, &options, &DeformerLimits::default(), exec).ok()?;
    let (low, high) = deformer
        .rest()
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |b, p| {
            (b.0.min(*p), b.1.max(*p))
        });
    let size = high - low;
    let along = [DVec3::X, DVec3::Y, DVec3::Z]
        .into_iter()
        .max_by(|a, b| size.dot(*a).total_cmp(&size.dot(*b)))?;
    let across = if along == DVec3::Z { DVec3::X } else { DVec3::Z };
    let (from, to, part) = (low.dot(along), high.dot(along), 0.1 * size.dot(along));
    let handles = [
        Handle::new("held", Region::half_space(-along, -(from + part))),
        Handle::new("turned", Region::half_space(along, to - part)),
    ];
    deformer.set_handles(handles, exec).ok()?;
    let pose = HandlePose::rotation(across * std::f64::consts::FRAC_PI_4).about((low + high) * 0.5);
    Some((deformer, pose))
}

/// The models of the data folder, single files, by name.
pub fn models_of_parts(root: &Path) -> impl Iterator<Item = (String, FileSet)> + use<> {
    let only = std::env::var("ONLY").unwrap_or_default();
    let fits = |p: &Path| {
        let ext = p.extension().and_then(|e| e.to_str()).unwrap_or("");
        ["glb", "gltf", "obj", "ply", "off", "stl"].contains(&ext) && p.to_string_lossy().contains(&only)
    };
    let mut files = data::files_below(&root.join("gltf"), fits);
    files.retain(|p| p.parent().is_some_and(|f| f.ends_with("gltf")));
    files.extend(data::files_below(&root.join("meshes"), fits));
    files.into_iter().map(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).expect("a readable file");
        (name.clone(), FileSet::single(name, bytes))
    })
}

/// Models with more vertices are bent with ties alone, for the sake of time.
const LARGE: usize = 20_000;
/// How far neighbours of two parts may come apart, over the diagonal, at the 95th percentile.
const TORN: f64 = 0.01;
/// How many times as far parts come apart without ties, at least.
const APART: f64 = 4.0;
/// Fewer neighbours say nothing about percentiles.
const FEWEST: usize = 20;

/// How a model came out of a bend.
struct Bent {
    parts: u32,
    ties: u64,
    neighbours: usize,
    /// The 95th percentile and the largest of how far neighbours came apart, over the diagonal.
    torn: [f64; 2],
    cycles: u32,
}

fn bent(files: FileSet, name: &str, tied: bool, exec: &Exec<'_>) -> Option<Bent> {
    let (mut deformer, pose) = opened(files, tied, exec)?;
    let facts = deformer.facts().solver;
    if facts.components < 2 || (!tied && deformer.rest().len() > LARGE) {
        return None;
    }
    let solved = deformer
        .commit([("turned", pose)], &SolveSettings::default(), exec)
        .ok()?;
    let (rest, triangles) = (deformer.rest(), &deformer.geometry().triangles);
    let mesh = Mesh::build(rest, triangles, Weld::Exact).expect("a mesh");
    let diagonal = deformer.diagonal();
    let neighbours = side_by_side(&mesh, 0.003 * diagonal, exec.pool);
    let now = |s: u32| solved.positions[mesh.render_vertices_of(s)[0] as usize];
    let now: Vec<DVec3> = (0..mesh.positions.len() as u32).map(now).collect();
    let errors = offset_errors(&neighbours, &mesh.positions, &now);
    write_pictured(name, tied, &mesh, &now);
    Some(Bent {
        parts: facts.components,
        ties: facts.ties.ties,
        neighbours: neighbours.len(),
        torn: [0.95, 1.0].map(|part| quantile(&errors, part) / diagonal),
        cycles: solved.stats.cycles,
    })
}

/// Writes the shapes for contact sheets into the folder that `PARTS_OUT` names, if it names one.
fn write_pictured(name: &str, tied: bool, mesh: &Mesh, now: &[DVec3]) {
    let Some(folder) = std::env::var_os("PARTS_OUT") else {
        return;
    };
    let way = if tied { "tied" } else { "separate" };
    for (what, points) in [("rest", &mesh.positions[..]), (way, now)] {
        let shape = (points.to_vec(), mesh.triangles.clone());
        let file = Path::new(&folder).join(format!("{name}.{what}.obj"));
        std::fs::write(file, &obj(&shape).main).expect("the folder can be written to");
    }
}

#[test]
fn every_model_of_several_parts_bends_as_one() {
    let Some(root) = data::data_folder("models of several parts") else {
        return;
    };
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (mut held, mut compared) = (0, 0);
    for (name, files) in models_of_parts(&root) {
        let Some(tied) = bent(files.clone(), &name, true, &exec) else {
            continue;
        };
        let separate = bent(files, &name, false, &exec);
        let reported = |b: &Bent| {
            format!(
                "{:6.3} % (most {:6.3} %), {:2} cycles",
                100.0 * b.torn[0],
                100.0 * b.torn[1],
                b.cycles
            )
        };
        eprintln!(
            "{name:36} {:3} parts {:6} ties {:6} neighbours: {}; separate: {}",
            tied.parts,
            tied.ties,
            tied.neighbours,
            reported(&tied),
            separate.as_ref().map_or_else(String::new, reported),
        );
        if tied.neighbours < FEWEST {
            continue;
        }
        assert!(tied.torn[0] <= TORN, "{name} comes apart by {}", tied.torn[0]);
        held += 1;
        if let Some(separate) = separate {
            let (with, without) = (tied.torn[0], separate.torn[0]);
            assert!(
                without > APART * with,
                "{name} comes apart by {with} with ties and by {without} without"
            );
            compared += 1;
        }
    }
    assert!(held == 0 || compared > 0, "none of {held} models was bent without ties");
}
