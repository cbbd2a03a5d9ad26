//! `loadtest edits`: from an edit of a few hundred vertices to the first frame after it, with graph and hierarchy
//! repaired, and with both rebuilt.

use super::{MeasuredModel, PassClock, encode_positions, seconds_of};
use crate::failure::LoadtestFailure;
use crate::measurements::{Measurements, RunTimes};
use crate::models::{DragScene, FARTHEST_POSE};
use pliant::asset::FileSet;
use pliant::engine::{
    Deformer, DeformerLimits, EditCommand, HandlePoses, HandleSet, ModelShape, OpenOptions, SolveMode, SolveSettings,
    TopologyState,
};
use pliant::exec::Exec;
use pliant::exec::stage_clock::StageClock;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::pb::edit_request::{Delete, Operation, Remesh};
use pliant::wire::{self, Error, pb};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// The stages in the order in which they run, and what they are.
const STAGES: [(&str, &str); 8] = [
    ("edit", "the operation, and the model with its attributes after it"),
    ("mesh", "what the solver sees of it"),
    ("graph", "interior nodes and edges"),
    ("hierarchy", "levels, without constraints"),
    ("fields", "handles to nodes, and the first pass's harmonic fields"),
    ("constrain", "the second pass's constraints"),
    ("solve", "the first frame of a drag"),
    ("encode", "the frame's bytes, 32-bit positions"),
];

/// Arguments of `loadtest edits`.
#[derive(Debug, clap::Args)]
pub(crate) struct EditsArgs {
    #[command(flatten)]
    model: MeasuredModel,
    /// Approximate number of vertices of the edited region
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(10..=1_000_000))]
    region: u32,
    /// Edit of the region
    #[arg(long, value_enum, default_value = "delete-fill")]
    operation: BenchedEdit,
    /// Edit the rest pose, not a committed pose
    #[arg(long)]
    at_rest: bool,
    /// Maximum runs of each; the report shows the fastest
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// What is done to a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum BenchedEdit {
    /// Delete it and fill the hole
    DeleteFill,
    /// Remesh it to its own mean edge length
    Remesh,
}

/// An edit bench holds a deformer in the state that is edited, again and again.
struct EditBench<'a> {
    bench: Deformer,
    trail: TopologyState,
    handles: HandleSet,
    poses: HandlePoses,
    shape: ModelShape,
    request: pb::EditRequest,
    pull: pb::Pose,
    pool: &'a Pool,
}

/// An edit run is one edit: milliseconds by stage, and facts.
#[derive(Clone)]
struct EditRun {
    ms: BTreeMap<String, f64>,
    /// Seconds of each pass of the first frame.
    passes: Vec<(&'static str, f64)>,
    repaired: bool,
    cycles: u32,
    field_cycles: usize,
    nodes: usize,
    levels: usize,
}

impl EditRun {
    fn stage_ms(&self, stage: &str) -> f64 {
        self.ms.get(stage).copied().unwrap_or(0.0)
    }

    fn total_ms(&self) -> f64 {
        self.ms.values().sum()
    }
}

pub(crate) fn run_edits(args: &EditsArgs) -> Result<(), LoadtestFailure> {
    let pool = args.model.pool()?;
    let files = args.model.files()?;
    let scene = args.model.scene()?;
    let refuse = |e: Error| args.model.refusal(e);
    let (mut stand, region) = open_edit_bench(args, files, &scene, &pool).map_err(refuse)?;
    let (mut repaired, mut rebuilt): (Option<EditRun>, Option<EditRun>) = (None, None);
    let mut times = RunTimes::from_one(0.0);
    for _ in 0..args.repeat {
        for (follow, best) in [(true, &mut repaired), (false, &mut rebuilt)] {
            let now = stand.edit_once(follow).map_err(refuse)?;
            times.add_run(now.total_ms() / 1e3);
            if best.as_ref().is_none_or(|best| now.total_ms() < best.total_ms()) {
                *best = Some(now);
            }
        }
        if !times.may_repeat() {
            break;
        }
    }
    let (Some(repaired), Some(rebuilt)) = (repaired, rebuilt) else {
        return Err(LoadtestFailure::Usage("nothing was run".into()));
    };
    if !repaired.repaired {
        eprintln!("the edit could not be followed: both columns were built from nothing");
    }
    let vertices = stand.shape.len();
    let solver_vertices = stand.bench.facts().solver.solver_vertices;
    if args.json {
        let mut measurements = Measurements::of_model(&args.model.path);
        measurements.set_value("threads", pool.threads());
        measurements.set_value("vertices", vertices);
        measurements.set_value("solver_vertices", solver_vertices);
        measurements.set_value("region", region);
        measurements.set_value("nodes", repaired.nodes);
        measurements.set_value("repaired", repaired.repaired);
        for (name, run) in [("repaired", &repaired), ("rebuilt", &rebuilt)] {
            for (stage, _) in STAGES {
                measurements.set_number(&format!("{name}_{stage}_ms"), run.stage_ms(stage));
            }
            measurements.set_number(&format!("{name}_total_ms"), run.total_ms());
            measurements.set_value(&format!("{name}_cycles"), run.cycles);
            measurements.set_value(&format!("{name}_field_cycles"), run.field_cycles);
        }
        println!("{}", measurements.to_json());
        return Ok(());
    }
    println!(
        "{}: {vertices} vertices ({solver_vertices} of the solver), a region of {region}, {} threads",
        args.model.path.display(),
        pool.threads()
    );
    println!("{:<10} {:>11} {:>11}", "stage", "repaired", "rebuilt");
    let row = |name: &str, [one, other]: [f64; 2], more: &str| {
        println!("{name:<10} {one:>8.1} ms {other:>8.1} ms{more}");
    };
    for (stage, what) in STAGES {
        row(
            stage,
            [&repaired, &rebuilt].map(|run| run.stage_ms(stage)),
            &format!("  {what}"),
        );
        if stage == "solve" {
            for (pass, seconds) in &repaired.passes {
                let ms = [seconds * 1e3, seconds_of(&rebuilt.passes, pass) * 1e3];
                row(&format!("  {pass}"), ms, "");
            }
        }
    }
    let times = |[one, other]: [f64; 2]| format!("  {:.1} times", other / one);
    let total = [&repaired, &rebuilt].map(EditRun::total_ms);
    row("total", total, &times(total));
    let follows = ["edit", "mesh", "graph", "hierarchy", "fields", "constrain"];
    let follow = [&repaired, &rebuilt].map(|run| follows.iter().map(|stage| run.stage_ms(stage)).sum::<f64>());
    row("follow", follow, &(times(follow) + ", without the frame itself"));
    println!(
        "{} graph nodes on {} levels; cycles of the fields {} and {}, of the first frame {} and {}",
        repaired.nodes, repaired.levels, repaired.field_cycles, rebuilt.field_cycles, repaired.cycles, rebuilt.cycles
    );
    Ok(())
}

/// Opens the model, commits a pose, and chooses the region. Also answers how many vertices that has.
fn open_edit_bench<'a>(
    args: &EditsArgs,
    files: FileSet,
    scene: &DragScene,
    pool: &'a Pool,
) -> Result<(EditBench<'a>, usize), Error> {
    let mut bench = Deformer::open(
        files,
        &OpenOptions::default(),
        &DeformerLimits::default(),
        &Exec::new(pool, &Silent),
    )?;
    let handles = wire::handle_set(&pb::SetHandlesRequest {
        handles: scene.handles(),
        ..Default::default()
    })?;
    bench.set_handles(&handles, &Exec::new(pool, &Silent))?;
    let mut poses = bench.initial_poses();
    let mut shape = bench.rest_shape();
    if !args.at_rest {
        poses = wire::change_poses(&bench, &poses, &scene.pose_number(FARTHEST_POSE / 2))?;
        shape = solve_commit(&mut bench, &poses, pool)?;
    }
    let (sphere, region) = sphere_around_middle(&shape, args.region as usize);
    let region_of = || {
        Some(pb::Region {
            region: Some(pb::region::Region::Sphere(sphere.clone())),
        })
    };
    let operation = match args.operation {
        BenchedEdit::DeleteFill => Operation::Delete(Delete {
            region: region_of(),
            fill: true,
        }),
        BenchedEdit::Remesh => Operation::Remesh(Remesh {
            region: region_of(),
            // About the mean edge of the region: its area is shared by twice as many triangles as vertices.
            edge_length: sphere.radius * (std::f64::consts::PI / (0.433 * 2.0 * region as f64)).sqrt(),
            ..Remesh::default()
        }),
    };
    let stand = EditBench {
        trail: bench.topology_state(),
        handles,
        poses,
        shape,
        request: pb::EditRequest {
            operation: Some(operation),
            ..Default::default()
        },
        pull: scene.pose_number(FARTHEST_POSE / 2),
        bench,
        pool,
    };
    Ok((stand, region))
}

fn solve_commit(bench: &mut Deformer, poses: &HandlePoses, pool: &Pool) -> Result<ModelShape, Error> {
    let (settings, exec) = (SolveSettings::default(), Exec::new(pool, &Silent));
    bench.solve(poses, &settings, SolveMode::Commit, &exec, &mut |_| true)
}

/// Finds a sphere around the vertex nearest to the middle of the shape, with `count` vertices inside.
fn sphere_around_middle(shape: &[glam::DVec3], count: usize) -> (pb::region::Sphere, usize) {
    let (low, high) = shape
        .iter()
        .fold((shape[0], shape[0]), |(low, high), p| (low.min(*p), high.max(*p)));
    let middle = (low + high) * 0.5;
    let nearest = shape.iter().copied().min_by(|a, b| {
        let distance = |p: &glam::DVec3| p.distance_squared(middle);
        distance(a).total_cmp(&distance(b))
    });
    let center = nearest.unwrap_or(middle);
    let mut distances: Vec<f64> = shape.iter().map(|p| p.distance(center)).collect();
    distances.sort_unstable_by(f64::total_cmp);
    let count = count.min(distances.len() - 1);
    let sphere = pb::region::Sphere {
        center: center.to_array().to_vec(),
        radius: distances[count],
    };
    (sphere, count)
}

impl EditBench<'_> {
    /// Goes to the state before, edits, and takes the first frame of a drag.
    fn edit_once(&mut self, follow: bool) -> Result<EditRun, Error> {
        let (pool, bench) = (self.pool, &mut self.bench);
        bench.restore_topology(&self.trail, &Exec::new(pool, &Silent))?;
        bench.set_handles(&self.handles, &Exec::new(pool, &Silent))?;
        if self.shape.id != bench.rest_shape().id {
            self.shape = solve_commit(bench, &self.poses, pool)?;
        }
        // A shape that the bench knows nothing of but the vertices is built on from the start.
        let shape = match follow {
            true => self.shape.clone(),
            false => ModelShape::from_positions(Arc::new(self.shape.to_vec())),
        };
        let (edit, on) = wire::edit(&self.request, None)?;
        let order = EditCommand {
            edit: &edit,
            on,
            shape: &shape,
            poses: &self.poses,
            settings: None,
        };
        let start = Instant::now();
        let millis = || start.elapsed().as_secs_f64() * 1e3;
        let stages = StageClock::new(millis, &Silent);
        stages.begin_stage("edit");
        let outcome = bench.edit(&order, &Exec::new(pool, &stages))?;
        stages.begin_stage("solve");
        let settings = SolveSettings::default();
        let poses = wire::change_poses(bench, &outcome.poses, &self.pull)?;
        let clock = PassClock::new();
        let exec = Exec::new(pool, &clock);
        let solved = bench.solve(&poses, &settings, SolveMode::Drag, &exec, &mut |_| true)?;
        let passes = clock.take();
        stages.begin_stage("encode");
        encode_positions(solved.positions);
        Ok(EditRun {
            ms: stages.take_stage_ms(),
            passes,
            repaired: outcome.report.repaired,
            cycles: solved.stats.cycles,
            field_cycles: bench.handle_system().map_or(0, |rig| rig.field_iterations),
            nodes: bench.body().nodes(),
            levels: bench.body().hierarchy.level_sizes().len(),
        })
    }
}
