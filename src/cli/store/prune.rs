//! `pliant store prune`: removes what is unused.

use super::super::failure::CliFailure;
use super::kept_place::{StorePlaceArgs, store_failure};
use crate::session::store::{Generation, KeepSessions as _, StoredFacts, now_ms};
use crate::session::{AuditEntry, AuditedAction};
use clap::Args;
use std::time::Duration;

/// Remove objects that no session names, and with --unused-for unused sessions.
///
/// Prints a line for each, and a total. A process that ends during a call leaves such objects. Only a server ends
/// expired sessions: their time to live passes only while one runs.
#[derive(Debug, Args)]
pub(super) struct StorePruneArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Remove sessions not used for this time, such as 30d
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    unused_for: Option<Duration>,
    /// Remove only sessions of this tenant
    #[arg(long, value_name = "NAME")]
    tenant: Option<String>,
    /// Also remove audit entries older than this, such as 365d
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    audit_older_than: Option<Duration>,
    /// Print what would be removed; remove nothing
    #[arg(long)]
    dry_run: bool,
}

fn parse_time(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|e| format!("{e}; allowed is a number with its unit, such as 30d"))
}

fn milliseconds(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

impl StorePruneArgs {
    fn goes(&self, session: &StoredFacts, now: u64) -> bool {
        let kept = self.unused_for.map_or(u64::MAX, milliseconds);
        let is_asked = self.tenant.as_ref().is_none_or(|name| **name == *session.tenant.0);
        is_asked && session.used_ms.saturating_add(kept) < now
    }
}

/// Runs the command.
pub(super) async fn run_store_prune(args: &StorePruneArgs) -> Result<(), CliFailure> {
    let store = args.place.take().await?;
    let now = now_ms();
    let mut sessions = store.all_sessions().await.map_err(store_failure)?;
    sessions.retain(|s| args.goes(s, now));
    for session in &sessions {
        if !args.dry_run {
            let audit = AuditEntry {
                tenant: session.tenant.clone(),
                who: "pliant store prune".into(),
                what: AuditedAction::Expire,
                session: session.id.clone(),
            };
            store
                .delete(audit, Generation::default())
                .await
                .map_err(store_failure)?;
        }
        println!("session  {}  {}", session.id, session.tenant.0);
    }
    let unused = store.unused_objects().await.map_err(store_failure)?;
    if !args.dry_run {
        store.remove_unused(&unused).await.map_err(store_failure)?;
    }
    for object in &unused {
        println!("object   {object}");
    }
    if let (Some(age), false) = (args.audit_older_than, args.dry_run) {
        let before = now.saturating_sub(milliseconds(age));
        store.forget_audit(before).await.map_err(store_failure)?;
    }
    let (done, counts) = (
        if args.dry_run { "would be removed" } else { "removed" },
        (sessions.len(), unused.len()),
    );
    println!("{} sessions and {} objects {done}", counts.0, counts.1);
    Ok(())
}
