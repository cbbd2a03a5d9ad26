//! `pliant store export`: a kept session's model, without a server.

use super::super::failure::CliFailure;
use super::super::input_files::output_format;
use super::super::output_files::OutputPermission;
use super::kept_place::{StorePlaceArgs, lookers, session_failure, store_failure};
use crate::asset::FileSet;
use clap::Args;
use std::path::PathBuf;
use std::sync::Arc;

/// Writes the model of a session in its current shape. Nothing of the session changes.
#[derive(Debug, Args)]
pub(super) struct StoreExportArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Session id
    session: String,
    /// Output file; its extension selects the format
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
}

/// Runs the command.
pub(super) async fn run_store_export(args: &StoreExportArgs) -> Result<(), CliFailure> {
    let format = output_format(&args.output)?;
    args.permission.check_target(&args.output)?;
    let store = Arc::new(args.place.look().await?);
    let sessions = store.all_sessions().await.map_err(store_failure)?;
    let found = sessions.iter().find(|s| s.id == args.session).ok_or_else(|| {
        CliFailure::Input(format!(
            "no session \"{}\" is kept; pliant store list names them",
            args.session
        ))
    })?;
    let manager = lookers(&store).await?;
    let exported = manager.export(&found.tenant, &found.id, Some(format)).await;
    let exported = exported.map_err(|e| session_failure(&e))?;
    let nothing = FileSet::default();
    let written = args
        .permission
        .write_model(&args.output, &exported.written, &args.output, &nothing)?;
    for path in written {
        println!("{}", path.display());
    }
    Ok(())
}
