//! The paper's statue (figure 8) as jobs: four models, each deformed several times, grown together, remeshed at the joints,
//! and deformed again across them. The jobs are in tests/jobs/statue and can be run by hand.

use crate::support::khronos;
use crate::support::messages::DeformerMessages;

use crate::support::data::{data_root, report_skipped};
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::engine::{Deformer, DeformerLimits, SolveMode};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{DeformOptions, json, pb};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The parts: what each is made of.
const PARTS: [(&str, &str); 4] = [
    ("horse", "meshes/horse_quad.obj"),
    ("torso", "meshes/armadillo.obj"),
    ("tail", "meshes/arap_dino.off"),
    ("plinth", "meshes/bumpy-cube.obj"),
];

/// Where the joints are: between which primitives, about which place.
const JOINTS: [(usize, usize, [f64; 3]); 2] = [(0, 1, [-0.045, 0.032, -0.011]), (0, 2, [0.071, 0.026, -0.014])];

fn jobs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/jobs/statue")
}

/// Runs a job of the folder; the report.
fn deform(folder: &Path, model: &Path, job: &str) -> Value {
    let out = folder.join(format!("{job}.glb"));
    let answer = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .arg("deform")
        .arg(model)
        .arg("--job")
        .arg(folder.join(format!("{job}.json")))
        .arg("-o")
        .arg(&out)
        .args(["--json", "--force", "--threads", "2"])
        .output()
        .expect("it starts");
    let said = String::from_utf8_lossy(&answer.stderr);
    assert!(answer.status.success(), "{job}: {said}");
    let report: Value = serde_json::from_slice(&answer.stdout).expect("JSON");
    let steps = report["steps"].as_array().expect("steps");
    let mut poses = 0;
    for (k, step) in steps.iter().enumerate().filter(|(_, step)| step["kind"] == "pose") {
        poses += 1;
        let quality = &step["quality"];
        println!(
            "{job} step {k}: {} cycles, stretch {:.2}, {} flipped",
            step["cycles"],
            quality["maxStretch"].as_f64().unwrap_or_default(),
            quality["flippedTriangles"].as_u64().unwrap_or_default()
        );
        assert_eq!(
            quality["flippedTriangles"].as_u64().unwrap_or_default(),
            0,
            "{job} step {k}"
        );
    }
    assert!(poses > 1 || job == "statue", "{job} is deformed several times");
    report
}

fn open(path: &Path, pool: &Pool) -> Deformer {
    let files = FileSet::single("statue.glb", std::fs::read(path).expect("written"));
    Deformer::open(
        files,
        &Default::default(),
        &DeformerLimits::default(),
        &Exec::new(pool, &Silent),
    )
    .expect("opens again")
}

/// What holds of the statue as a file: two parts, the statue and its plinth, without a rim.
fn whole(bench: &Deformer, name: &str) {
    let report = bench.report();
    let rims = report.boundary_loops.len();
    assert_eq!(
        (report.parts.len(), rims),
        (2, 0),
        "{name}: parts and rims; {:?}",
        report.warnings
    );
    assert!(report.closed, "{name}");
    assert_eq!(bench.geometry().primitives.len(), 4, "{name}");
}

#[test]
fn four_models_become_one_statue() {
    let data = data_root();
    if let Some((_, missing)) = PARTS.iter().find(|(_, file)| !data.join(file).is_file()) {
        return report_skipped("the statue", &format!("{} is not there", data.join(missing).display()));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    for entry in std::fs::read_dir(jobs()).expect("the jobs").flatten() {
        std::fs::copy(entry.path(), folder.join(entry.file_name())).expect("copied");
    }
    for (job, model) in PARTS {
        deform(folder, &data.join(model), job);
    }
    let merged = deform(folder, &folder.join("horse.glb"), "statue");
    let posed = deform(folder, &folder.join("statue.glb"), "pose");
    println!(
        "the statue has {} vertices, {} triangles",
        posed["model"]["vertices"], posed["model"]["triangles"]
    );
    assert!(merged["steps"].as_array().is_some_and(|steps| steps.len() == 5));

    let pool = Pool::new(2).expect("threads");
    let mut bench = open(&folder.join("statue.glb"), &pool);
    whole(&bench, "statue");
    across(&mut bench, &pool);
    drop(bench);
    whole(&open(&folder.join("pose.glb"), &pool), "pose");

    let written = [folder.join("statue.glb"), folder.join("pose.glb")];
    if let Some(findings) = khronos::validate(&written) {
        for (file, codes) in findings {
            assert!(codes.is_empty(), "{}: {codes:?}", file.display());
        }
    }
}

/// The handles beyond a joint move what is on either side of it, and both sides alike where they meet.
fn across(bench: &mut Deformer, pool: &Pool) {
    let text = std::fs::read(jobs().join("pose.json")).expect("the job");
    let job: pb::Job = json::from_json(&text).expect("a job");
    let request = pb::SetHandlesRequest {
        handles: job.handles.clone(),
        ..Default::default()
    };
    bench
        .set_handles_message(&request, &Exec::new(pool, &Silent))
        .expect("the handles fit");
    let settings = DeformOptions::check(&job.options.unwrap_or_default(), "options", 8)
        .expect("valid")
        .solve;
    let mut poses = bench.initial_poses();
    let mut last = None;
    for step in &job.steps[..2] {
        let Some(pb::step::Step::Pose(pose)) = &step.step else {
            panic!("the first steps are poses");
        };
        poses = bench.change_poses_message(&poses, pose).expect("a pose");
        last = Some(
            bench
                .solve(
                    &poses,
                    &settings,
                    SolveMode::Commit,
                    &Exec::new(pool, &Silent),
                    &mut |_| true,
                )
                .expect("solved"),
        );
    }
    let moved = last.expect("two poses").positions;
    let (rest, primitives) = (bench.rest(), &bench.geometry().primitives);
    for (a, b, place) in JOINTS {
        let place = DVec3::from_array(place);
        let motion = |p: usize| -> (f64, usize) {
            let first = primitives[p].first_vertex as usize;
            let near =
                (first..first + primitives[p].vertex_count as usize).filter(|&v| rest[v].distance(place) < 0.022);
            let by: Vec<f64> = near.map(|v| rest[v].distance(moved[v])).collect();
            (by.iter().sum::<f64>() / by.len().max(1) as f64, by.len())
        };
        let ((left, m), (right, n)) = (motion(a), motion(b));
        println!(
            "joint of {a} and {b}: {m} vertices of one move by {left:.5} in the mean, {n} of the other by {right:.5}"
        );
        assert!(m > 100 && n > 100);
        assert!(left > 5e-4 && right > 5e-4);
    }
    // Vertices of two primitives at one place before are at one place after.
    let mut by_place: Vec<([u64; 3], usize)> = (rest.iter().enumerate())
        .map(|(v, p)| (p.to_array().map(f64::to_bits), v))
        .collect();
    by_place.sort_unstable();
    let mut pairs = 0;
    for pair in by_place.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        pairs += 1;
        assert_eq!(moved[pair[0].1], moved[pair[1].1], "the joint stays closed");
    }
    assert!(pairs > 50, "{pairs} vertices are shared");
}
