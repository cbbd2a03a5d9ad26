//! `pliant store list`: the sessions of all tenants.

use super::super::failure::CliFailure;
use super::super::json_output::print_value;
use super::kept_place::{StorePlaceArgs, all_sessions};
use crate::session::store::StoredFacts;
use clap::Args;
use serde_json::{Value, json};
use std::time::{Duration, UNIX_EPOCH};

/// Lists the sessions of all tenants: id, commits, last use, end, tenant, with tabs between them.
#[derive(Debug, Args)]
pub(super) struct StoreListArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Those of this tenant alone
    #[arg(long, value_name = "NAME")]
    tenant: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) async fn run_store_list(args: &StoreListArgs) -> Result<(), CliFailure> {
    let store = args.place.open().await?;
    let mut sessions = all_sessions(&store).await?;
    let is_asked = |s: &StoredFacts| args.tenant.as_ref().is_none_or(|name| **name == *s.tenant.0);
    sessions.retain(is_asked);
    if args.json {
        let told: Vec<Value> = sessions.iter().map(as_json).collect();
        return print_value(&json!({ "sessions": told }));
    }
    for session in &sessions {
        let (id, tenant, commits) = (&session.id, &session.tenant.0, session.commits);
        println!("{id}\t{commits}\t{}\t{}\t{tenant}", last_use(session), end_of(session));
    }
    Ok(())
}

fn shown_time(ms: u64) -> String {
    let time = UNIX_EPOCH.checked_add(Duration::from_millis(ms)).unwrap_or(UNIX_EPOCH);
    humantime::format_rfc3339_seconds(time).to_string()
}

fn last_use(session: &StoredFacts) -> String {
    shown_time(session.used_ms)
}

fn end_of(session: &StoredFacts) -> String {
    shown_time(session.used_ms.saturating_add(session.ttl_ms))
}

fn as_json(session: &StoredFacts) -> Value {
    json!({"id": session.id, "tenant": &*session.tenant.0, "commits": session.commits, "usedAt": last_use(session),
        "expiresAt": end_of(session)})
}
