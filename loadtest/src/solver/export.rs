//! `loadtest export-system`: the second-pass system of a pose as files that any solver can read.

use super::companion::{CompanionFile, PoseSystem};
use super::problem::{CompressedRows, LinearProblem};
use crate::failure::LoadtestFailure;
use crate::models::{MOST_SUBDIVISIONS, read_job_file, read_model_file, subdivide_model};
use crate::pipeline::{open_for_job, set_job_handles};
use glam::DVec3;
use pliant::deform::{DeformableBody, HandleSystem, SecondPassEquations, Transform};
use pliant::engine::{Deformer, HandlePoses};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::pb;
use std::path::PathBuf;

/// Largest displacement of a handle from the first pose to the second, as a fraction of the diagonal.
const STEP: f64 = 0.01;

/// Arguments of `loadtest export-system`.
#[derive(Debug, clap::Args)]
pub(crate) struct ExportArgs {
    /// Model file: glb or gltf with embedded buffers, obj, ply, off, stl or 3mf
    model: PathBuf,
    /// Job file: session options, handles, and the pose after its last step
    #[arg(long, value_name = "FILE")]
    job: PathBuf,
    /// Output problem file; its companion is written beside it with the extension aux
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Number of subdivisions of every triangle into four beforehand; the model's vertices keep their numbers
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=i64::from(MOST_SUBDIVISIONS)))]
    subdivide: u8,
}

pub(crate) fn run_export(args: &ExportArgs) -> Result<(), LoadtestFailure> {
    if args.output.extension().is_some_and(|e| e == "aux") {
        let problem = "ends in aux, which its companion is named with";
        return Err(LoadtestFailure::Usage(format!("{} {problem}", args.output.display())));
    }
    let pool = Pool::new(0)?;
    let job = read_job_file(&args.job)?;
    let model = subdivide_model(read_model_file(&args.model)?, args.subdivide)?;
    let refuse = |e: pliant::wire::Error| match e {
        pliant::wire::Error::Asset(e) => LoadtestFailure::Usage(e.to_string()),
        e => LoadtestFailure::Usage(format!("{}: {e}", args.job.display())),
    };
    let (bench, poses) = open_posed(model, &job, &pool).map_err(refuse)?;
    let transforms = bench.transforms(&poses).map_err(refuse)?;
    let rig = bench
        .handle_system()
        .ok_or_else(|| LoadtestFailure::Usage("the job has no handles".into()))?;
    let (problem, companion) = pose_systems(bench.body(), rig, &transforms, &pool).map_err(LoadtestFailure::Usage)?;
    problem.write(&args.output)?;
    companion.write(&CompanionFile::path_beside(&args.output))?;
    println!(
        "n {} nnz {} handles {} given {} of {} nodes -> {}",
        problem.matrix.rows(),
        problem.matrix.entries(),
        rig.handle_count(),
        companion.fixed.iter().filter(|f| **f).count(),
        companion.rest.len(),
        args.output.display()
    );
    Ok(())
}

/// Opens a model with the job's handles, and computes the poses after its last step.
fn open_posed(
    model: pliant::asset::FileSet,
    job: &pb::Job,
    pool: &Pool,
) -> Result<(Deformer, HandlePoses), pliant::wire::Error> {
    let exec = Exec::new(pool, &Silent);
    let mut bench = open_for_job(model, job, &exec)?;
    let poses = set_job_handles(&mut bench, job, &exec)?;
    Ok((bench, poses))
}

/// Builds the system of a pose over its free nodes, and over all nodes with the pose one step on.
fn pose_systems(
    body: &DeformableBody,
    rig: &HandleSystem,
    transforms: &[Transform],
    pool: &Pool,
) -> Result<(LinearProblem, CompanionFile), String> {
    let next = one_step_on(body, rig, transforms)?;
    let first = rig.equations(body, transforms, pool);
    let second = equations_around(rig.equations(body, &next, pool), first.center, rig);
    let (graph, stiffness) = (&body.graph, rig.stiffness());
    let companion = CompanionFile {
        diagonal: body.diagonal / body.unit(),
        offsets: graph.offsets.clone(),
        neighbours: graph.neighbours.clone(),
        weights: graph.weights.clone(),
        fixed: rig.given().to_vec(),
        stiffness,
        frames: first.frames,
        rest: body.rest_of_all(pool),
        poses: [(first.rhs, first.given), (second.rhs, second.given)].map(|(rhs, given)| PoseSystem { rhs, given }),
    };
    Ok((free_system(&companion)?, companion))
}

/// Moves the transforms further along their way, so that the handle that moves most does so by [`STEP`].
fn one_step_on(body: &DeformableBody, rig: &HandleSystem, transforms: &[Transform]) -> Result<Vec<Transform>, String> {
    let scaled = |by: f64| -> Vec<Transform> {
        let further = |t: &Transform| Transform {
            translation: t.translation * by,
            rotation: t.rotation * by,
            log_scale: t.log_scale * by,
            pivot: t.pivot,
        };
        transforms.iter().map(further).collect()
    };
    let moved = |by: f64| -> f64 {
        let next = scaled(by);
        let holds = rig.setup().handles.iter().zip(transforms.iter().zip(&next));
        let farthest = holds.filter(|(hold, _)| hold.position).map(|(hold, (a, b))| {
            let (from, to) = (a.map(), b.map());
            let apart = |n: &u32| {
                let p: DVec3 = body.graph.positions[*n as usize];
                from(p).distance(to(p))
            };
            hold.nodes.iter().map(apart).fold(0.0, f64::max)
        });
        farthest.fold(0.0, f64::max)
    };
    let wanted = STEP * body.diagonal;
    let mut step = STEP;
    // Displacement is nearly proportional to the step, so a few corrections settle it.
    for _ in 0..8 {
        let seen = moved(1.0 + step);
        if !(seen > 0.0 && seen.is_finite()) {
            return Err("no handle moves in the job's pose, so there is no step to go on".into());
        }
        step *= wanted / seen;
    }
    Ok(scaled(1.0 + step))
}

/// Writes the same equations around another centre.
fn equations_around(mut equations: SecondPassEquations, center: [f64; 3], rig: &HandleSystem) -> SecondPassEquations {
    let shift = DVec3::from_array(equations.center) - DVec3::from_array(center);
    let moved = |v: &mut [f64; 3], by: f64| *v = (DVec3::from_array(*v) + shift * by).to_array();
    equations.given.iter_mut().for_each(|v| moved(v, 1.0));
    if let Some(stiffness) = rig.stiffness() {
        let soft = equations.rhs.iter_mut().zip(&stiffness).zip(rig.given());
        soft.filter(|(_, given)| !**given).for_each(|((v, s), _)| moved(v, *s));
    }
    equations.center = center;
    equations
}

/// Takes the rows and columns of the nodes that are not given, with given neighbours moved to the right (equation 11).
fn free_system(all: &CompanionFile) -> Result<LinearProblem, String> {
    let mut number = vec![-1i32; all.rest.len()];
    let mut free = 0;
    for (number, _) in number.iter_mut().zip(&all.fixed).filter(|(_, fixed)| !**fixed) {
        *number = free;
        free += 1;
    }
    if free == 0 {
        return Err("every node is given, there is nothing to solve".into());
    }
    let (mut starts, mut columns, mut values) = (vec![0i64], Vec::new(), Vec::new());
    let (mut rhs, mut rest) = (Vec::new(), Vec::new());
    let pose = &all.poses[0];
    for i in (0..all.rest.len()).filter(|i| !all.fixed[*i]) {
        let mut b = DVec3::from_array(pose.rhs[i]);
        let mut diagonal = all.stiffness.as_ref().map_or(0.0, |s| s[i]);
        let begin = columns.len();
        for e in all.offsets[i] as usize..all.offsets[i + 1] as usize {
            let j = all.neighbours[e] as usize;
            let w = all.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
            diagonal += w;
            if all.fixed[j] {
                b += w * DVec3::from_array(pose.given[j]);
            } else {
                columns.push(number[j]);
                values.push(-w);
            }
        }
        let at = begin + columns[begin..].partition_point(|&c| c < number[i]);
        columns.insert(at, number[i]);
        values.insert(at, diagonal);
        starts.push(columns.len() as i64);
        rhs.push(b.to_array());
        rest.push(all.rest[i]);
    }
    let matrix = CompressedRows::new(starts, columns, values)?;
    Ok(LinearProblem { matrix, rhs, rest })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use pliant::asset::{FileSet, sample};
    use pliant::deform::{PoseRequest, Quality, SolveState};

    /// The creature with its feet held hard, its head turned, and a soft tail.
    const JOB: &str = r#"{"handles": [
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
        {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}},
         "pose": {"rotationVector": [0, 0.8, 0], "translation": [0, 0.1, 0]}},
        {"id": "tail", "region": {"sphere": {"center": [-1.0, 1.06, 0], "radius": 0.16}}, "stiffness": 0.5,
         "pose": {"translation": [0, 0.2, 0]}}]}"#;

    fn bench(pool: &Pool) -> (Deformer, Vec<Transform>) {
        let job: pb::Job = pliant::wire::json::from_json(JOB.as_bytes()).unwrap();
        let files = FileSet::single("creature.glb", sample::creature_glb());
        let (bench, poses) = open_posed(files, &job, pool).unwrap();
        let transforms = bench.transforms(&poses).unwrap();
        (bench, transforms)
    }

    /// The creature's systems, as they are written.
    pub(crate) fn creature_systems(pool: &Pool) -> (LinearProblem, CompanionFile) {
        let (bench, transforms) = bench(pool);
        pose_systems(bench.body(), bench.handle_system().unwrap(), &transforms, pool).unwrap()
    }

    #[test]
    fn the_exported_system_is_the_one_that_is_solved() {
        let pool = Pool::new(1).unwrap();
        let (bench, transforms) = bench(&pool);
        let (body, rig) = (bench.body(), bench.handle_system().unwrap());
        let (problem, all) = pose_systems(body, rig, &transforms, &pool).unwrap();
        assert!(all.stiffness.as_ref().is_some_and(|s| s.iter().any(|s| *s > 0.0)));
        assert_eq!(problem.matrix.rows(), all.fixed.iter().filter(|f| !**f).count());
        // From model space to the coordinates of the files.
        let origin = body.graph.positions[0] - body.rest(0) * body.unit();
        let center = DVec3::from_array(rig.equations(body, &transforms, &pool).center);
        let next = one_step_on(body, rig, &transforms).unwrap();
        for (k, transforms) in [&transforms, &next].into_iter().enumerate() {
            let quality = Quality {
                tolerance: Some(1e-11),
                ..Quality::default()
            };
            let request = PoseRequest::new(transforms, quality);
            let mut state = SolveState::default();
            let solution = rig
                .solve(body, &request, &mut state, &Exec::new(&pool, &Silent), &mut |_| true)
                .unwrap();
            let solved = solution.positions.iter();
            let x: Vec<DVec3> = solved.map(|p| (*p - origin) / body.unit() - center).collect();
            let far = |i: usize| {
                if all.fixed[i] {
                    return x[i].distance(DVec3::from_array(all.poses[k].given[i]));
                }
                let soft = all.stiffness.as_ref().map_or(0.0, |s| s[i]);
                let row = all.offsets[i] as usize..all.offsets[i + 1] as usize;
                let weight = |e: usize| all.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
                let sum: DVec3 = row.map(|e| weight(e) * (x[i] - x[all.neighbours[e] as usize])).sum();
                (sum + soft * x[i]).distance(DVec3::from_array(all.poses[k].rhs[i]))
            };
            let most = (0..x.len()).map(far).fold(0.0, f64::max);
            assert!(most < 1e-8, "pose {k} misses its equations by {most}");
            if k == 0 {
                let free: Vec<_> = (0..x.len())
                    .filter(|i| !all.fixed[*i])
                    .map(|i| x[i].to_array())
                    .collect();
                let (each, _) = problem.matrix.residuals(&problem.rhs, &free);
                assert!(each.iter().all(|r| *r < 1e-8), "{each:?}");
            }
        }
    }

    #[test]
    fn the_second_pose_is_one_step_on() {
        let (_, all) = creature_systems(&Pool::new(1).unwrap());
        let [first, second] = &all.poses;
        let apart = |i: usize| DVec3::from_array(first.given[i]).distance(DVec3::from_array(second.given[i]));
        let given = (0..all.rest.len()).filter(|i| all.fixed[*i]);
        let hard = given.map(apart).fold(0.0, f64::max) / all.diagonal;
        // The head goes further than the tail, so the largest step is a given node's.
        assert!((hard - STEP).abs() < 1e-3 * STEP, "{hard}");
    }
}
