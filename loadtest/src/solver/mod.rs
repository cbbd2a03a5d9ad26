//! The solver alone: systems in the peers' file format, and what the solver takes for them.
//!
//! What is measured is reached through public functions of the library only.

mod companion;
pub(crate) mod export;
mod free_system;
mod full_system;
mod problem;
mod ready;

use crate::failure::LoadtestFailure;
use crate::measurements::Measurements;
use companion::CompanionFile;
use pliant::pool::Pool;
use problem::LinearProblem;
use ready::{BenchTerms, measure_work_unit};
use std::path::PathBuf;

/// Arguments of `loadtest solver`.
#[derive(Debug, clap::Args)]
pub(crate) struct SolverArgs {
    /// Problem file; loadtest also reads a companion with the extension aux if it exists
    problem: PathBuf,
    /// Threads of the solver; 0 means one per core
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// Maximum runs of everything that is timed; none begins after 4 s
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Skip the exact solutions, and with them all errors
    #[arg(long)]
    fast: bool,
    /// Report only the residual and error of every iteration after full multigrid, with these operators and with the
    /// default ones; needs the companion
    #[arg(long, value_parser = ["paper"])]
    operators: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

pub(crate) fn run_solver(args: &SolverArgs) -> Result<(), LoadtestFailure> {
    let problem = LinearProblem::read(&args.problem)?;
    let pool = Pool::new(usize::from(args.threads))?;
    let mut measurements = Measurements::default();
    let name = args.problem.file_stem().unwrap_or_default().to_string_lossy();
    measurements.set_value("solver", "pliant");
    measurements.set_value("version", env!("CARGO_PKG_VERSION"));
    measurements.set_value("config", "defaults");
    measurements.set_value("problem", name.as_ref());
    measurements.set_value("n", problem.matrix.rows());
    measurements.set_value("nnz", problem.matrix.entries());
    measurements.set_value("threads", pool.threads());
    measurements.set_number("wu_s", measure_work_unit(&problem.matrix));
    if args.operators.is_some() {
        let terms = BenchTerms {
            pool,
            repeat: 1,
            fast: false,
        };
        let companion = CompanionFile::read(&CompanionFile::path_beside(&args.problem))?;
        full_system::measure_paper_cycles(&companion, &terms, &mut measurements)?;
        match args.json {
            true => println!("{}", measurements.to_json()),
            false => print!("{}", full_system::cycle_table(&measurements)),
        }
        return Ok(());
    }
    let base = ready::resident_bytes();
    measurements.set_megabytes("rss_base_MB", base as f64);
    ready::reset_peak();

    let terms = BenchTerms {
        pool,
        repeat: args.repeat,
        fast: args.fast,
    };
    // Read after the peak of the free system was taken, so that it does not count.
    let beside = CompanionFile::path_beside(&args.problem);
    let ok = free_system::measure_free_system(&problem, base, &terms, &mut measurements)?;
    if beside.is_file() {
        let companion = CompanionFile::read(&beside)?;
        let given = companion.fixed.iter().filter(|f| **f).count();
        if companion.rest.len() - given != problem.matrix.rows() {
            let text = format!("{} does not belong to {}", beside.display(), args.problem.display());
            return Err(LoadtestFailure::Usage(format!("{text}; export the system again")));
        }
        drop(problem);
        full_system::measure_full_system(&companion, &terms, &mut measurements)?;
    }
    if args.json {
        println!("{}", measurements.to_json());
    } else {
        print!("{}", measurements.to_table(&LINES));
    }
    match ok {
        true => Ok(()),
        false => Err(LoadtestFailure::Server(
            "a residual, recomputed, is above its tolerance".into(),
        )),
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
    use super::problem::tests::chain_problem;
    use super::*;

    #[test]
    fn every_figure_of_the_free_system_is_there_and_true() {
        let terms = BenchTerms {
            pool: Pool::new(1).unwrap(),
            repeat: 2,
            fast: false,
        };
        let problem = chain_problem(500);
        let mut measurements = Measurements::default();
        measurements.set_number("wu_s", 1e-6);
        assert!(free_system::measure_free_system(&problem, 0, &terms, &mut measurements).unwrap());
        let number = |key: &str| {
            measurements
                .number(key)
                .unwrap_or_else(|| panic!("{key}: {}", measurements.to_json()))
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
        assert!(measurements.to_json().contains(r#""status":"ok""#));
    }
}
