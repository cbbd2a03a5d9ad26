//! `pliant store`: what operators do with kept sessions while no server holds them.

mod check;
mod export;
mod kept_place;
mod list;
mod prune;

use super::failure::CliFailure;
use clap::{Args, Subcommand};

/// Check, list, export and prune stored sessions.
///
/// Name their place as for `pliant serve`: by flags, the environment (PLIANT_DATA_DIR, …) or the configuration file.
#[derive(Debug, Args)]
pub struct StoreArgs {
    #[command(subcommand)]
    command: StoreCommand,
}

#[derive(Debug, Subcommand)]
enum StoreCommand {
    /// Compare everything stored with its checksums
    Check(check::StoreCheckArgs),
    /// List the sessions of all tenants
    List(list::StoreListArgs),
    /// Write the model of a session in its current shape
    Export(export::StoreExportArgs),
    /// Remove unused sessions and unreferenced objects
    Prune(prune::StorePruneArgs),
}

/// Runs the command.
pub(super) fn run_store(args: &StoreArgs) -> Result<(), CliFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let runtime = runtime.map_err(|e| CliFailure::Internal(format!("cannot start threads: {e}")))?;
    let done = runtime.block_on(async {
        match &args.command {
            StoreCommand::Check(args) => check::run_store_check(args).await,
            StoreCommand::List(args) => list::run_store_list(args).await,
            StoreCommand::Export(args) => export::run_store_export(args).await,
            StoreCommand::Prune(args) => prune::run_store_prune(args).await,
        }
    });
    runtime.shutdown_background();
    done
}
