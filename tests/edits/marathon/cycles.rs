//! After hundreds of edits a solve needs no more cycles than on a bench opened anew.

use super::*;
use crate::support::messages::DeformerMessages;
use pliant::asset::Format;
use pliant::exec::Exec;

/// Cycles of a few poses of the handles in force.
fn cycles(bench: &mut Deformer, diagonal: f64, run: &Run) -> Vec<u32> {
    let settings = DeformOptions::check(
        &pb::Options {
            tolerance: 1e-5,
            refine: Some(0),
            ..Default::default()
        },
        "options",
        8,
    );
    let settings = settings.expect("valid options").solve;
    let id = bench.handles_message().handles.last().expect("a handle").id.clone();
    let poses = [
        serde_json::json!({"translation": [0.1 * diagonal, 0.0, 0.05 * diagonal]}),
        serde_json::json!({"rotationVector": [0.8, 0.0, 0.4]}),
        serde_json::json!({"rotationVector": [0.0, -0.5, 0.3], "scale": [1.3], "translation": [0.0, 0.05 * diagonal, 0.0]}),
    ];
    let mut all = Vec::new();
    for pose in poses {
        let pose: pb::Pose = message(&serde_json::json!({"handles": [{"id": id, "pose": pose}]}));
        let poses = bench
            .change_poses_message(&bench.initial_poses(), &pose)
            .expect("a pose");
        let solved = bench.solve(
            &poses,
            &settings,
            SolveMode::Commit,
            &Exec::new(&run.pool, &Silent),
            &mut |_| true,
        );
        all.push(solved.expect("solved").cycles);
    }
    all
}

fn as_fresh(name: &str, shape: &shapes::Shape, seed: u64, edits: usize) {
    // A graph of kind PAPER follows edits; the other kind is built again.
    let mut options = OpenOptions::default();
    options.body.graph = VolumeOptions::paper();
    let mut run = Run::new(obj(shape), options.body.graph, seed, 2, 2500);
    // A bench opened anew would weld parts that touch.
    run.apart = false;
    let mut seen = Vec::new();
    for round in 0..4 {
        run.go(edits / 4);
        run.hold();
        let exec = Exec::new(&run.pool, &Silent);
        let written = run.bench.write(run.bench.rest(), Format::OBJ, &exec).expect("written");
        let files = FileSet::single("edited.obj", written.main);
        let mut fresh = Deformer::open(
            files,
            &options,
            &DeformerLimits::default(),
            &Exec::new(&run.pool, &Silent),
        )
        .expect("opens");
        assert_eq!(fresh.rest().len(), run.bench.rest().len());
        fresh
            .set_handles_message(&run.bench.handles_message(), &Exec::new(&run.pool, &Silent))
            .expect("the same handles");
        let diagonal = fresh.diagonal();
        let new = cycles(&mut fresh, diagonal, &run);
        let mut bench = std::mem::replace(&mut run.bench, fresh);
        let old = cycles(&mut bench, diagonal, &run);
        run.bench = bench;
        let worse = old.iter().zip(&new).any(|(old, new)| *old > new + 1);
        assert!(
            !worse,
            "{name}, round {round}: cycles after edits {old:?}, on a fresh bench {new:?}"
        );
        seen.push((old, new));
    }
    println!("{name}, {:?} edits: cycles after edits and fresh: {seen:?}", run.counts);
    assert!(run.counts[0] > edits / 2);
}

#[test]
fn a_solve_after_hundreds_of_edits_needs_the_cycles_of_a_fresh_one() {
    as_fresh(
        "box",
        &shapes::box_with_cells(DVec3::new(1.0, 1.0, 3.0), [8, 8, 24]),
        11,
        200,
    );
}
