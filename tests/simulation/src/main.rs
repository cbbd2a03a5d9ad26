//! Runs seeds.

use clap::Parser;
use simulation::{OldBug, run};
use std::process::ExitCode;

/// Runs sessions, stores and nodes under seeds and prints what must not be. Exits with 1 if anything was found.
#[derive(Debug, Parser)]
struct Arguments {
    /// First seed
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Number of seeds
    #[arg(long, default_value_t = 100)]
    seeds: u64,
    /// Put an old bug of the store back
    #[arg(long)]
    bug: Option<OldBug>,
    /// Run each seed twice and compare the traces
    #[arg(long)]
    twice: bool,
    /// Print the trace of each seed
    #[arg(long)]
    trace: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let (mut found, mut operations, mut faults, mut milliseconds) = (0u64, 0u64, 0u64, 0u64);
    for seed in arguments.first..arguments.first.saturating_add(arguments.seeds) {
        let outcome = run(seed, arguments.bug);
        if arguments.trace {
            print!("{}", outcome.trace);
        }
        if arguments.twice {
            let again = run(seed, arguments.bug);
            if again != outcome {
                let lines = outcome.trace.lines().zip(again.trace.lines());
                let first = lines.into_iter().find(|(a, b)| a != b);
                println!("seed {seed}: two runs differ, first at {first:?}");
                found += 1;
            }
        }
        for violation in &outcome.violations {
            println!("seed {seed}: {violation}");
        }
        found += u64::from(!outcome.violations.is_empty());
        operations += outcome.operations;
        faults += outcome.faults;
        milliseconds += outcome.milliseconds;
    }
    println!(
        "{} seeds, {operations} calls answered, {faults} faults, {:.1} simulated hours: {found} seeds found something",
        arguments.seeds,
        milliseconds as f64 / 3.6e6
    );
    ExitCode::from(u8::from(found > 0))
}
