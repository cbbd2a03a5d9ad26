//! Weights for the bones of a rig, measured against those that Blender finds.

use crate::support::data::data_path;
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::engine::bind_model;
use pliant::engine::{Deformer, DeformerLimits, OpenOptions};
use pliant::exec::Exec;
use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::motion::rig::{DriveOptions, RigDriver};
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::rig_from_json;
use std::fs;

const WHAT: &str = "weights of the armadillo";
/// Root mean square of the changes of edges with Blender 4.2's bone heat on the same rig and frames, all of its up to ten
/// weights a vertex; it turns 49 triangles over.
const HEAT_EDGES: f64 = 0.1396;
/// Frames of the dance.
const FRAMES: [f64; 6] = [200.0, 400.0, 560.0, 720.0, 880.0, 1040.0];

#[test]
fn an_armadillo_dances_on_its_weights_as_well_as_on_bone_heat() {
    let (Some(mesh), Some(clip)) = (
        data_path(WHAT, "meshes/armadillo.obj"),
        data_path(WHAT, "bvh/cmu_05_02.bvh"),
    ) else {
        return;
    };
    let Some(rig) = data_path(WHAT, "../motion/rig_armadillo_cmu.json") else {
        return;
    };
    let rig = rig_from_json(&fs::read(rig).expect("a rig")).expect("a rig");
    let pool = Pool::new(0).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let files = FileSet::single("armadillo.obj", fs::read(mesh).expect("a file"));
    let deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).expect("a model");
    let clip = read_bvh(&fs::read(clip).expect("a clip"), &ClipLimits::default()).expect("a clip");
    let step = clip.recorded.expect("frames").interval;
    let driver = RigDriver::new(
        &rig,
        clip,
        &DriveOptions {
            start: step,
            ..Default::default()
        },
    )
    .expect("it drives");
    let bound = bind_model(deformer.model(), &rig, 4, &exec).expect("weights");
    let (mut flips, mut edges) = (0, 0.0);
    for frame in FRAMES {
        let pose = driver.pose_at(frame * step);
        let rest = deformer.rest().iter().zip(&bound.influences);
        let posed: Vec<DVec3> = rest.map(|(p, own)| own.blend(|b| pose.bones[b].place(*p))).collect();
        let quality = deformer.quality(&posed, &pool);
        flips += quality.flipped_triangles;
        edges += quality.edge_rms / FRAMES.len() as f64;
    }
    println!(
        "{flips} flips, edges {edges:.4}, {:.3} of bone heat's",
        edges / HEAT_EDGES
    );
    assert!(edges <= HEAT_EDGES && flips <= 60, "{edges} and {flips}");
}
