//! The arguments of `loadtest commits`.

use std::path::PathBuf;

/// Arguments of `loadtest commits`.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct CommitsArgs {
    /// Model file of every session [default: the built-in creature]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Commits of every client, and poses of one drag
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(10..=100_000))]
    pub commits: u32,
    /// Clients, each with a session of its own
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub clients: u32,
    /// Folder for SQLite and models [default: a temporary one]
    #[arg(long, value_name = "FOLDER")]
    pub data_dir: Option<PathBuf>,
    /// PostgreSQL database to measure too, postgres://USER:PASSWORD@HOST/DATABASE
    #[arg(long, value_name = "URL")]
    pub database: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    pub json: bool,
}
