//! Hundreds of random edits, with poses in between: what must hold after each, on a bench and in a session.

mod checks;
mod script;
mod sessions;

use crate::support::bench::{obj, settings};
use crate::support::data::data_bytes;
use crate::support::messages::{DeformerMessages, message};
use checks::Before;
use glam::DVec3;
use pliant::asset::{FileSet, Format, shapes};
use pliant::engine::{
    Deformer, DeformerLimits, HandlePoses, ModelShape, OpenOptions, SolveMode, SolveSettings, digest,
};
use pliant::exec::Exec;
use pliant::graph::VolumeOptions;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{DeformOptions, pb};
use script::{Draw, Seen};
use serde_json::Value;

/// Edits of one run.
const EDITS: usize = 70;

/// One run of edits and poses.
struct Run {
    bench: Deformer,
    pool: Pool,
    draw: Draw,
    poses: HandlePoses,
    shape: ModelShape,
    settings: SolveSettings,
    /// Above so many vertices the model is thinned out.
    most: usize,
    apart: bool,
    /// Edits done and refused.
    counts: [usize; 2],
    /// Of the shape after every step.
    digests: Vec<String>,
    /// Whether the shape is the solution of [`Run::pose`].
    posed: bool,
}

impl Run {
    fn new(files: FileSet, volume: VolumeOptions, seed: u64, threads: usize, most: usize) -> Self {
        let pool = Pool::new(threads).expect("threads start");
        let mut options = OpenOptions::default();
        options.body.graph = volume;
        let bench =
            Deformer::open(files, &options, &DeformerLimits::default(), &Exec::new(&pool, &Silent)).expect("opens");
        let options = pb::Options {
            tolerance: 1e-5,
            ..Default::default()
        };
        let mut run = Self {
            poses: bench.initial_poses(),
            shape: bench.rest_shape(),
            settings: DeformOptions::check(&options, "options", 8)
                .expect("valid options")
                .solve,
            bench,
            pool,
            draw: Draw(seed),
            most,
            apart: true,
            counts: [0; 2],
            digests: Vec::new(),
            posed: false,
        };
        run.hold();
        run
    }

    /// The next draw from what is seen now.
    fn next(&mut self, what: impl FnOnce(&Seen<'_>, &mut Draw) -> Value) -> Value {
        let seen = Seen {
            positions: &self.shape,
            edge: self.bench.report().mean_edge_length,
            diagonal: self.bench.diagonal(),
            most: self.most,
            apart: self.apart,
        };
        what(&seen, &mut self.draw)
    }

    /// Sets two handles in the rest pose, whose places they are drawn from.
    fn hold(&mut self) {
        self.shape = self.bench.rest_shape();
        let handles = self.next(|seen, draw| seen.handles(draw));
        let request = message::<pb::SetHandlesRequest>(&serde_json::json!({"handles": handles}));
        self.bench
            .set_handles_message(&request, &Exec::new(&self.pool, &Silent))
            .expect("the handles fit");
        self.poses = self.bench.initial_poses();
        self.posed = false;
    }

    /// Poses the last handle.
    fn pose(&mut self) {
        let Some(id) = self.bench.handles_message().handles.last().map(|h| h.id.clone()) else {
            return self.hold();
        };
        let pose = self.next(|seen, draw| seen.pose(draw, &id));
        self.poses = self
            .bench
            .change_poses_message(&self.poses, &message(&pose))
            .expect("a pose");
        self.shape = self.solved();
        assert!(self.shape.iter().all(|p| p.is_finite()), "{pose}");
        self.digests.push(digest(&self.shape));
        self.posed = true;
    }

    fn solved(&mut self) -> ModelShape {
        let solved = self.bench.solve(
            &self.poses,
            &self.settings,
            SolveMode::Commit,
            &Exec::new(&self.pool, &Silent),
            &mut |_| true,
        );
        let solved = solved.expect("solved");
        assert!(solved.stats.residual <= 1e-5, "{}", solved.stats.residual);
        solved
    }

    /// Edits, and checks what came of it.
    fn edit(&mut self) {
        let edit = self.next(|seen, draw| seen.edit(draw));
        let request: pb::EditRequest = message(&edit);
        let at_rest = edit["on"] == "REST";
        let shape = if at_rest {
            self.bench.rest_shape()
        } else {
            self.shape.clone()
        };
        let before = Before::of(&self.bench, &shape);
        match self
            .bench
            .edit_message(&request, &self.shape, &self.poses, &Exec::new(&self.pool, &Silent))
        {
            Ok(outcome) => {
                before.done(&self.bench, &edit, &outcome);
                self.counts[0] += 1;
                self.poses = outcome.poses;
                self.shape = outcome.shape;
                self.posed = false;
                if self.bench.handles_message().handles.len() < 2 {
                    self.hold();
                }
            }
            Err(error) => {
                before.refused(&self.bench, &error);
                self.counts[1] += 1;
                if self.posed {
                    let again = digest(&self.solved());
                    assert_eq!(
                        again,
                        digest(&self.shape),
                        "the same pose gives the same bits after {error}"
                    );
                }
            }
        }
        self.digests.push(digest(&self.shape));
    }

    /// `edits` edits, a pose after every other one.
    fn go(&mut self, edits: usize) {
        for k in 0..edits {
            self.edit();
            if k % 2 == 1 {
                self.pose();
            }
            if k % 10 == 9 {
                checks::written(&self.bench, &self.shape);
            }
        }
    }
}

/// The same run on one thread and on two, and back to the beginning: on a graph that is built again after edits, and on one that
/// follows them.
fn marathon(name: &str, files: &FileSet, seed: u64, most: usize) {
    for volume in [VolumeOptions::default(), VolumeOptions::paper()] {
        marathon_of(name, files, volume, seed, most);
    }
}

fn marathon_of(name: &str, files: &FileSet, volume: VolumeOptions, seed: u64, most: usize) {
    let [one, two] = std::thread::scope(|scope| {
        [1, 2]
            .map(|threads| {
                scope.spawn(move || {
                    let mut run = Run::new(files.clone(), volume, seed, threads, most);
                    let start = (digest(run.bench.rest()), run.bench.topology_state());
                    run.bench
                        .set_handles_message(&Default::default(), &Exec::new(&run.pool, &Silent))
                        .expect("none");
                    let base = run.bench.byte_size();
                    run.hold();
                    run.go(EDITS);
                    let end = run.bench.estimate();
                    run.bench
                        .restore_topology(&start.1, &Exec::new(&run.pool, &Silent))
                        .expect("the way back");
                    assert_eq!(digest(run.bench.rest()), start.0);
                    // Two states that were left are kept for the way back, and no more.
                    let kept = run.bench.byte_size() - base;
                    assert!(kept <= 2 * end, "{kept} bytes more than at the beginning");
                    (run.digests, run.counts)
                })
            })
            .map(|thread| thread.join().expect("no panic"))
    });
    assert_eq!(one, two, "{name}: the same bits on one thread and on two");
    let [done, refused] = one.1;
    println!(
        "{name}, interior of kind {:?}: {done} edits done, {refused} refused",
        volume.kind
    );
    assert!(done > EDITS / 2, "{done} of {EDITS} edits were possible");
}

#[test]
fn a_box() {
    marathon(
        "box",
        &obj(&shapes::box_with_cells(DVec3::new(1.0, 1.0, 3.0), [6, 6, 18])),
        1,
        2500,
    );
}

#[test]
fn a_torus() {
    marathon("torus", &obj(&shapes::torus(1.0, 0.4, 28, 14)), 2, 2500);
}

#[test]
fn an_open_sheet() {
    marathon("sheet", &obj(&shapes::grid(2.0, 1.0, [30, 15])), 3, 2000);
}

/// A model of the data folder; `None`, and a line that says so, without it.
fn data(name: &str) -> Option<FileSet> {
    data_bytes(name).map(|bytes| FileSet::single(name, bytes))
}

#[test]
fn texture_seams() {
    if let Some(files) = data("gltf/derived/spot_uv_split.glb") {
        marathon("spot", &files, 4, 3500);
    }
}

#[test]
fn a_skinned_figure() {
    if let Some(files) = data("gltf/CesiumMan.glb") {
        marathon("figure", &files, 5, 3500);
    }
}

#[test]
fn many_primitives() {
    if let Some(files) = data("gltf/ShapeCollection.glb") {
        marathon("shapes", &files, 6, 3500);
    }
}

/// Cycles of a few poses of the handles in force.
fn cycles(bench: &mut Deformer, diagonal: f64, run: &Run) -> Vec<u32> {
    let settings = settings(1e-5);
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
        all.push(solved.expect("solved").stats.cycles);
    }
    all
}

fn as_fresh(name: &str, shape: &shapes::Shape, seed: u64, edits: usize) {
    // A graph of kind PAPER follows edits; the other kind is built again.
    let mut options = OpenOptions::default();
    options.body.graph = VolumeOptions::paper();
    let mut run = Run::new(obj(shape), options.body.graph, seed, 2, 2500);
    // A bench that is freshly opened would weld parts that touch.
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
