//! `loadtest pipeline`: every stage from a model's file to the first frame's bytes.

use super::{GRAPH_STAGES, MeasuredModel, PassClock, encode_positions, open_for_job, seconds_of, set_job_handles};
use crate::failure::LoadtestFailure;
use crate::measurements::{Measurements, RunTimes, time_once};
use pliant::asset::FileSet;
use pliant::deform::{Error, FitOrder, PoseRequest, Quality, SolveState};
use pliant::engine::SolveMode;
use pliant::exec::Exec;
use pliant::exec::stage_clock::StageClock;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{DeformOptions, pb};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The stages in the order in which they run, and what they are.
const STAGES: [(&str, &str); 9] = [
    ("load", "the file into memory"),
    ("read", "vertices and triangles out of the file"),
    ("mesh", "welding, adjacency, inspection, parts"),
    ("graph", "interior nodes and edges"),
    ("hierarchy", "levels, without constraints"),
    ("fields", "regions to nodes, and the first pass's harmonic fields"),
    ("constrain", "the second pass's constraints"),
    ("solve", "the first frame: frames, right-hand sides, positions"),
    ("encode", "the frame's bytes, 32-bit positions"),
];

/// Arguments of `loadtest pipeline`.
#[derive(Debug, clap::Args)]
pub(crate) struct PipelineArgs {
    #[command(flatten)]
    model: MeasuredModel,
    /// Job file [default: fix one end of the model's longest side and turn the other]
    #[arg(long, value_name = "FILE")]
    job: Option<PathBuf>,
    /// Maximum runs, none begins after 4 s; the report shows the fastest
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// A first-frame run is one run: seconds by stage, and facts.
struct FirstFrameRun {
    seconds: BTreeMap<String, f64>,
    /// Of each part of building the graph.
    graph_parts: Vec<(&'static str, f64)>,
    /// Of each pass of the solve.
    solve_passes: Vec<(&'static str, f64)>,
    vertices: usize,
    nodes: usize,
    bytes: u64,
    cycles: u32,
    residual: f64,
    max_error: f64,
    frame_bytes: usize,
}

impl FirstFrameRun {
    fn total_seconds(&self) -> f64 {
        STAGES.iter().filter_map(|(stage, _)| self.seconds.get(*stage)).sum()
    }
}

pub(crate) fn run_pipeline(args: &PipelineArgs) -> Result<(), LoadtestFailure> {
    let pool = args.model.pool()?;
    let job = args.model.job(args.job.as_deref())?;
    let made = match args.model.subdivide {
        0 => None,
        _ => Some(args.model.files()?),
    };
    let source = || -> Result<FileSet, LoadtestFailure> {
        match &made {
            // Already in memory: loading it takes nothing.
            Some(files) => Ok(files.clone()),
            None => args.model.files(),
        }
    };
    let mut best: Option<FirstFrameRun> = None;
    let mut times: Option<RunTimes> = None;
    for _ in 0..args.repeat {
        if times.is_some_and(|t| !t.may_repeat()) {
            break;
        }
        let (files, load) = time_once(source);
        let mut now = run_once(files?, &job, &pool).map_err(|e| args.model.refusal(e))?;
        now.seconds.insert("load".into(), load);
        let total = now.total_seconds();
        match &mut times {
            Some(times) => times.add_run(total),
            None => times = Some(RunTimes::from_one(total)),
        }
        if best.as_ref().is_none_or(|best| total < best.total_seconds()) {
            best = Some(now);
        }
    }
    let best = best.ok_or_else(|| LoadtestFailure::Usage("nothing was run".into()))?;
    if args.json {
        println!("{}", run_measurements(&best, &args.model.path, &pool).to_json());
    } else {
        print!("{}", run_table(&best, &args.model.path, &pool));
    }
    Ok(())
}

/// Runs everything from files to the bytes of the first frame.
fn run_once(files: FileSet, job: &pb::Job, pool: &Pool) -> Result<FirstFrameRun, pliant::wire::Error> {
    let settings = DeformOptions::check(&job.options.unwrap_or_default(), "options", u32::MAX)?.solve;
    let start = Instant::now();
    let millis = || start.elapsed().as_secs_f64() * 1e3;
    let graph_clock = PassClock::new();
    let stages = StageClock::new(millis, &graph_clock);
    let mut bench = open_for_job(files, job, &Exec::new(pool, &stages))?;
    // Regions are resolved before the stage reports that it begins.
    stages.begin_stage("fields");
    let graph_parts = graph_clock.take();
    let poses = set_job_handles(&mut bench, job, &Exec::new(pool, &stages))?;
    stages.begin_stage("solve");
    let clock = PassClock::new();
    let solved = bench.solve(
        &poses,
        &settings,
        SolveMode::Commit,
        &Exec::new(pool, &clock),
        &mut |_| true,
    )?;
    let solve_passes = clock.take();
    stages.begin_stage("encode");
    let frame_bytes = encode_positions(solved.positions);
    let seconds = stages
        .take_stage_ms()
        .into_iter()
        .map(|(stage, ms)| (stage, ms / 1e3))
        .collect();
    Ok(FirstFrameRun {
        seconds,
        graph_parts,
        solve_passes,
        vertices: bench.rest().len(),
        nodes: bench.body().nodes(),
        bytes: bench.byte_size(),
        cycles: solved.stats.cycles,
        residual: solved.stats.residual,
        max_error: solved.stats.max_error,
        frame_bytes,
    })
}

fn run_measurements(run: &FirstFrameRun, model: &Path, pool: &Pool) -> Measurements {
    let mut measurements = Measurements::of_model(model);
    measurements.set_value("threads", pool.threads());
    measurements.set_value("vertices", run.vertices);
    measurements.set_value("nodes", run.nodes);
    for (stage, _) in STAGES {
        measurements.set_number(&format!("{stage}_s"), run.seconds.get(stage).copied().unwrap_or(0.0));
    }
    for (_, part, _) in GRAPH_STAGES {
        measurements.set_number(&format!("graph_{part}_s"), seconds_of(&run.graph_parts, part));
    }
    for (pass, seconds) in &run.solve_passes {
        measurements.set_number(&format!("solve_{pass}_s"), *seconds);
    }
    measurements.set_number("total_s", run.total_seconds());
    measurements.set_value("cycles", run.cycles);
    measurements.set_number("residual", run.residual);
    measurements.set_number("max_error", run.max_error);
    measurements.set_megabytes("held_MB", run.bytes as f64);
    measurements.set_megabytes("frame_MB", run.frame_bytes as f64);
    measurements
}

fn run_table(run: &FirstFrameRun, model: &Path, pool: &Pool) -> String {
    let mut text = format!(
        "{}: {} vertices, {} graph nodes, {} threads\n",
        model.display(),
        run.vertices,
        run.nodes,
        pool.threads()
    );
    for (stage, what) in STAGES {
        let seconds = run.seconds.get(stage).copied().unwrap_or(0.0);
        text += &format!("{stage:<10} {:>9.1} ms  {what}\n", seconds * 1e3);
        if stage == "graph" {
            for (_, part, what) in GRAPH_STAGES {
                let ms = seconds_of(&run.graph_parts, part) * 1e3;
                text += &format!("{:<10} {ms:>9.1} ms  {what}\n", format!("  {part}"));
            }
        }
        if stage == "solve" {
            for (pass, seconds) in &run.solve_passes {
                text += &format!("{:<10} {:>9.1} ms\n", format!("  {pass}"), seconds * 1e3);
            }
        }
    }
    text += &format!("{:<10} {:>9.1} ms\n", "total", run.total_seconds() * 1e3);
    text + &format!(
        "{} cycles, residual {:.1e}, error at most {:.1e} of the diagonal; {:.1} MB held, {:.1} MB a frame\n",
        run.cycles,
        run.residual,
        run.max_error,
        run.bytes as f64 / f64::from(1 << 20),
        run.frame_bytes as f64 / f64::from(1 << 20)
    )
}

/// Arguments of `loadtest energy`.
#[derive(Debug, clap::Args)]
pub(crate) struct EnergyArgs {
    #[command(flatten)]
    model: MeasuredModel,
    /// Job file [default: fix one end of the model's longest side and turn the other]
    #[arg(long, value_name = "FILE")]
    job: Option<PathBuf>,
    /// Refinements of each row
    #[arg(long, value_delimiter = ',', default_value = "0,1,2,4,8")]
    refine: Vec<u32>,
    /// Refinements of the reference
    #[arg(long, default_value_t = 300)]
    least: u32,
}

pub(crate) fn run_energy(args: &EnergyArgs) -> Result<(), LoadtestFailure> {
    let usage = |e: &dyn std::fmt::Display| args.model.refusal(e);
    let pool = args.model.pool()?;
    let exec = Exec::new(&pool, &Silent);
    let job = args.model.job(args.job.as_deref())?;
    let files = args.model.files()?;
    let mut bench = open_for_job(files, &job, &exec).map_err(|e| usage(&e))?;
    let poses = set_job_handles(&mut bench, &job, &exec).map_err(|e| usage(&e))?;
    let transforms = bench.transforms(&poses).map_err(|e| usage(&e))?;
    let Some(rig) = bench.handle_system() else {
        return Err(usage(&"no handles"));
    };
    let body = bench.body();
    let mut state = SolveState::default();
    let mut solve = |steps: u32, order: FitOrder| -> Result<(f64, f64, usize), Error> {
        let quality = Quality {
            refine: Some(steps),
            ..Quality::default()
        };
        let request = PoseRequest {
            fits: order,
            ..PoseRequest::new(&transforms, quality)
        };
        let start = Instant::now();
        let solution = rig.solve(body, &request, &mut state, &exec, &mut |_| true)?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let energy = rig.energy(body, &transforms, &solution.positions, &pool);
        Ok((energy, ms, solution.stats.cycles as usize))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::{DragScene, FARTHEST_POSE};
    use pliant::asset::sample;

    #[test]
    fn every_stage_takes_time_and_the_frame_is_whole() {
        let pool = Pool::new(1).unwrap();
        let scene = DragScene::load(None).unwrap();
        let job = scene.job(Some(FARTHEST_POSE));
        let files = FileSet::single("creature.glb", sample::creature_glb());
        let run = run_once(files, &job, &pool).unwrap();
        let timed: Vec<&str> = STAGES
            .iter()
            .map(|s| s.0)
            .filter(|s| run.seconds.contains_key(*s))
            .collect();
        assert_eq!(
            timed,
            STAGES.map(|s| s.0)[1..],
            "loading is timed by the caller, all other stages here"
        );
        assert_eq!(
            run.seconds.len(),
            timed.len(),
            "no stage is left out of the total: {:?}",
            run.seconds
        );
        let parts: Vec<f64> = GRAPH_STAGES.map(|stage| seconds_of(&run.graph_parts, stage.1)).into();
        assert!(parts.iter().all(|&s| s > 0.0) && parts.iter().sum::<f64>() <= run.seconds["graph"]);
        assert_eq!(run.frame_bytes, run.vertices * 12);
        assert!(run.cycles > 0 && run.residual <= 1e-4);
    }
}
