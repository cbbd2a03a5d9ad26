//! `loadtest solver`: solves an exported system and says what it took, in the peers' words.

use super::clock::Times;
use super::companion::Companion;
use super::figures::Figures;
use super::problem::Problem;
use super::{clock, cycles, free, memory, whole};
use crate::Failure;
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::solver::{Control, Hierarchy, SolveOptions, Stats, System, Workspace};
use std::path::PathBuf;

/// Most iterations of a solve that must reach the limits of double precision.
const MOST_ITERATIONS: usize = 1000;

/// Relative residual of a solution that errors are measured from.
pub(super) const EXACT: f64 = 1e-11;

/// Arguments of `loadtest solver`.
#[derive(Debug, clap::Args)]
pub(crate) struct SolverArgs {
    /// The problem file; a companion of the same name with the extension aux is used when it is there
    problem: PathBuf,
    /// Threads that the solver may use; 0 means one for each core
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// Most runs of everything that is timed; no further one begins after 4 s
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Leave out the solutions to the last digit, and with them all errors
    #[arg(long)]
    fast: bool,
    /// Instead of all else: residual and error of every iteration after full multigrid, with these operators and with
    /// the default ones; needs the companion
    #[arg(long, value_parser = ["paper"])]
    operators: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// How things are measured.
pub(super) struct Terms {
    /// Where the solver runs.
    pub pool: Pool,
    /// Most runs of what is timed.
    pub repeat: u32,
    /// Without solutions to the last digit.
    pub fast: bool,
}

/// A system ready to solve, with what solves share.
pub(super) struct Ready {
    pub hierarchy: Hierarchy,
    pub system: System,
}

impl Ready {
    /// Solves for three columns.
    pub fn solve(
        &self,
        rhs: &[[f64; 3]],
        x: &mut [[f64; 3]],
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        terms: &Terms,
        residuals: Option<&mut Vec<f64>>,
    ) -> Result<Stats, Failure> {
        let mut log = residuals;
        let (rhs, x) = (rhs.as_flattened(), x.as_flattened_mut());
        self.system
            .solve(
                &self.hierarchy,
                3,
                rhs,
                x,
                options,
                workspace,
                &Exec::new(&terms.pool, &Silent),
                &mut |iteration| {
                    if let Some(log) = log.as_deref_mut() {
                        log.push(iteration.residual);
                    }
                    Control::Continue
                },
            )
            .map_err(failed)
    }
}

impl Ready {
    /// Solves several times, each from what `start` makes, and tells the last result and what one solve took.
    pub fn race(
        &self,
        rhs: &[[f64; 3]],
        start: impl FnMut() -> Vec<[f64; 3]>,
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        terms: &Terms,
    ) -> Result<(Vec<[f64; 3]>, Stats, Times), Failure> {
        let solve = |mut x: Vec<[f64; 3]>| -> Result<_, Failure> {
            let stats = self.solve(rhs, &mut x, options, workspace, terms, None)?;
            Ok((x, stats))
        };
        let ((x, stats), times) = clock::best_of(terms.repeat, start, solve)?;
        Ok((x, stats, times))
    }
}

/// What the solver said when it could not.
pub(super) fn failed(e: pliant::solver::Error) -> Failure {
    Failure::Server(format!("the solver failed: {e}"))
}

/// Options of a solve to a relative residual.
pub(super) fn to_residual(tolerance: f64) -> SolveOptions<'static> {
    SolveOptions {
        tolerance: Some(tolerance),
        max_iterations: MOST_ITERATIONS,
        ..Default::default()
    }
}

/// The largest distance between rows.
pub(super) fn farthest(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let apart = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (a[c] - b[c]) * (a[c] - b[c])).sum::<f64>();
    a.iter().zip(b).map(apart).fold(0.0, f64::max).sqrt()
}

/// Runs the command.
pub(crate) fn run(args: &SolverArgs) -> Result<(), Failure> {
    let problem = Problem::read(&args.problem)?;
    let pool = Pool::new(usize::from(args.threads)).map_err(|e| Failure::Server(e.to_string()))?;
    let mut figures = Figures::default();
    let name = args.problem.file_stem().unwrap_or_default().to_string_lossy();
    figures.set("solver", "pliant");
    figures.set("version", env!("CARGO_PKG_VERSION"));
    figures.set("config", "defaults");
    figures.set("problem", name.as_ref());
    figures.set("n", problem.matrix.rows());
    figures.set("nnz", problem.matrix.entries());
    figures.set("threads", pool.threads());
    figures.measured("wu_s", clock::work_unit(&problem.matrix));
    if args.operators.is_some() {
        let terms = Terms {
            pool,
            repeat: 1,
            fast: false,
        };
        let companion = Companion::read(&Companion::path_beside(&args.problem))?;
        cycles::measure(&companion, &terms, &mut figures)?;
        match args.json {
            true => println!("{}", figures.json()),
            false => print!("{}", cycles::table(&figures)),
        }
        return Ok(());
    }
    let base = memory::resident();
    figures.megabytes("rss_base_MB", base as f64);
    memory::reset_peak();

    let terms = Terms {
        pool,
        repeat: args.repeat,
        fast: args.fast,
    };
    // Read after the peak of the free system was taken, so that it does not count.
    let beside = Companion::path_beside(&args.problem);
    let ok = free::measure(&problem, base, &terms, &mut figures)?;
    if beside.is_file() {
        let companion = Companion::read(&beside)?;
        let given = companion.fixed.iter().filter(|f| **f).count();
        if companion.rest.len() - given != problem.matrix.rows() {
            let text = format!("{} does not belong to {}", beside.display(), args.problem.display());
            return Err(Failure::Usage(format!("{text}; export the system again")));
        }
        drop(problem);
        whole::measure(&companion, &terms, &mut figures)?;
    }
    if args.json {
        println!("{}", figures.json());
    } else {
        print!("{}", figures.table(&LINES));
    }
    match ok {
        true => Ok(()),
        false => Err(Failure::Server("a residual, recomputed, is above its tolerance".into())),
    }
}

/// The table: key and meaning.
const LINES: [(&str, &str); 40] = [
    ("problem", ""),
    ("status", "whether the recomputed residuals hold"),
    ("n", "unknowns"),
    ("nnz", "entries of the matrix"),
    ("threads", "threads of the solver"),
    ("levels", "levels of the hierarchy"),
    ("complexity", "edges of all levels over those of the finest"),
    ("wu_s", "one work unit: matrix times 3 columns, f64, one thread"),
    ("setup_s", "hierarchy and constraints of the free system"),
    ("setup_wu", "in work units"),
    ("solve3_s", "from zero to 1e-3"),
    ("solve3_wu", "in work units"),
    ("it3", "iterations"),
    ("res3", "relative residual, largest column, recomputed"),
    ("err3", "largest missing displacement, fraction of the diagonal"),
    ("solve5_s", "from zero to 1e-5"),
    ("solve5_wu", "in work units"),
    ("it5", "iterations"),
    ("res5", "relative residual, largest column, recomputed"),
    ("err5", "largest missing displacement, fraction of the diagonal"),
    (
        "iter_wu",
        "work units of one iteration: (solve5 - solve3) / (it5 - it3)",
    ),
    ("factor", "residual over the one before, geometric mean down to 1e-8"),
    ("mem_MB", "hierarchy and system"),
    ("mem_ratio", "over the matrix in f64 rows (12 nnz + 8 (n + 1) bytes)"),
    ("mem_all_ratio", "with the vectors of a solve"),
    (
        "peak_over_base_MB",
        "resident peak of set-up and solves over the loaded problem",
    ),
    ("nodes", "all nodes, given ones too"),
    ("setup_all_s", "hierarchy and constraints on all nodes, as sessions do"),
    ("handle_s", "another set of given nodes: until ready"),
    ("fmg3_s", "from full multigrid to 1e-3"),
    ("fmg_it3", "iterations"),
    ("fmg_err3", "largest missing displacement, fraction of the diagonal"),
    (
        "drag_s",
        "1 % handle step from the solution before, to 1e-3 of the diagonal",
    ),
    ("drag_wu", "in work units"),
    ("drag_it", "iterations"),
    (
        "drag_estimate",
        "what the solver thinks is missing, fraction of the diagonal",
    ),
    ("drag_err", "what is missing, fraction of the diagonal"),
    ("exact_res", "residual of the solution that errors are measured from"),
    ("method", "the algorithm"),
    ("digest", "SHA-256 of the solution to 1e-5"),
];

#[cfg(test)]
mod tests {
    use super::super::problem::tests::chain;
    use super::*;

    #[test]
    fn every_figure_of_the_free_system_is_there_and_true() {
        let terms = Terms {
            pool: Pool::new(1).unwrap(),
            repeat: 2,
            fast: false,
        };
        let problem = chain(500);
        let mut figures = Figures::default();
        figures.measured("wu_s", 1e-6);
        assert!(free::measure(&problem, 0, &terms, &mut figures).unwrap());
        let number = |key: &str| {
            figures
                .number(key)
                .unwrap_or_else(|| panic!("{key}: {}", figures.json()))
        };
        for key in [
            "setup_s",
            "solve3_s",
            "solve5_s",
            "mem_MB",
            "mem_ratio",
            "setup_wu",
            "solve5_wu",
        ] {
            assert!(number(key) > 0.0, "{key}");
        }
        assert!(number("res3") <= 1e-3 && number("res5") <= 1e-5);
        assert!(number("err5") < 1e-2 && number("exact_res") < 1e-9);
        assert!(figures.json().contains(r#""status":"ok""#));
    }
}
