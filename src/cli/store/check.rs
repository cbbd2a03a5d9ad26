//! `pliant store check`: everything that is kept beside its checksums.

use super::super::failure::CliFailure;
use super::super::terminal::print_value;
use super::kept_place::{StorePlaceArgs, lookers, store_failure};
use crate::session::Manager;
use crate::session::store::{CheckedSession, ReadOnlyStore, StoredFacts};
use clap::Args;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

/// How often a session is looked at that a server may be writing.
const TRIES: u32 = 5;
/// Between two of these looks.
const BETWEEN_TRIES: Duration = Duration::from_millis(100);

/// Compares everything that is kept with its checksums: rows, objects, and with --replay the shapes that come of them.
///
/// One line for each session, and one for the whole. Exit code 1 when something is damaged. Nothing is changed.
#[derive(Debug, Args)]
pub(super) struct StoreCheckArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Also open every session and compare its shapes with the recorded ones
    #[arg(long)]
    replay: bool,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) async fn run_store_check(args: &StoreCheckArgs) -> Result<(), CliFailure> {
    let store = Arc::new(args.place.look().await?);
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
    let sessions = store.all_sessions().await.map_err(store_failure)?;
    for session in &sessions {
        let Some(checked) = check_one(&store, manager.as_ref(), session).await else {
            continue;
        };
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

/// Compares a session; `None` where it went meanwhile.
async fn check_one(
    store: &ReadOnlyStore,
    manager: Option<&Manager>,
    session: &StoredFacts,
) -> Option<Result<CheckedSession, String>> {
    let mut tries = 0;
    loop {
        tries += 1;
        let checked = match store.check_session(&session.tenant, &session.id).await {
            Ok(None) => return None,
            Ok(Some(found)) => match manager {
                Some(manager) => (manager.history(&session.tenant, &session.id).await)
                    .map(|_| found)
                    .map_err(|e| e.to_string()),
                None => Ok(found),
            },
            Err(error) => Err(error.to_string()),
        };
        // What a server just writes is looked at again.
        if checked.is_ok() || !store.is_written() || tries == TRIES {
            return Some(checked);
        }
        tokio::time::sleep(BETWEEN_TRIES).await;
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
