//! The system over all nodes, as sessions use it: set-up, a change of handles, full multigrid, a drag.

use super::companion::{CompanionFile, PoseSystem};
use super::ready::{BenchTerms, EXACT_RESIDUAL, ReadySystem, largest_distance, options_to_residual, solver_failure};
use crate::failure::LoadtestFailure;
use crate::measurements::{Measurements, time_best_of};
use glam::{DAffine3, DVec3};
use pliant::deform::{HandleMotion, carry, fit_rigid_motion};
use pliant::solver::{BuildOptions, CoarseOperators, Constraints, InitialGuess, IterationReport, SolveOptions};

/// Largest missing displacement that a drag's frame may have, fraction of the diagonal.
const DRAG_ERROR: f64 = 1e-3;
/// Residual that stands in for an exact solution when there is no time for one.
const NEARLY: f64 = 1e-6;

/// Measures everything that needs the given nodes, the frames or the second pose.
pub(super) fn measure_full_system(
    all: &CompanionFile,
    terms: &BenchTerms,
    measurements: &mut Measurements,
) -> Result<(), LoadtestFailure> {
    measurements.set_value("nodes", all.rest.len());
    let constraints = Constraints {
        fixed: &all.fixed,
        stiffness: all.stiffness.as_deref(),
    };
    let set_up = |()| ReadySystem::build(&all.graph(), &BuildOptions::default(), &constraints, terms);
    let (mut ready, times) = time_best_of(terms.repeat, || (), set_up)?;
    measurements.set_number("setup_all_s", times.best);

    let grown = grow_given_nodes(all);
    let other = Constraints {
        fixed: &grown,
        ..constraints
    };
    let change = |()| ready.hierarchy.constrain(&other, &terms.pool);
    let (_, times) = time_best_of(terms.repeat.saturating_mul(3), || (), change).map_err(solver_failure)?;
    measurements.set_number("handle_s", times.best);

    let first = time_full_multigrid(all, &mut ready, measurements)?;
    let second = time_drag(all, &mut ready, &first, measurements)?;
    if !terms.fast {
        let (exact, _) = solve_on(&mut ready, &all.poses[1], &second, EXACT_RESIDUAL)?;
        measurements.set_number("drag_err", largest_distance(&second, &exact) / all.diagonal);
    }
    Ok(())
}

/// Adds all neighbours to the given nodes: another set of handles that is as large and lies as near.
fn grow_given_nodes(all: &CompanionFile) -> Vec<bool> {
    let mut grown = all.fixed.clone();
    for i in (0..grown.len()).filter(|i| all.fixed[*i]) {
        let row = all.offsets[i] as usize..all.offsets[i + 1] as usize;
        all.neighbours[row].iter().for_each(|&j| grown[j as usize] = true);
    }
    grown
}

/// Times full multigrid to 1e-3; the solution that comes back is the exact one of the first pose, or nearly.
fn time_full_multigrid(
    all: &CompanionFile,
    ready: &mut ReadySystem<'_>,
    measurements: &mut Measurements,
) -> Result<Vec<[f64; 3]>, LoadtestFailure> {
    let pose = &all.poses[0];
    let options = SolveOptions {
        start: InitialGuess::FullMultigrid {
            frames: Some(&all.frames),
            rest: Some(&all.rest),
        },
        ..options_to_residual(1e-3)
    };
    let prepare = || pose.given.clone();
    let (x, stats, times) = ready.solve_and_time(&pose.rhs, prepare, &options)?;
    measurements.set_number("fmg3_s", times.best);
    measurements.set_value("fmg_it3", stats.iterations);
    let tolerance = if ready.terms.fast { NEARLY } else { EXACT_RESIDUAL };
    let (exact, _) = solve_on(ready, pose, &x, tolerance)?;
    if !ready.terms.fast {
        measurements.set_number("fmg_err3", largest_distance(&x, &exact) / all.diagonal);
    }
    Ok(exact)
}

/// Times the second pose from the first one's solution, and returns what it came to.
fn time_drag(
    all: &CompanionFile,
    ready: &mut ReadySystem<'_>,
    from: &[[f64; 3]],
    measurements: &mut Measurements,
) -> Result<Vec<[f64; 3]>, LoadtestFailure> {
    let pose = &all.poses[1];
    let options = SolveOptions {
        start: InitialGuess::Given,
        tolerance: None,
        max_error: Some(DRAG_ERROR * all.diagonal),
        ..Default::default()
    };
    // Sessions have the fields before the first drag; carrying the last frame along is part of every frame.
    let (field, map) = follow_field(all, ready)?;
    let start = |mut x: Vec<[f64; 3]>| {
        let motion = HandleMotion { field: &field, map };
        carry(x.as_flattened_mut(), &[motion], &ready.terms.pool);
        Ok::<_, LoadtestFailure>(x)
    };
    let (carried, carrying) = time_best_of(ready.terms.repeat, || from.to_vec(), start)?;
    let prepare = || place_given_nodes(all, pose, &carried);
    let (x, stats, times) = ready.solve_and_time(&pose.rhs, prepare, &options)?;
    let seconds = carrying.best + times.best;
    measurements.set_number("drag_s", seconds);
    measurements.set_value("drag_it", stats.iterations);
    measurements.set_number("drag_wu", seconds / measurements.number("wu_s").unwrap_or(f64::NAN));
    measurements.set_number("drag_estimate", stats.max_error / all.diagonal);
    Ok(x)
}

/// Computes how the given nodes moved that the two poses hold in different places, and how much every node follows them.
fn follow_field(all: &CompanionFile, ready: &mut ReadySystem<'_>) -> Result<(Vec<f32>, DAffine3), LoadtestFailure> {
    let (from, to) = (&all.poses[0].given, &all.poses[1].given);
    let moved = |i: usize| all.fixed[i] && from[i] != to[i];
    let mut field: Vec<f64> = (0..all.fixed.len()).map(|i| f64::from(u8::from(moved(i)))).collect();
    let rhs = vec![0.0; field.len()];
    ready.solve_columns(1, &rhs, &mut field, &options_to_residual(1e-5), &mut |_| {})?;
    let at = |given: &[[f64; 3]]| -> Vec<DVec3> {
        let moved = (0..given.len()).filter(|&i| moved(i));
        moved.map(|i| DVec3::from_array(given[i])).collect()
    };
    let fit = fit_rigid_motion(&at(from), &at(to));
    let linear = fit.linear();
    let shift = fit.pivot + fit.translation - linear * fit.pivot;
    let field = field.into_iter().map(|u| u as f32).collect();
    Ok((field, DAffine3::from_mat3_translation(linear, shift)))
}

/// Puts the given nodes of a solution where `pose` has them.
fn place_given_nodes(all: &CompanionFile, pose: &PoseSystem, x: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let rows = x.iter().zip(&pose.given).zip(&all.fixed);
    rows.map(|((x, given), fixed)| if *fixed { *given } else { *x })
        .collect()
}

/// Solves from `x` on; returns the solution and its residual.
fn solve_on(
    ready: &mut ReadySystem<'_>,
    pose: &PoseSystem,
    x: &[[f64; 3]],
    tolerance: f64,
) -> Result<(Vec<[f64; 3]>, f64), LoadtestFailure> {
    let options = SolveOptions {
        start: InitialGuess::Given,
        ..options_to_residual(tolerance)
    };
    let mut x = x.to_vec();
    let stats = ready.solve(&pose.rhs, &mut x, &options)?;
    Ok((x, stats.residual))
}

/// Iterations that are shown: the paper's cycles give up soon after.
const SHOWN: usize = 12;

/// Operators and conjugate-gradient steps after each cycle, by the prefix of their keys.
const RUNS: [(&str, CoarseOperators, Option<usize>); 3] = [
    ("default", CoarseOperators::FiniteVolume, None),
    ("paper", CoarseOperators::Paper, Some(0)),
    ("paper_cg", CoarseOperators::Paper, Some(2)),
];

/// A cycle log holds the residual, largest column, and the largest missing displacement over the diagonal; from the full-multigrid start on.
#[derive(Debug, Clone, Default)]
struct CycleLog {
    residuals: Vec<f64>,
    errors: Vec<f64>,
}

/// Measures the first pose with each of [`RUNS`].
pub(super) fn measure_paper_cycles(
    all: &CompanionFile,
    terms: &BenchTerms,
    measurements: &mut Measurements,
) -> Result<(), LoadtestFailure> {
    measurements.set_value("nodes", all.rest.len());
    let pose = &all.poses[0];
    let mut exact = pose.given.clone();
    for (name, operators, interleave) in RUNS {
        let options = BuildOptions {
            operators,
            interleave,
            ..Default::default()
        };
        let constraints = Constraints {
            fixed: &all.fixed,
            stiffness: all.stiffness.as_deref(),
        };
        let mut ready = ReadySystem::build(&all.graph(), &options, &constraints, terms)?;
        if operators == CoarseOperators::FiniteVolume {
            let stats = ready.solve(&pose.rhs, &mut exact, &options_to_residual(EXACT_RESIDUAL))?;
            measurements.set_number("exact_res", stats.residual);
        }
        let log = log_cycles(all, &mut ready, &exact)?;
        measurements.set_value(&format!("{name}_residuals"), log.residuals);
        measurements.set_value(&format!("{name}_errors"), log.errors);
    }
    Ok(())
}

/// Runs full multigrid alone, then again with [`SHOWN`] iterations after it.
fn log_cycles(
    all: &CompanionFile,
    ready: &mut ReadySystem<'_>,
    exact: &[[f64; 3]],
) -> Result<CycleLog, LoadtestFailure> {
    let pose = &all.poses[0];
    let options = |most: usize| SolveOptions {
        start: InitialGuess::FullMultigrid {
            frames: Some(&all.frames),
            rest: Some(&all.rest),
        },
        max_iterations: most,
        ..options_to_residual(EXACT_RESIDUAL)
    };
    let mut x = pose.given.clone();
    let start = ready.solve(&pose.rhs, &mut x, &options(0))?;
    let mut log = CycleLog {
        residuals: vec![start.residual],
        errors: vec![largest_distance(&x, exact) / all.diagonal],
    };
    let mut now = pose.given.clone();
    let mut watch = |iteration: &IterationReport<'_>| {
        iteration.copy_to(now.as_flattened_mut());
        log.residuals.push(iteration.residual);
        log.errors.push(largest_distance(&now, exact) / all.diagonal);
    };
    let mut x = pose.given.clone();
    let (rhs, x) = (pose.rhs.as_flattened(), x.as_flattened_mut());
    ready.solve_columns(3, rhs, x, &options(SHOWN), &mut watch)?;
    // Conjugate gradients would count differently.
    log.residuals.truncate(1 + SHOWN);
    log.errors.truncate(1 + SHOWN);
    Ok(log)
}

/// Writes a row for each iteration: residual and error of every run.
pub(super) fn cycle_table(measurements: &Measurements) -> String {
    let column = |name: &str, what: &str| measurements.list(&format!("{name}_{what}"));
    let columns: Vec<Vec<f64>> = RUNS
        .iter()
        .flat_map(|(name, ..)| [column(name, "residuals"), column(name, "errors")])
        .collect();
    let mut text = format!("{:<9}", "iteration");
    for (name, ..) in RUNS {
        text += &format!("  {:>12} {:>9}", format!("{name} residual"), "error");
    }
    text.push('\n');
    for row in 0..=SHOWN {
        text += &format!("{row:<9}");
        for (k, column) in columns.iter().enumerate() {
            let cell = column.get(row).map_or(String::new(), |v| format!("{v:.2e}"));
            text += &match k % 2 {
                0 => format!("  {cell:>17}"),
                _ => format!(" {cell:>9}"),
            };
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::export::tests::creature_systems;
    use super::*;
    use pliant::pool::Pool;

    #[test]
    fn a_drag_keeps_its_promise_and_other_handles_are_other_handles() {
        let terms = BenchTerms {
            pool: Pool::new(1).unwrap(),
            repeat: 2,
            fast: false,
        };
        let (_, all) = creature_systems(&terms.pool);
        let mut measurements = Measurements::default();
        measurements.set_number("wu_s", 1e-6);
        measure_full_system(&all, &terms, &mut measurements).unwrap();
        let number = |key: &str| {
            measurements
                .number(key)
                .unwrap_or_else(|| panic!("{key}: {}", measurements.to_json()))
        };
        for key in ["setup_all_s", "handle_s", "fmg3_s", "drag_s", "drag_wu"] {
            assert!(number(key) > 0.0, "{key}");
        }
        assert!(number("drag_it") >= 1.0 && number("drag_err") <= DRAG_ERROR);
        assert!(number("fmg_err3") < 1e-2);
        let grown = grow_given_nodes(&all);
        assert!(grown.iter().zip(&all.fixed).all(|(more, less)| more >= less));
        assert!(grown != all.fixed && grown.contains(&false));
    }

    #[test]
    fn the_default_gets_further_than_the_papers_cycles() {
        let terms = BenchTerms {
            pool: Pool::new(1).unwrap(),
            repeat: 1,
            fast: false,
        };
        let (_, all) = creature_systems(&terms.pool);
        let mut measurements = Measurements::default();
        measure_paper_cycles(&all, &terms, &mut measurements).unwrap();
        let after = |name: &str, k: usize| measurements.list(&format!("{name}_errors"))[k];
        assert!(after("default", 4) < 1e-3 && after("paper", 4) > 10.0 * after("default", 4));
        assert!(after("paper", 12) < after("paper", 0));
        assert_eq!(cycle_table(&measurements).lines().count(), 2 + SHOWN);
    }
}
