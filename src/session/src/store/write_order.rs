//! What is written, statement by statement. The writer decides what goes into one transaction.

use super::schema::{RECORD_FORMAT, Statement, checksum, column, commit_checksum, signed};
use super::session_store::{
    Commit, Generation, HeldSession, NewCommit, NewSession, SessionRecord, StoreError, UsedSession, millis, now_ms,
};
use crate::answers::Tenant;
use crate::audit::audit_entry::AuditEntry;
use sqlx::AnyConnection;
use std::collections::BTreeMap;

/// An object that a session uses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredObject {
    /// Its name.
    pub name: String,
    /// Its size.
    pub bytes: u64,
}

/// Something to be written.
#[derive(Debug, Clone)]
pub enum WriteOrder {
    /// A session with its first commit.
    Create {
        /// The session.
        session: Box<NewSession>,
        /// Its record.
        model: Vec<u8>,
        /// What it uses.
        objects: Vec<StoredObject>,
        /// The node that has it, of several; empty for a single node.
        owner: String,
    },
    /// A commit.
    Append {
        /// The commit.
        commit: Box<NewCommit>,
        /// What it uses.
        objects: Vec<StoredObject>,
    },
    /// The newest shape of a session.
    SaveSnapshot {
        /// The session, under the ownership of its writer.
        session: HeldSession,
        /// The shape is the one after this commit.
        sequence: u64,
        /// The shape.
        shape: StoredObject,
    },
    /// Commits with digests of another build, and the checksums of their rows.
    RerecordDigests {
        /// The session, under the ownership of its writer.
        session: HeldSession,
        /// The commits, each with its checksum.
        commits: Vec<(Commit, Vec<u8>)>,
    },
    /// A session ends.
    Delete {
        /// Which one, and who ends it.
        audit: AuditEntry,
        /// The ownership of its writer; 0 where one process has the store.
        generation: Generation,
    },
    /// Sessions were used.
    NoteUse {
        /// When each was used.
        sessions: Vec<UsedSession>,
    },
    /// Keys from before this time go.
    ForgetKeys {
        /// In milliseconds since 1970.
        before_ms: u64,
    },
    /// Who did what.
    Audit {
        /// The entry.
        entry: AuditEntry,
    },
    /// What the audit trail says of before this time goes, of one tenant where it is named.
    ForgetAudit {
        /// Whose; everybody's where it is `None`.
        tenant: Option<Tenant>,
        /// In milliseconds since 1970.
        before_ms: u64,
    },
    /// The sizes of objects that an older version wrote.
    Measure {
        /// With their sizes.
        objects: Vec<StoredObject>,
    },
    /// Nothing but what was left undone.
    UndoUncertain,
    /// A row is written as it is, to see whether rows can be written.
    Touch,
}

async fn execute(statement: Statement<'_>, on: &mut AnyConnection) -> Result<u64, StoreError> {
    let done = statement.execute(on).await;
    done.map(|d| d.rows_affected())
        .map_err(|e| StoreError::Unavailable(e.to_string()))
}

/// The objects that a query names.
async fn objects_of(statement: Statement<'_>, on: &mut AnyConnection) -> Result<Vec<String>, StoreError> {
    let rows = statement.fetch_all(on).await;
    let rows = rows.map_err(|e| StoreError::Unavailable(e.to_string()))?;
    rows.iter().map(|row| column(row, 0)).collect()
}

impl WriteOrder {
    /// The commit that may be on disk though it was refused. With 0 it is the session.
    pub(super) fn uncertain_commit(&self) -> Option<UncertainCommit> {
        let (session, sequence) = match self {
            Self::Create { session, .. } => (session.first.session.clone(), 0),
            Self::Append { commit, .. } => (commit.session.clone(), commit.commit.sequence),
            _ => return None,
        };
        Some(UncertainCommit { session, sequence })
    }

    /// Writes it. Returns objects that may have no name any more.
    pub(super) async fn carry_out(&self, on: &mut AnyConnection) -> Result<Vec<String>, StoreError> {
        match self {
            Self::Create {
                session,
                model,
                objects,
                owner,
            } => {
                refuse_repeated(&session.first, owner, on).await?;
                create_session(session, model, owner, on).await?;
                append_commit(&session.first, objects, session.record.created_ms, on).await?;
            }
            Self::Append { commit, objects } => append_commit(commit, objects, now_ms(), on).await?,
            Self::SaveSnapshot {
                session,
                sequence,
                shape,
            } => return save_snapshot(session, *sequence, shape, on).await,
            Self::Measure { objects } => {
                for object in objects {
                    let update = sqlx::query("UPDATE object_uses SET bytes = $2 WHERE object = $1 AND bytes < 0");
                    execute(update.bind(&object.name).bind(signed(object.bytes)), on).await?;
                }
            }
            Self::RerecordDigests { session, commits } => {
                if !still_has(session, on).await? {
                    return Err(StoreError::Moved);
                }
                for (commit, sum) in commits {
                    let update = "UPDATE commits SET digest = $3, build = $4, checksum = $5
                        WHERE session = $1 AND sequence = $2";
                    let update = sqlx::query(update).bind(&session.id).bind(signed(commit.sequence));
                    execute(update.bind(&commit.digest).bind(&commit.build).bind(&sum[..]), on).await?;
                }
            }
            Self::Delete { audit, generation } => {
                let session = HeldSession {
                    id: audit.session.clone(),
                    generation: *generation,
                };
                if *generation != Generation::default() && !still_has(&session, on).await? {
                    return Err(StoreError::Moved);
                }
                let unnamed = delete_session(&audit.session, on).await?;
                note_audit(audit, None, on).await?;
                return Ok(unnamed);
            }
            Self::NoteUse { sessions } => {
                for used in sessions {
                    let update = "UPDATE sessions SET used_ms = $2 WHERE id = $1 AND used_ms < $2 AND ($3 = 0 OR generation = $3)";
                    let update = sqlx::query(update).bind(&used.session.id).bind(signed(used.used_ms));
                    execute(update.bind(signed(used.session.generation.0)), on).await?;
                }
            }
            Self::ForgetKeys { before_ms } => {
                let delete = sqlx::query("DELETE FROM call_keys WHERE at_ms < $1");
                execute(delete.bind(signed(*before_ms)), on).await?;
            }
            Self::Audit { entry } => note_audit(entry, None, on).await?,
            Self::ForgetAudit { tenant, before_ms } => {
                let delete = sqlx::query("DELETE FROM audit WHERE at_ms < $1 AND ($2 = '' OR tenant = $2)");
                let tenant = tenant.as_ref().map_or("", |tenant| &*tenant.0);
                execute(delete.bind(signed(*before_ms)).bind(tenant), on).await?;
            }
            Self::UndoUncertain => {}
            Self::Touch => drop(execute(sqlx::query("UPDATE store_identity SET id = id"), on).await?),
        }
        Ok(Vec::new())
    }
}

/// Commits that were refused and may be on disk, the first one of each session by its id.
pub type UncertainCommits = BTreeMap<String, UncertainCommit>;

/// A commit that was refused and may have been written all the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UncertainCommit {
    /// Its session, under the ownership of then.
    pub session: HeldSession,
    /// Its number; 0 is the creation of the session.
    pub sequence: u64,
}

/// The ownership that a new session begins with.
pub(super) fn first_generation(owner: &str) -> Generation {
    Generation(u64::from(!owner.is_empty()))
}

/// Whether a session still has the same owner, which then holds until the transaction ends.
async fn still_has(session: &HeldSession, on: &mut AnyConnection) -> Result<bool, StoreError> {
    let touch = "UPDATE sessions SET newest = newest WHERE id = $1 AND ($2 = 0 OR generation = $2)";
    let touch = sqlx::query(touch).bind(&session.id).bind(signed(session.generation.0));
    Ok(execute(touch, on).await? == 1)
}

/// Removes what was refused and may have been written all the same: commits from the uncertain one on, with 0 the session. What another
/// node has by now stays as that node has found it.
pub(super) async fn undo_uncertain(doubt: &UncertainCommit, on: &mut AnyConnection) -> Result<(), StoreError> {
    let (session, sequence) = (&doubt.session.id, doubt.sequence);
    if doubt.session.generation != Generation::default() && !still_has(&doubt.session, on).await? {
        return Ok(());
    }
    let number = signed(sequence);
    let noted = sqlx::query("DELETE FROM audit WHERE session = $1 AND sequence >= $2");
    execute(noted.bind(session).bind(number), on).await?;
    if sequence == 0 {
        return delete_session(session, on).await.map(drop);
    }
    let keys = sqlx::query("DELETE FROM call_keys WHERE session = $1 AND sequence >= $2");
    execute(keys.bind(session).bind(number), on).await?;
    let bytes = "UPDATE sessions SET record_bytes = record_bytes
        - (SELECT COALESCE(SUM(LENGTH(payload)), 0) FROM commits WHERE session = $1 AND sequence >= $2) WHERE id = $1";
    execute(sqlx::query(bytes).bind(session).bind(number), on).await?;
    let commits = sqlx::query("DELETE FROM commits WHERE session = $1 AND sequence >= $2");
    if execute(commits.bind(session).bind(number), on).await? > 0 {
        let newest = sqlx::query("UPDATE sessions SET newest = $2 WHERE id = $1");
        execute(newest.bind(session).bind(number - 1), on).await?;
    }
    Ok(())
}

/// The checksum of a session's row, without what changes in it.
pub(super) fn session_checksum(id: &str, tenant: &str, model: &[u8], numbers: [i64; 2]) -> Vec<u8> {
    checksum(
        &[id.as_bytes(), tenant.as_bytes(), model],
        &[numbers[0], numbers[1], RECORD_FORMAT],
    )
}

/// Refuses the creation of a session whose call another node carried out at the same time. A single node knows its own
/// calls.
async fn refuse_repeated(first: &NewCommit, owner: &str, on: &mut AnyConnection) -> Result<(), StoreError> {
    let Some((tenant, key, _)) = first.key.as_ref().filter(|_| !owner.is_empty()) else {
        return Ok(());
    };
    // The second of two waits here for the first, and adds nothing then.
    let insert = "INSERT INTO call_keys (tenant, call_key, fingerprint, session, sequence, at_ms)
        VALUES ($1, $2, '', $3, 0, 0) ON CONFLICT (tenant, call_key) DO NOTHING";
    let insert = sqlx::query(insert).bind(&*tenant.0).bind(key).bind(&first.session.id);
    match execute(insert, on).await? {
        1 => Ok(()),
        _ => Err(StoreError::Repeated),
    }
}

async fn create_session(
    session: &NewSession,
    model: &[u8],
    owner: &str,
    on: &mut AnyConnection,
) -> Result<(), StoreError> {
    let SessionRecord {
        id,
        tenant,
        number,
        ttl,
        ..
    } = &session.record;
    let tenant = &*tenant.0;
    let insert = "INSERT INTO tenants (tenant, created_ms) VALUES ($1, $2) ON CONFLICT (tenant) DO NOTHING";
    execute(sqlx::query(insert).bind(tenant).bind(signed(now_ms())), on).await?;
    let (number, ttl) = (signed(*number), signed(millis(*ttl)));
    let sum = session_checksum(id, tenant, model, [number, ttl]);
    let insert =
        "INSERT INTO sessions (id, tenant, number, ttl_ms, used_ms, newest, format, model, checksum, record_bytes, owner, generation)
        VALUES ($1, $2, $3, $4, $5, 0, $6, $7, $8, $9, $10, $11)";
    let insert = sqlx::query(insert).bind(id).bind(tenant).bind(number).bind(ttl);
    let insert = insert.bind(signed(now_ms())).bind(RECORD_FORMAT);
    let insert = insert.bind(model).bind(sum);
    let insert = insert.bind(signed(model.len() as u64)).bind(owner);
    execute(insert.bind(signed(first_generation(owner).0)), on)
        .await
        .map(drop)
}

/// Writes a commit that was made at `at_ms`; of the first one that is when the session was opened.
async fn append_commit(
    new: &NewCommit,
    objects: &[StoredObject],
    at_ms: u64,
    on: &mut AnyConnection,
) -> Result<(), StoreError> {
    let (HeldSession { id, generation }, commit, now) = (&new.session, &new.commit, signed(at_ms));
    let (payload, kind, sequence) = (commit.record.write(), commit.record.kind(), signed(commit.sequence));
    // First of all: the row is this writer's until the transaction ends, or nothing is written.
    let newest = "UPDATE sessions SET newest = $2, used_ms = $3, record_bytes = record_bytes + $4
        WHERE id = $1 AND ($5 = 0 OR generation = $5)";
    let newest = sqlx::query(newest).bind(id).bind(sequence).bind(now);
    let newest = newest.bind(signed(payload.len() as u64));
    if execute(newest.bind(signed(generation.0)), on).await? != 1 {
        return Err(match generation {
            Generation(0) => StoreError::Damaged("the session's row is gone".into()),
            _ => StoreError::Moved,
        });
    }
    let insert = "INSERT INTO commits
        (session, sequence, revision, kind, digest, build, facts_at, poses_at, at_ms, format, payload, checksum)
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12)";
    let insert = sqlx::query(insert)
        .bind(id)
        .bind(sequence)
        .bind(signed(commit.revision));
    let insert = insert.bind(kind).bind(&commit.digest).bind(&commit.build);
    let insert = insert.bind(signed(commit.facts_at)).bind(signed(commit.poses_at));
    let insert = insert.bind(now).bind(RECORD_FORMAT).bind(&payload[..]);
    execute(insert.bind(commit_checksum(id, kind, commit, &payload)), on).await?;
    for object in objects {
        use_object(id, object, on).await?;
    }
    note_audit(&new.audit, Some(sequence), on).await?;
    if let Some((tenant, key, fingerprint)) = &new.key {
        let insert = "INSERT INTO call_keys (tenant, call_key, fingerprint, session, sequence, at_ms)
            VALUES ($1, $2, $3, $4, $5, $6) ON CONFLICT (tenant, call_key) DO UPDATE SET
            fingerprint = excluded.fingerprint, session = excluded.session, sequence = excluded.sequence,
            at_ms = excluded.at_ms";
        let insert = sqlx::query(insert).bind(&*tenant.0).bind(key);
        let insert = insert.bind(fingerprint.to_le_bytes().to_vec()).bind(id);
        execute(insert.bind(sequence).bind(now), on).await?;
    }
    Ok(())
}

/// Notes who did what; `sequence` is that of the commit that it was.
async fn note_audit(entry: &AuditEntry, sequence: Option<i64>, on: &mut AnyConnection) -> Result<(), StoreError> {
    let insert = "INSERT INTO audit (tenant, at_ms, who, what, session, sequence) VALUES ($1, $2, $3, $4, $5, $6)";
    let insert = sqlx::query(insert).bind(&*entry.tenant.0).bind(signed(now_ms()));
    let insert = insert.bind(&*entry.who).bind(entry.what.name()).bind(&entry.session);
    execute(insert.bind(sequence.unwrap_or(-1)), on).await.map(drop)
}

async fn use_object(session: &str, object: &StoredObject, on: &mut AnyConnection) -> Result<(), StoreError> {
    let insert = "INSERT INTO object_uses (session, object, bytes) VALUES ($1, $2, $3)
        ON CONFLICT (session, object) DO NOTHING";
    let insert = sqlx::query(insert).bind(session).bind(&object.name);
    execute(insert.bind(signed(object.bytes)), on).await?;
    let named = sqlx::query("DELETE FROM loose_objects WHERE object = $1").bind(&object.name);
    execute(named, on).await.map(drop)
}

async fn save_snapshot(
    held: &HeldSession,
    sequence: u64,
    shape: &StoredObject,
    on: &mut AnyConnection,
) -> Result<Vec<String>, StoreError> {
    let session = &held.id;
    if !still_has(held, on).await? {
        // It was deleted meanwhile, or another node has it.
        return Ok(vec![shape.name.clone()]);
    }
    let older = sqlx::query("SELECT object FROM snapshots WHERE session = $1").bind(session);
    let mut older = objects_of(older, on).await?;
    older.retain(|object| *object != shape.name);
    let insert = "INSERT INTO snapshots (session, sequence, object) VALUES ($1, $2, $3) ON CONFLICT (session) DO UPDATE
        SET sequence = excluded.sequence, object = excluded.object";
    let insert = sqlx::query(insert).bind(session).bind(signed(sequence));
    execute(insert.bind(&shape.name), on).await?;
    for object in &older {
        let delete = sqlx::query("DELETE FROM object_uses WHERE session = $1 AND object = $2");
        execute(delete.bind(session).bind(object), on).await?;
    }
    use_object(session, shape, on).await?;
    Ok(older)
}

async fn delete_session(session: &str, on: &mut AnyConnection) -> Result<Vec<String>, StoreError> {
    let used = sqlx::query("SELECT object FROM object_uses WHERE session = $1").bind(session);
    let used = objects_of(used, on).await?;
    for delete in [
        "DELETE FROM call_keys WHERE session = $1",
        "DELETE FROM snapshots WHERE session = $1",
        "DELETE FROM object_uses WHERE session = $1",
        "DELETE FROM commits WHERE session = $1",
        "DELETE FROM sessions WHERE id = $1",
    ] {
        execute(sqlx::query(delete).bind(session), on).await?;
    }
    Ok(used)
}
