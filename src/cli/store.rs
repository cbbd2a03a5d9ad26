//! `pliant store`: what operators do with kept sessions while no server holds them.
//!
//! `check` compares what is stored with its checksums, `list` names the sessions of all tenants, `export` writes the model of a
//! session, `prune` removes what is unused.

use super::input_files::output_format;
use super::output_files::OutputPermission;
use super::terminal::{CliFailure, list, print_value};
use crate::asset::FileSet;
use crate::server::config::{ConfigKeys, KeyValue, stored_in};
use crate::session;
use crate::session::store::{CheckedSession, Generation, Store, StoreError, StoreLocation, StoredFacts, now_ms};
use crate::session::{AuditEntry, AuditedAction, ErrorCode, Manager, OpenDeformer, SessionConfig};
use clap::{Args, Subcommand};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};

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
    Check(StoreCheckArgs),
    /// List the sessions of all tenants
    List(StoreListArgs),
    /// Write the model of a session in its current shape
    Export(StoreExportArgs),
    /// Remove unused sessions and unreferenced objects
    Prune(StorePruneArgs),
}

pub(super) fn run_store(args: &StoreArgs) -> Result<(), CliFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let runtime = runtime.map_err(|e| CliFailure::Internal(format!("cannot start threads: {e}")))?;
    let done = runtime.block_on(async {
        match &args.command {
            StoreCommand::Check(args) => run_store_check(args).await,
            StoreCommand::List(args) => run_store_list(args).await,
            StoreCommand::Export(args) => run_store_export(args).await,
            StoreCommand::Prune(args) => run_store_prune(args).await,
        }
    });
    runtime.shutdown_background();
    done
}

/// How often a session is looked at that a server may be writing.
const TRIES: u32 = 5;
/// Between two of these looks.
const BETWEEN_TRIES: Duration = Duration::from_millis(100);

/// Compares everything that is kept with its checksums: rows, objects, and with --replay the shapes that come of them.
///
/// One line for each session, and one for the whole. Exit code 1 when something is damaged. Nothing is changed.
#[derive(Debug, Args)]
struct StoreCheckArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Also open every session and compare its shapes with the recorded ones
    #[arg(long)]
    replay: bool,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

async fn run_store_check(args: &StoreCheckArgs) -> Result<(), CliFailure> {
    let store = Arc::new(args.place.look().await?);
    let in_database = store.check_database().await;
    let manager = match args.replay {
        true => Some(lookers(&store).await?),
        false => None,
    };
    let (mut damaged, mut reported) = (u64::from(in_database.is_err()), Vec::new());
    let mut total = CheckedSession::default();
    if let (Err(error), false) = (&in_database, args.json) {
        list!("damaged  the database: {error}")?;
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
            true => reported.push(checked_json(session, &checked)),
            false => list!("{}", as_line(session, &checked))?,
        }
    }
    let unused = store.unused_objects().await.map_err(store_failure)?;
    if args.json {
        print_value(&json!({
            "database": in_database.err().map_or_else(|| "ok".to_owned(), |e| e.to_string()),
            "sessions": reported, "damaged": damaged, "unusedObjects": unused,
        }))?;
    } else {
        list!(
            "{} sessions, {} commits, {} objects with {} bytes; {damaged} damaged, {} objects that no session names",
            sessions.len(),
            total.commits,
            total.objects,
            total.object_bytes,
            unused.len()
        )?;
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
    store: &Store,
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

fn checked_json(session: &StoredFacts, checked: &Result<CheckedSession, String>) -> Value {
    let (id, tenant) = (&session.id, &*session.tenant.0);
    match checked {
        Ok(found) => json!({"id": id, "tenant": tenant, "commits": found.commits, "objects": found.objects,
            "objectBytes": found.object_bytes}),
        Err(problem) => json!({"id": id, "tenant": tenant, "damaged": problem}),
    }
}

/// Writes the model of a session in its current shape. Nothing of the session changes.
#[derive(Debug, Args)]
struct StoreExportArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// Session id
    session: String,
    /// Output file; its extension selects the format
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
}

async fn run_store_export(args: &StoreExportArgs) -> Result<(), CliFailure> {
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
        list!("{}", path.display())?;
    }
    Ok(())
}

/// Where the sessions are kept.
#[derive(Debug, Args)]
struct StorePlaceArgs {
    /// Configuration file of the server (TOML)
    #[arg(long, value_name = "FILE", env = "PLIANT_CONFIG")]
    config: Option<PathBuf>,
    /// Folder of the stored sessions
    #[arg(long, value_name = "FOLDER")]
    data_dir: Option<KeyValue<String>>,
    /// Database of the stored sessions, postgres://USER:PASSWORD@HOST/DATABASE
    #[arg(long, value_name = "URL")]
    database: Option<KeyValue<String>>,
    /// Object store of models and shapes, s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL")]
    objects: Option<KeyValue<String>>,
}

impl StorePlaceArgs {
    /// Opens the store read-only; a server may hold it meanwhile.
    pub async fn look(&self) -> Result<Store, CliFailure> {
        Store::open_to_read(&self.location()?).await.map_err(store_failure)
    }

    /// Opens the store exclusively, to change it. It does not create one.
    pub async fn take(&self) -> Result<Store, CliFailure> {
        Store::open_existing(&self.location()?).await.map_err(store_failure)
    }

    fn location(&self) -> Result<StoreLocation, CliFailure> {
        let keys = ConfigKeys {
            data_dir: self.data_dir.clone(),
            database: self.database.clone(),
            objects: self.objects.clone(),
            ..ConfigKeys::default()
        };
        let location = stored_in(self.config.as_deref(), &keys).map_err(|e| CliFailure::Input(e.to_string()))?;
        location.ok_or_else(|| {
            CliFailure::Input("say where sessions are kept: --data-dir, or --database and --objects".into())
        })
    }
}

/// How a command ends that the store refuses.
fn store_failure(error: StoreError) -> CliFailure {
    let text = format!("the store of sessions: {error}");
    match error {
        StoreError::Damaged(_) => CliFailure::Check(text),
        StoreError::Unavailable(_) | StoreError::Refused(_) | StoreError::Moved | StoreError::Repeated => {
            CliFailure::Input(text)
        }
    }
}

/// How a command ends that a session refuses.
fn session_failure(error: &session::Error) -> CliFailure {
    match error.code {
        ErrorCode::DataLoss => CliFailure::Check(error.to_string()),
        ErrorCode::Internal => CliFailure::Internal(error.to_string()),
        _ => CliFailure::Input(error.to_string()),
    }
}

/// Sessions of a store that is only looked at.
async fn lookers(store: &Arc<Store>) -> Result<Manager, CliFailure> {
    // What a server let in is looked at, whatever its limits were.
    let config = SessionConfig {
        vertices: u32::MAX.into(),
        triangles: u32::MAX.into(),
        handles: u32::MAX as usize,
        ..SessionConfig::default()
    };
    let manager = Manager::with_store(config, OpenDeformer, Arc::clone(store)).await;
    manager.map_err(|e| session_failure(&e))
}

/// Lists the sessions of all tenants: id, commits, last use, time to live, tenant, with tabs between them.
#[derive(Debug, Args)]
struct StoreListArgs {
    #[command(flatten)]
    place: StorePlaceArgs,
    /// List only this tenant
    #[arg(long, value_name = "NAME")]
    tenant: Option<String>,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

async fn run_store_list(args: &StoreListArgs) -> Result<(), CliFailure> {
    let store = args.place.look().await?;
    let mut sessions = store.all_sessions().await.map_err(store_failure)?;
    let is_asked = |s: &StoredFacts| args.tenant.as_ref().is_none_or(|name| **name == *s.tenant.0);
    sessions.retain(is_asked);
    if args.json {
        let reported: Vec<Value> = sessions.iter().map(as_json).collect();
        return print_value(&json!({ "sessions": reported }));
    }
    for session in &sessions {
        let (id, tenant, commits) = (&session.id, &session.tenant.0, session.commits);
        list!(
            "{id}\t{commits}\t{}\t{}\t{tenant}",
            last_use(session),
            time_to_live(session)
        )?;
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

/// Remove objects that no session names, and with --unused-for unused sessions.
///
/// Prints a line for each, and a total. A process that ends during a call leaves such objects. Only a server ends
/// expired sessions: their time to live passes only while one runs.
#[derive(Debug, Args)]
struct StorePruneArgs {
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

async fn run_store_prune(args: &StorePruneArgs) -> Result<(), CliFailure> {
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
        list!("session  {}  {}", session.id, session.tenant.0)?;
    }
    let unused = store.unused_objects().await.map_err(store_failure)?;
    if !args.dry_run {
        store.remove_unused(&unused).await.map_err(store_failure)?;
    }
    for object in &unused {
        list!("object   {object}")?;
    }
    if let (Some(age), false) = (args.audit_older_than, args.dry_run) {
        let before = now.saturating_sub(milliseconds(age));
        store.forget_audit(None, before).await.map_err(store_failure)?;
    }
    let (done, counts) = (
        if args.dry_run { "would be removed" } else { "removed" },
        (sessions.len(), unused.len()),
    );
    list!("{} sessions and {} objects {done}", counts.0, counts.1)
}
