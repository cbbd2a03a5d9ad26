//! The solver on systems of real models: the same bits on any number of threads, an error estimate that keeps its
//! promise, fields that are shares.
//!
//! Models come from the folder `PLIANT_DATA`. That both profiles give the same bits is checked by whichever of
//! `cargo test --test solver_data` and `cargo test --release --test solver_data` runs second on the same sources.

use glam::{DAffine3, DQuat, DVec3};
use pliant::deform::{HandleConstraint, HandleMotion, HandleSetup, HandleSystem, Transform, carry};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::solver::{
    BuildOptions, Constraints, Hierarchy, InitialGuess, IterationReport, LinearSystem, SolveControl, SolveMethod,
    SolveOptions, SolveStats, Workspace,
};
use sha2::{Digest, Sha256};
use std::sync::OnceLock;
use systems::{Rung, rungs};

#[path = "solver_data/recorded.rs"]
mod recorded;
#[path = "support/shapes.rs"]
#[allow(dead_code)]
mod shapes;
#[path = "solver_data/systems.rs"]
mod systems;

/// The systems, made once for all tests.
fn all() -> &'static [Rung] {
    static RUNGS: OnceLock<Vec<Rung>> = OnceLock::new();
    RUNGS.get_or_init(|| {
        let rungs = rungs();
        for rung in &rungs {
            println!("{}: {} nodes, {} of them free", rung.name, rung.nodes(), rung.free());
            assert!(
                rung.free() > 15_000,
                "{}: large enough to have levels and blocks",
                rung.name
            );
        }
        rungs
    })
}

/// A hierarchy, a system and memory to solve with.
struct Ready<'a> {
    rung: &'a Rung,
    hierarchy: Hierarchy,
    system: LinearSystem,
    workspace: Workspace,
    pool: Pool,
}

impl Ready<'_> {
    fn new(rung: &Rung, threads: usize) -> Ready<'_> {
        let pool = Pool::new(threads).unwrap();
        let hierarchy = Hierarchy::build(&rung.graph(), &BuildOptions::default(), &Exec::new(&pool, &Silent)).unwrap();
        let system = rung.constrain(&hierarchy, &pool);
        Ready {
            rung,
            hierarchy,
            system,
            workspace: Workspace::default(),
            pool,
        }
    }

    /// Solves a pose from the values in `x`.
    fn solve(
        &mut self,
        pose: usize,
        x: &mut [f64],
        options: &SolveOptions<'_>,
        watch: &mut dyn FnMut(&IterationReport<'_>),
    ) -> SolveStats {
        let (rung, workspace) = (self.rung, &mut self.workspace);
        let rhs = &rung.poses[pose].rhs;
        let mut watch = |iteration: &IterationReport<'_>| {
            watch(iteration);
            SolveControl::Continue
        };
        let (hierarchy, pool) = (&self.hierarchy, &self.pool);
        let stats = self
            .system
            .equations(hierarchy, 3, rhs)
            .solve(x, options, workspace, &Exec::new(pool, &Silent), &mut watch)
            .unwrap();
        assert!(stats.converged, "{}: {stats:?}", rung.name);
        stats
    }

    /// A pose solved as far as double precision carries.
    fn exact(&mut self, pose: usize) -> Vec<f64> {
        let mut x = self.rung.poses[pose].given.clone();
        let tight = |tolerance: f64, start| SolveOptions {
            start,
            tolerance: Some(tolerance),
            ..Default::default()
        };
        self.solve(pose, &mut x, &tight(1e-11, InitialGuess::Zero), &mut |_| {});
        let before = x.clone();
        self.solve(pose, &mut x, &tight(1e-12, InitialGuess::Given), &mut |_| {});
        let change = self.rung.apart(&before, &x);
        assert!(change < 1e-8, "{}: still moving by {change:e}", self.rung.name);
        x
    }
}

/// The full-multigrid start with all that the second pass knows.
fn full_multigrid(rung: &Rung) -> InitialGuess<'_> {
    InitialGuess::FullMultigrid {
        frames: Some(&rung.frames),
        rest: Some(&rung.rest),
    }
}

/// The solution of the first pose carried along by what the handles did since, as a drag starts.
fn carried(rung: &Rung, from: &[f64], pool: &Pool) -> Vec<f64> {
    let (body, rig) = (rung.body(), rung.rig());
    // A given node says where solving coordinates have their origin.
    let given = rig.given().iter().position(|g| *g).unwrap();
    let owner = rig
        .setup()
        .handles
        .iter()
        .position(|h| h.nodes.contains(&(given as u32)))
        .unwrap();
    let model = rung.poses[0].transforms[owner].map()(body.graph.positions[given]);
    let origin = model - DVec3::from_slice(&rung.poses[0].given[3 * given..]) * body.unit();
    let into = DAffine3::from_scale_rotation_translation(DVec3::splat(body.unit()), DQuat::IDENTITY, origin);
    let affine =
        |t: &Transform| DAffine3::from_mat3_translation(t.linear(), t.pivot + t.translation - t.linear() * t.pivot);
    let pairs = rung.poses[0].transforms.iter().zip(&rung.poses[1].transforms);
    let motions: Vec<HandleMotion<'_>> = pairs
        .enumerate()
        .map(|(k, (a, b))| HandleMotion {
            field: rig.rotation_fields().of(k),
            map: into.inverse() * affine(b) * affine(a).inverse() * into,
        })
        .collect();
    let mut x = from.to_vec();
    carry(&mut x, &motions, pool);
    rung.placed(1, x)
}

fn digest(x: &[f64]) -> String {
    let mut sha = Sha256::new();
    x.iter().for_each(|v| sha.update(v.to_bits().to_le_bytes()));
    sha.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// Digests after a full-multigrid solve, a drag frame as sessions solve it, and the same frame solved further.
fn run(rung: &Rung, threads: usize) -> Vec<String> {
    let mut ready = Ready::new(rung, threads);
    let mut x = rung.poses[0].given.clone();
    let options = SolveOptions {
        start: full_multigrid(rung),
        tolerance: Some(1e-4),
        ..Default::default()
    };
    ready.solve(0, &mut x, &options, &mut |_| {});
    let mut digests = vec![digest(&x)];
    let mut x = carried(rung, &x, &ready.pool);
    digests.push(digest(&x));
    for (tolerance, max_error) in [(None, Some(1e-3 * rung.diagonal)), (Some(1e-6), None)] {
        let options = SolveOptions {
            start: InitialGuess::Given,
            tolerance,
            max_error,
            ..Default::default()
        };
        ready.solve(1, &mut x, &options, &mut |_| {});
        digests.push(digest(&x));
    }
    digests
}

#[test]
fn positions_are_the_same_bits_on_any_number_of_threads() {
    let mut lines = Vec::new();
    for rung in all() {
        let want = run(rung, 1);
        for threads in [1, 2, 3, 4, 8] {
            assert_eq!(run(rung, threads), want, "{} on {threads} threads", rung.name);
        }
        println!("{}: {}", rung.name, want.join(" "));
        lines.push(format!("{} ({} nodes): {}", rung.name, rung.nodes(), want.join(" ")));
    }
    recorded::compare_with_other_profile(&lines);
}

/// Below this part of the diagonal, digits of single precision are what is left of an error.
const FLOOR: f64 = 1e-6;

#[test]
fn error_estimates_keep_within_their_bounds() {
    let mut broken = Vec::new();
    for rung in all() {
        let mut ready = Ready::new(rung, 2);
        let exact = [0, 1].map(|pose| ready.exact(pose));
        assert!(
            largest_residual(rung, &exact[0]) < 1e-10,
            "{}: equations hold",
            rung.name
        );
        let rest = rung.placed(0, vec![0.0; 3 * rung.nodes()]);
        let starts = [
            ("zero", 0, InitialGuess::Zero, rest.clone()),
            ("full multigrid", 0, full_multigrid(rung), rest),
            ("last frame", 1, InitialGuess::Given, rung.placed(1, exact[0].clone())),
            ("carried", 1, InitialGuess::Given, carried(rung, &exact[0], &ready.pool)),
        ];
        for (start_name, pose, start, from) in starts {
            for (by, tolerance, max_error) in [
                ("residual", Some(1e-9), None),
                ("rough residual", Some(1e-4), None),
                ("error", None, Some(FLOOR * rung.diagonal)),
            ] {
                let options = SolveOptions {
                    start,
                    tolerance,
                    max_error,
                    ..Default::default()
                };
                let (mut x, mut now) = (from.clone(), from.clone());
                let mut seen = Vec::new();
                let stats = ready.solve(pose, &mut x, &options, &mut |iteration| {
                    iteration.copy_to(&mut now);
                    let truth = rung.apart(&now, &exact[pose]);
                    if iteration.index >= 2 && truth > FLOOR {
                        seen.push((iteration.index, iteration.max_error / rung.diagonal, truth));
                    }
                });
                assert_eq!(stats.method, SolveMethod::Multigrid);
                let ratios: Vec<f64> = seen.iter().map(|(_, e, t)| e / t).collect();
                let (least, most) = ratios
                    .iter()
                    .fold((f64::INFINITY, 0.0f64), |(a, b), r| (a.min(*r), b.max(*r)));
                println!(
                    "{} from {start_name} by {by}: {} iterations, {} judged, ratio {least:.2} to {most:.2}",
                    rung.name,
                    stats.iterations,
                    seen.len()
                );
                for ((index, estimate, truth), ratio) in seen.iter().zip(&ratios) {
                    if !(0.5..=3.0).contains(ratio) {
                        broken.push(format!(
                            "{} from {start_name} by {by}, iteration {index}: {estimate:.3e} for {truth:.3e}, ratio {ratio:.2}",
                            rung.name
                        ));
                    }
                }
            }
        }
    }
    assert!(broken.is_empty(), "estimates out of bounds:\n{}", broken.join("\n"));
}

/// Largest residual of any free node and coordinate of the first pose, from the graph alone, in solving units.
fn largest_residual(rung: &Rung, x: &[f64]) -> f64 {
    let given = rung.rig().given();
    let mut most = 0.0f64;
    for i in (0..rung.nodes()).filter(|&i| !given[i]) {
        for c in 3 * i..3 * i + 3 {
            let sum: f64 = rung.row(i).map(|(j, w)| w * (x[c] - x[3 * j + c % 3])).sum();
            most = most.max((rung.poses[0].rhs[c] - sum).abs());
        }
    }
    most
}

/// The rung's handles and one more: a free node in the middle and all its neighbours.
fn with_another_handle(rung: &Rung) -> HandleSystem {
    let (body, given) = (rung.body(), rung.rig().given());
    let middle = rung
        .rest
        .iter()
        .enumerate()
        .filter(|(i, _)| !given[*i])
        .min_by(|(_, a), (_, b)| {
            let size = |p: &[f64; 3]| DVec3::from_array(*p).length_squared();
            size(a).total_cmp(&size(b))
        });
    let middle = middle.unwrap().0;
    let mut nodes: Vec<u32> = rung.row(middle).map(|(j, _)| j as u32).collect();
    nodes.push(middle as u32);
    nodes.retain(|n| !given[*n as usize]);
    nodes.sort_unstable();
    let mut holds = rung.rig().setup().handles.clone();
    holds.push(HandleConstraint {
        nodes,
        position: true,
        rotation: true,
        scale: true,
        ..HandleConstraint::default()
    });
    let rigging = HandleSetup {
        handles: holds,
        ..rung.rig().setup().clone()
    };
    HandleSystem::build(body, rigging, &Exec::new(&Pool::new(2).unwrap(), &Silent)).unwrap()
}

#[test]
fn fields_are_shares_that_follow_their_equations() {
    for rung in all() {
        let another = with_another_handle(rung);
        for rig in [rung.rig(), &another] {
            let fields: Vec<&[f32]> = (0..=rig.handle_count()).map(|k| rig.rotation_fields().of(k)).collect();
            let fields: Vec<&[f32]> = fields.into_iter().filter(|f| !f.is_empty()).collect();
            assert_eq!(
                fields.len(),
                rig.handle_count(),
                "{}: every handle has a field",
                rung.name
            );
            let exact = exact_fields(rung, rig);
            let mut farthest = 0.0f64;
            for i in 0..rung.nodes() {
                assert!(
                    fields.iter().all(|f| (0.0..=1.0).contains(&f[i])),
                    "{} node {i}",
                    rung.name
                );
                let sum: f64 = fields.iter().map(|f| f64::from(f[i])).sum();
                assert!((sum - 1.0).abs() <= 1e-6, "{} node {i}: fields sum to {sum}", rung.name);
                for (k, field) in fields.iter().enumerate() {
                    farthest = farthest.max((f64::from(field[i]) - exact[i * fields.len() + k]).abs());
                }
            }
            println!(
                "{}, {} handles: fields are {farthest:.1e} off",
                rung.name,
                rig.handle_count()
            );
            assert!(farthest < 1e-3, "{}: fields are {farthest:e} off", rung.name);
        }
    }
}

/// All fields of a rig's hard handles, each solved for, to the last digits.
fn exact_fields(rung: &Rung, rig: &HandleSystem) -> Vec<f64> {
    let (columns, mut x) = field_columns(rung, rig);
    solve_fields(rung, rig, columns, &mut x, InitialGuess::Zero, 1e-10);
    x
}

/// Fields with 1 on their handles and 0 elsewhere.
fn field_columns(rung: &Rung, rig: &HandleSystem) -> (usize, Vec<f64>) {
    let columns = rig.handle_count();
    let mut x = vec![0.0; rung.nodes() * columns];
    for (k, hold) in rig.setup().handles.iter().enumerate() {
        hold.nodes.iter().for_each(|&n| x[n as usize * columns + k] = 1.0);
    }
    (columns, x)
}

fn solve_fields(
    rung: &Rung,
    rig: &HandleSystem,
    columns: usize,
    x: &mut [f64],
    start: InitialGuess<'_>,
    tolerance: f64,
) -> SolveStats {
    let pool = Pool::new(2).unwrap();
    let hierarchy = &rung.body().hierarchy;
    let constraints = Constraints {
        fixed: rig.given(),
        stiffness: None,
    };
    let system = hierarchy.constrain(&constraints, &pool).unwrap();
    let options = SolveOptions {
        start,
        tolerance: Some(tolerance),
        ..Default::default()
    };
    let (rhs, mut workspace) = (vec![0.0; x.len()], Workspace::default());
    let mut watch = |_: &IterationReport<'_>| SolveControl::Continue;
    let stats = system
        .equations(hierarchy, columns, &rhs)
        .solve(x, &options, &mut workspace, &Exec::new(&pool, &Silent), &mut watch)
        .unwrap();
    assert!(stats.converged, "{}: {stats:?}", rung.name);
    stats
}

#[test]
fn fields_that_start_from_those_before_come_out_the_same() {
    for rung in all() {
        let another = with_another_handle(rung);
        let (columns, mut fresh) = field_columns(rung, &another);
        let coarse = InitialGuess::FullMultigrid {
            frames: None,
            rest: None,
        };
        solve_fields(rung, &another, columns, &mut fresh, coarse, 1e-7);
        // Those before, where no handle holds; nothing yet for the new handle.
        let (_, mut again) = field_columns(rung, &another);
        for i in (0..rung.nodes()).filter(|&i| !another.given()[i]) {
            for k in 0..rung.rig().handle_count() {
                again[i * columns + k] = f64::from(rung.rig().rotation_fields().of(k)[i]);
            }
        }
        solve_fields(rung, &another, columns, &mut again, InitialGuess::Given, 1e-7);
        let most = fresh.iter().zip(&again).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{}: restarted fields differ by {most:.1e}", rung.name);
        assert!(most < 1e-4, "{}: restarted fields differ by {most:e}", rung.name);
    }
}
