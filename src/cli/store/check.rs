//! `pliant store check`: everything that is kept beside its checksums.

use super::super::failure::CliFailure;
use super::super::json_output::print_value;
use super::kept_place::{StorePlaceArgs, all_sessions, lookers, store_failure};
use crate::session::store::{CheckedSession, StoredFacts, now_ms};
use clap::Args;
use serde_json::{Value, json};
use std::sync::Arc;

/// Compares everything that is kept with its checksums: rows, objects, and with --replay the shapes that come of them.
///
/// One line for each session, and one for the whole. Exit code 1 when something is damaged. Nothing is changed.
#[derive(Debug, Args)]
pub(super) struct StoreCheckArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Open every session too, and compare its shapes with what was recorded
    #[arg(long)]
    replay: bool,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) async fn run_store_check(args: &StoreCheckArgs) -> Result<(), CliFailure> {
    let store = Arc::new(args.place.open().await?);
    let in_database = store.check_database().await;
    let manager = match args.replay {
        true => Some(lookers(&store).await?),
        false => None,
    };
    let (mut damaged, mut told) = (u64::from(in_database.is_err()), Vec::new());
    let mut total = CheckedSession::default();
    if let (Err(error), false) = (&in_database, args.json) {
        println!("damaged  the database: {error}");
    }
    let sessions = all_sessions(&store).await?;
    for session in &sessions {
        let mut checked = store
            .check_session(&session.tenant, &session.id)
            .await
            .map_err(|e| e.to_string());
        // One whose time is over opens nowhere any more.
        let is_alive = session.used_ms.saturating_add(session.ttl_ms) > now_ms();
        if let (Some(manager), Ok(_), true) = (&manager, &checked, is_alive)
            && let Err(error) = manager.history(&session.tenant, &session.id).await
        {
            checked = Err(error.to_string());
        }
        damaged += u64::from(checked.is_err());
        if let Ok(found) = &checked {
            total.commits += found.commits;
            total.objects += found.objects;
            total.object_bytes += found.object_bytes;
        }
        match args.json {
            true => told.push(as_json(session, &checked)),
            false => println!("{}", as_line(session, &checked)),
        }
    }
    let unused = store.unused_objects().await.map_err(store_failure)?;
    if args.json {
        print_value(&json!({
            "database": in_database.err().map_or_else(|| "ok".to_owned(), |e| e.to_string()),
            "sessions": told, "damaged": damaged, "unusedObjects": unused,
        }))?;
    } else {
        println!(
            "{} sessions, {} commits, {} objects with {} bytes; {damaged} damaged, {} objects that no session names",
            sessions.len(),
            total.commits,
            total.objects,
            total.object_bytes,
            unused.len()
        );
    }
    match damaged {
        0 => Ok(()),
        _ => Err(CliFailure::Check(format!(
            "{damaged} damaged; restore them from a backup, or delete them"
        ))),
    }
}

fn as_line(session: &StoredFacts, checked: &Result<CheckedSession, String>) -> String {
    let (id, tenant) = (&session.id, &session.tenant.0);
    match checked {
        Ok(found) => format!(
            "ok       {id}  {tenant}  {} commits, {} objects",
            found.commits, found.objects
        ),
        Err(problem) => format!("damaged  {id}  {tenant}  {problem}"),
    }
}

fn as_json(session: &StoredFacts, checked: &Result<CheckedSession, String>) -> Value {
    let (id, tenant) = (&session.id, &*session.tenant.0);
    match checked {
        Ok(found) => json!({"id": id, "tenant": tenant, "commits": found.commits, "objects": found.objects,
            "objectBytes": found.object_bytes}),
        Err(problem) => json!({"id": id, "tenant": tenant, "damaged": problem}),
    }
}
