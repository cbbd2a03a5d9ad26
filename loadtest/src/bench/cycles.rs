//! `loadtest solver --operators paper`: iteration by iteration, what the paper's own operators leave, beside the default.

use super::companion::Companion;
use super::figures::Figures;
use super::solver::{EXACT, Ready, Terms, failed, farthest, to_residual};
use crate::Failure;
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::solver::{BuildOptions, Constraints, Control, Hierarchy, Operators, SolveOptions, Start, Workspace};

/// Iterations that are shown: the paper's cycles give up soon after.
const SHOWN: usize = 12;

/// Operators and conjugate-gradient steps after each cycle, by the prefix of their keys.
const RUNS: [(&str, Operators, Option<usize>); 3] = [
    ("default", Operators::FiniteVolume, None),
    ("paper", Operators::Paper, Some(0)),
    ("paper_cg", Operators::Paper, Some(2)),
];

/// Residual, largest column, and largest missing displacement over the diagonal; from the full-multigrid start on.
#[derive(Debug, Clone, Default)]
struct Log {
    residuals: Vec<f64>,
    errors: Vec<f64>,
}

/// Measures the first pose with each of [`RUNS`].
pub(super) fn measure(all: &Companion, terms: &Terms, figures: &mut Figures) -> Result<(), Failure> {
    figures.set("nodes", all.rest.len());
    let pose = &all.poses[0];
    let mut exact = pose.given.clone();
    for (name, operators, interleave) in RUNS {
        let ready = set_up(all, operators, interleave, terms)?;
        let mut workspace = Workspace::default();
        if operators == Operators::FiniteVolume {
            let stats = ready.solve(&pose.rhs, &mut exact, &to_residual(EXACT), &mut workspace, terms, None)?;
            figures.measured("exact_res", stats.residual);
        }
        let log = log(all, &ready, &exact, &mut workspace, terms)?;
        figures.set(&format!("{name}_residuals"), log.residuals);
        figures.set(&format!("{name}_errors"), log.errors);
    }
    Ok(())
}

fn set_up(all: &Companion, operators: Operators, interleave: Option<usize>, terms: &Terms) -> Result<Ready, Failure> {
    let options = BuildOptions {
        operators,
        interleave,
        ..Default::default()
    };
    let constraints = Constraints {
        fixed: &all.fixed,
        stiffness: all.stiffness.as_deref(),
    };
    let hierarchy = Hierarchy::build(&all.graph(), &options, &Exec::new(&terms.pool, &Silent)).map_err(failed)?;
    let system = hierarchy.constrain(&constraints, &terms.pool).map_err(failed)?;
    Ok(Ready { hierarchy, system })
}

/// Full multigrid alone, then again with [`SHOWN`] iterations after it.
fn log(
    all: &Companion,
    ready: &Ready,
    exact: &[[f64; 3]],
    workspace: &mut Workspace,
    terms: &Terms,
) -> Result<Log, Failure> {
    let pose = &all.poses[0];
    let options = |most: usize| SolveOptions {
        start: Start::FullMultigrid {
            frames: Some(&all.frames),
            rest: Some(&all.rest),
        },
        max_iterations: most,
        ..to_residual(EXACT)
    };
    let mut x = pose.given.clone();
    let start = ready.solve(&pose.rhs, &mut x, &options(0), workspace, terms, None)?;
    let mut log = Log {
        residuals: vec![start.residual],
        errors: vec![farthest(&x, exact) / all.diagonal],
    };
    let mut now = pose.given.clone();
    let mut watch = |iteration: &pliant::solver::Iteration<'_>| {
        iteration.copy_to(now.as_flattened_mut());
        log.residuals.push(iteration.residual);
        log.errors.push(farthest(&now, exact) / all.diagonal);
        Control::Continue
    };
    let mut x = pose.given.clone();
    ready
        .system
        .solve(
            &ready.hierarchy,
            3,
            pose.rhs.as_flattened(),
            x.as_flattened_mut(),
            &options(SHOWN),
            workspace,
            &Exec::new(&terms.pool, &Silent),
            &mut watch,
        )
        .map_err(failed)?;
    // Conjugate gradients would count differently.
    log.residuals.truncate(1 + SHOWN);
    log.errors.truncate(1 + SHOWN);
    Ok(log)
}

/// A row for each iteration: residual and error of every run.
pub(super) fn table(figures: &Figures) -> String {
    let column = |name: &str, what: &str| figures.list(&format!("{name}_{what}"));
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
    use super::super::export::tests::creature;
    use super::*;
    use pliant::pool::Pool;

    #[test]
    fn the_default_gets_further_than_the_papers_cycles() {
        let terms = Terms {
            pool: Pool::new(1).unwrap(),
            repeat: 1,
            fast: false,
        };
        let (_, all) = creature(&terms.pool);
        let mut figures = Figures::default();
        measure(&all, &terms, &mut figures).unwrap();
        let after = |name: &str, k: usize| figures.list(&format!("{name}_errors"))[k];
        assert!(after("default", 4) < 1e-3 && after("paper", 4) > 10.0 * after("default", 4));
        assert!(after("paper", 12) < after("paper", 0));
        assert_eq!(table(&figures).lines().count(), 2 + SHOWN);
    }
}
