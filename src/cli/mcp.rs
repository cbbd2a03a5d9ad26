//! `pliant mcp`: tools for an agent that starts this program.

use super::terminal::{CliFailure, StopSignals};
use crate::mcp::{AgentFolder, AgentTools};
use crate::server;
use crate::server::config::LogFormat;
use crate::session::{Manager, SessionConfig};
use clap::Args;
use std::path::PathBuf;

/// Speaks the Model Context Protocol over stdin and stdout, for agents that start programs: open, look, name regions in words, pose,
/// edit, undo and export. No port is opened. A running server speaks it at /mcp.
#[derive(Debug, Args)]
pub struct McpArgs {
    /// Folder that models are read from and written to; nothing outside of it is touched
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    root: PathBuf,
    /// Log lines to write on stderr, such as info or debug
    #[arg(long, value_name = "DIRECTIVES", default_value = "warn", env = "PLIANT_LOG")]
    log: String,
}

pub(super) fn run_mcp(args: &McpArgs) -> Result<(), CliFailure> {
    let folder = AgentFolder::new(&args.root).map_err(|e| CliFailure::Input(format!("--root: {e}")))?;
    server::use_one_heap();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .thread_name("pliant-mcp")
        .build();
    let runtime = runtime.map_err(|e| CliFailure::Internal(format!("cannot start threads: {e}")))?;
    let done = runtime.block_on(serve(args, folder));
    // A thread may still wait for a line of stdin.
    runtime.shutdown_background();
    done
}

async fn serve(args: &McpArgs, folder: AgentFolder) -> Result<(), CliFailure> {
    server::start_log(&args.log, LogFormat::Text, None).map_err(CliFailure::Input)?;
    let mut signals = StopSignals::new().map_err(|e| CliFailure::Internal(format!("cannot wait for signals: {e}")))?;
    let usual = SessionConfig::default();
    let config = SessionConfig {
        // The agent's person may take a while, and the sessions end with the process.
        default_ttl: usual.max_ttl,
        ..usual
    };
    let manager = Manager::new(config).map_err(|e| CliFailure::Internal(e.to_string()))?;
    tracing::info!("files are read from and written to {}", folder.path().display());
    let tools = AgentTools::with_folder(manager, folder);
    let stop = async move {
        signals.next().await;
    };
    tools.serve_stdio(stop).await.map_err(CliFailure::Internal)
}
