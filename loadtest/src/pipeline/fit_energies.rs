//! `loadtest energy`: what re-fits of rotations bring, and what they take, beside hundreds of them.

use crate::failure::LoadtestFailure;
use crate::shared::drag_scene::{DragScene, FARTHEST_POSE};
use crate::shared::input_files::{read_job_file, read_model_file};
use crate::shared::subdivide::{MOST_SUBDIVISIONS, subdivide_model};
use pliant::batch::pose_steps;
use pliant::deform::{Error, FirstPass, FitOrder, PoseRequest, Refinement, SolutionExtent, SolveStart, SolveState};
use pliant::engine::{Deformer, DeformerLimits};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{self, pb};
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `loadtest energy`.
#[derive(Debug, clap::Args)]
pub(crate) struct EnergyArgs {
    /// Model file: glb or gltf with embedded buffers, obj, ply, off or stl
    model: PathBuf,
    /// Job file [default: fix one end of the model's longest side and turn the other]
    #[arg(long, value_name = "FILE")]
    job: Option<PathBuf>,
    /// Number of subdivisions of every triangle into four beforehand
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=i64::from(MOST_SUBDIVISIONS)))]
    subdivide: u8,
    /// Threads; 0 means one per core
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// Refinements of each row
    #[arg(long, value_delimiter = ',', default_value = "0,1,2,4,8")]
    refine: Vec<u32>,
    /// Refinements of the reference
    #[arg(long, default_value_t = 300)]
    least: u32,
}

/// Runs the command.
pub(crate) fn run_energy(args: &EnergyArgs) -> Result<(), LoadtestFailure> {
    let usage = |e: &dyn std::fmt::Display| LoadtestFailure::Usage(format!("{}: {e}", args.model.display()));
    let pool = Pool::new(usize::from(args.threads)).map_err(|e| LoadtestFailure::Server(e.to_string()))?;
    let exec = Exec::new(&pool, &Silent);
    let job = match &args.job {
        Some(path) => read_job_file(path)?,
        None => {
            let scene = DragScene::load(Some(&args.model))?;
            let step = pb::step::Step::Pose(scene.pose_number(FARTHEST_POSE));
            pb::Job {
                handles: scene.handles(),
                steps: vec![pb::Step { step: Some(step) }],
                ..Default::default()
            }
        }
    };
    let files = match args.subdivide {
        0 => read_model_file(&args.model)?,
        times => subdivide_model(read_model_file(&args.model)?, times)?,
    };
    let options = wire::open_options(&job.create.clone().unwrap_or_default()).map_err(|e| usage(&e))?;
    let mut bench = Deformer::open(files, &options, &DeformerLimits::default(), &exec).map_err(|e| usage(&e))?;
    let request = pb::SetHandlesRequest {
        handles: job.handles.clone(),
        symmetry_plane: job.symmetry_plane.clone(),
        region_of_interest: job.region_of_interest.clone(),
        ..Default::default()
    };
    let handles = wire::handle_set(&request).map_err(|e| usage(&e))?;
    bench.set_handles(handles, &exec).map_err(|e| usage(&e))?;
    let mut poses = bench.initial_poses();
    for pose in pose_steps(&job).map_err(|e| usage(&e))? {
        poses = wire::change_poses(&bench, &poses, &pose).map_err(|e| usage(&e))?;
    }
    let transforms = bench.transforms(&poses).map_err(|e| usage(&e))?;
    let Some(rig) = bench.rig() else {
        return Err(usage(&"no handles"));
    };
    let body = bench.body();
    let mut state = SolveState::default();
    let mut solve = |steps: u32, order: FitOrder| -> Result<(f64, f64, usize), Error> {
        let request = PoseRequest {
            transforms: &transforms,
            tolerance: Some(1e-4),
            max_error: None,
            start: SolveStart::Fresh,
            first_pass: FirstPass::Harmonic,
            refinement: Refinement {
                steps,
                order,
                ..Refinement::default()
            },
            extent: SolutionExtent::Graph,
        };
        let start = Instant::now();
        let solution = rig.solve(body, &request, &mut state, &exec, &mut |_| true)?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let energy = rig.energy(body, &transforms, &solution.positions, &pool);
        Ok((energy, ms, solution.iterations))
    };
    let (least, ms, cycles) = solve(args.least, FitOrder::GraphAlone).map_err(|e| usage(&e))?;
    println!(
        "{} nodes; energy {least:.4e} after {} re-fits on the graph alone, {ms:.0} ms, {cycles} cycles",
        body.nodes(),
        args.least
    );
    println!(
        "{:>7}  {:>8} {:>8} {:>6}   {:>8} {:>8} {:>6}",
        "re-fits", "energy", "ms", "cycles", "alone", "ms", "cycles"
    );
    for &steps in &args.refine {
        let (energy, ms, cycles) = solve(steps, FitOrder::CoarseFirst).map_err(|e| usage(&e))?;
        let (alone, alone_ms, alone_cycles) = solve(steps, FitOrder::GraphAlone).map_err(|e| usage(&e))?;
        let (energy, alone) = (energy / least, alone / least);
        println!("{steps:>7}  {energy:>8.4} {ms:>8.1} {cycles:>6}   {alone:>8.4} {alone_ms:>8.1} {alone_cycles:>6}");
    }
    Ok(())
}
