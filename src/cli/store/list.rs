//! `pliant store list`: the sessions of all tenants.

use super::super::failure::CliFailure;
use super::super::terminal::print_value;
use super::kept_place::{StorePlaceArgs, store_failure};
use crate::session::store::StoredFacts;
use clap::Args;
use serde_json::{Value, json};
use std::time::{Duration, UNIX_EPOCH};

/// Lists the sessions of all tenants: id, commits, last use, time to live, tenant, with tabs between them.
#[derive(Debug, Args)]
pub(super) struct StoreListArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// List only this tenant
    #[arg(long, value_name = "NAME")]
    tenant: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) async fn run_store_list(args: &StoreListArgs) -> Result<(), CliFailure> {
    let store = args.place.look().await?;
    let mut sessions = store.all_sessions().await.map_err(store_failure)?;
    let is_asked = |s: &StoredFacts| args.tenant.as_ref().is_none_or(|name| **name == *s.tenant.0);
    sessions.retain(is_asked);
    if args.json {
        let told: Vec<Value> = sessions.iter().map(as_json).collect();
        return print_value(&json!({ "sessions": told }));
    }
    for session in &sessions {
        let (id, tenant, commits) = (&session.id, &session.tenant.0, session.commits);
        println!(
            "{id}\t{commits}\t{}\t{}\t{tenant}",
            last_use(session),
            time_to_live(session)
        );
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

/// How long it lives without a use while a server runs.
fn time_to_live(session: &StoredFacts) -> String {
    humantime::format_duration(Duration::from_millis(session.ttl_ms)).to_string()
}

fn as_json(session: &StoredFacts) -> Value {
    json!({"id": session.id, "tenant": &*session.tenant.0, "commits": session.commits, "usedAt": last_use(session),
        "ttlSeconds": session.ttl_ms as f64 / 1000.0})
}
