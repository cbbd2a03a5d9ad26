//! `loadtest solver --operators paper`: iteration by iteration, what the paper's own operators leave, beside the default.

use super::companion::CompanionFile;
use super::ready::{BenchTerms, EXACT_RESIDUAL, ReadySystem, largest_distance, options_to_residual, solver_failure};
use crate::failure::LoadtestFailure;
use crate::shared::measurements::Measurements;
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::solver::{
    BuildOptions, CoarseOperators, Constraints, Hierarchy, InitialGuess, SolveControl, SolveOptions, Workspace,
};

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
        let ready = build_ready_system(all, operators, interleave, terms)?;
        let mut workspace = Workspace::default();
        if operators == CoarseOperators::FiniteVolume {
            let stats = ready.solve(
                &pose.rhs,
                &mut exact,
                &options_to_residual(EXACT_RESIDUAL),
                &mut workspace,
                terms,
            )?;
            measurements.set_number("exact_res", stats.residual);
        }
        let log = log_cycles(all, &ready, &exact, &mut workspace, terms)?;
        measurements.set_value(&format!("{name}_residuals"), log.residuals);
        measurements.set_value(&format!("{name}_errors"), log.errors);
    }
    Ok(())
}

fn build_ready_system(
    all: &CompanionFile,
    operators: CoarseOperators,
    interleave: Option<usize>,
    terms: &BenchTerms,
) -> Result<ReadySystem, LoadtestFailure> {
    let options = BuildOptions {
        operators,
        interleave,
        ..Default::default()
    };
    let constraints = Constraints {
        fixed: &all.fixed,
        stiffness: all.stiffness.as_deref(),
    };
    let hierarchy =
        Hierarchy::build(&all.graph(), &options, &Exec::new(&terms.pool, &Silent)).map_err(solver_failure)?;
    let system = hierarchy.constrain(&constraints, &terms.pool).map_err(solver_failure)?;
    Ok(ReadySystem { hierarchy, system })
}

/// Runs full multigrid alone, then again with [`SHOWN`] iterations after it.
fn log_cycles(
    all: &CompanionFile,
    ready: &ReadySystem,
    exact: &[[f64; 3]],
    workspace: &mut Workspace,
    terms: &BenchTerms,
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
    let start = ready.solve(&pose.rhs, &mut x, &options(0), workspace, terms)?;
    let mut log = CycleLog {
        residuals: vec![start.residual],
        errors: vec![largest_distance(&x, exact) / all.diagonal],
    };
    let mut now = pose.given.clone();
    let mut watch = |iteration: &pliant::solver::IterationReport<'_>| {
        iteration.copy_to(now.as_flattened_mut());
        log.residuals.push(iteration.residual);
        log.errors.push(largest_distance(&now, exact) / all.diagonal);
        SolveControl::Continue
    };
    let mut x = pose.given.clone();
    ready
        .system
        .equations(&ready.hierarchy, 3, pose.rhs.as_flattened())
        .solve(
            x.as_flattened_mut(),
            &options(SHOWN),
            workspace,
            &Exec::new(&terms.pool, &Silent),
            &mut watch,
        )
        .map_err(solver_failure)?;
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
