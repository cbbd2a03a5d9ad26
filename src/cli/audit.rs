//! `pliant audit`: prints the audit trail in a server's store.

use super::terminal::{CliFailure, block_on, printed};
use crate::server::config::{ConfigKeys, KeyValue, stored_in};
use crate::session::StoredAuditEntry;
use crate::session::store::{AuditFilter, StoreError, StoreLocation, read_audit};
use clap::Args;
use std::io::{BufWriter, Write as _};
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Prints the audit trail of a server's store, oldest first, as a line of JSON each. The server may be running.
#[derive(Debug, Args)]
pub struct AuditArgs {
    /// Configuration file of the server (TOML)
    #[arg(long, value_name = "FILE", env = "PLIANT_CONFIG")]
    config: Option<PathBuf>,
    /// Data folder of the server
    #[arg(long, value_name = "FOLDER", env = "PLIANT_DATA_DIR")]
    data_dir: Option<PathBuf>,
    /// Database of the server, postgres://USER:PASSWORD@HOST/DATABASE
    #[arg(long, value_name = "URL", env = "PLIANT_DATABASE", hide_env_values = true)]
    database: Option<String>,
    /// Show only this tenant
    #[arg(long)]
    tenant: Option<String>,
    /// Show only this session
    #[arg(long, value_name = "ID")]
    session: Option<String>,
    /// Start time, such as 2026-11-23T08:00:00Z, or an age, such as 12h
    #[arg(long, value_name = "TIME", value_parser = parse_since)]
    since: Option<SystemTime>,
}

/// One line.
#[derive(serde::Serialize)]
struct AuditLine {
    time: String,
    #[serde(flatten)]
    entry: StoredAuditEntry,
}

fn parse_since(text: &str) -> Result<SystemTime, String> {
    if let Ok(ago) = humantime::parse_duration(text) {
        return Ok(SystemTime::now().checked_sub(ago).unwrap_or(UNIX_EPOCH));
    }
    humantime::parse_rfc3339_weak(text)
        .map_err(|_| "neither a time such as 2026-11-23T08:00:00Z nor a span such as 12h".into())
}

impl AuditArgs {
    /// Where the trail is: in the store of the server that has this configuration, else in the one that is named.
    fn location(&self) -> Result<StoreLocation, CliFailure> {
        let Some(config) = &self.config else {
            return Ok(StoreLocation {
                data_dir: self.data_dir.clone(),
                database: self.database.clone(),
                ..StoreLocation::default()
            });
        };
        let keys = ConfigKeys {
            data_dir: (self.data_dir.as_ref()).map(|folder| KeyValue::from(folder.to_string_lossy().into_owned())),
            database: self.database.clone().map(KeyValue::from),
            ..ConfigKeys::default()
        };
        let location = stored_in(Some(config), &keys).map_err(|e| CliFailure::Input(e.to_string()))?;
        location.ok_or_else(|| {
            let problem =
                "keeps no sessions, and no trail with them: it sets neither data_dir nor database and objects";
            CliFailure::Input(format!("{} {problem}", config.display()))
        })
    }
}

pub(super) fn run_audit(args: &AuditArgs) -> Result<(), CliFailure> {
    let since = args.since.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    let filter = AuditFilter {
        tenant: args.tenant.clone(),
        session: args.session.clone(),
        since_ms: since.map_or(0, |since| u64::try_from(since.as_millis()).unwrap_or(u64::MAX)),
    };
    let mut out = BufWriter::new(std::io::stdout().lock());
    let mut written = Ok(());
    let location = args.location()?;
    let read = read_audit(&location, &filter, |entry| {
        let time = UNIX_EPOCH
            .checked_add(Duration::from_millis(entry.at_ms))
            .unwrap_or(UNIX_EPOCH);
        let time = humantime::format_rfc3339_millis(time).to_string();
        let line = serde_json::to_string(&AuditLine { time, entry }).map_err(std::io::Error::from);
        written = line.and_then(|line| writeln!(out, "{line}"));
        written.is_ok()
    });
    let reported = |error: StoreError| CliFailure::Input(format!("the store of sessions: {error}"));
    block_on(read)?.map_err(reported)?;
    printed(written.and_then(|()| out.flush()))
}
