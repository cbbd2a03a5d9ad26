//! Rows with their checksums.

use super::session_store::{Commit, NewCommit, StoreError};
use crate::wire::record::LoggedCommit;
use sqlx::Row as _;
use sqlx::any::AnyRow;
use xxhash_rust::xxh3::Xxh3;

/// The version of the records that this program writes; it reads this one and all before.
pub(super) const RECORD_FORMAT: i64 = 1;

/// The columns of a commit, as [`CommitRow::read`] expects them.
pub(super) const COMMIT_COLUMNS: &str =
    "session, sequence, revision, kind, digest, build, facts_at, poses_at, format, payload, checksum";

/// A row of the commits.
#[derive(Debug, Clone)]
pub(super) struct CommitRow {
    pub session: String,
    pub sequence: i64,
    pub revision: i64,
    pub kind: String,
    pub digest: String,
    pub build: String,
    pub facts_at: i64,
    pub poses_at: i64,
    pub format: i64,
    pub payload: Vec<u8>,
}

impl CommitRow {
    pub fn of(new: &NewCommit) -> Self {
        let commit = &new.commit;
        Self {
            session: new.session.id.clone(),
            sequence: signed(commit.sequence),
            revision: signed(commit.revision),
            kind: commit.record.kind().into(),
            digest: commit.digest.clone(),
            build: commit.build.clone(),
            facts_at: signed(commit.facts_at),
            poses_at: signed(commit.poses_at),
            format: RECORD_FORMAT,
            payload: commit.record.write(),
        }
    }

    pub fn checksum(&self) -> Vec<u8> {
        let numbers = [self.sequence, self.revision, self.facts_at, self.poses_at, self.format];
        checksum(
            &[
                self.session.as_bytes(),
                self.kind.as_bytes(),
                self.digest.as_bytes(),
                self.build.as_bytes(),
                &self.payload,
            ],
            &numbers,
        )
    }

    /// Reads the columns of [`COMMIT_COLUMNS`].
    pub fn read(row: &AnyRow) -> Result<Self, StoreError> {
        let read = Self {
            session: column(row, 0)?,
            sequence: column(row, 1)?,
            revision: column(row, 2)?,
            kind: column(row, 3)?,
            digest: column(row, 4)?,
            build: column(row, 5)?,
            facts_at: column(row, 6)?,
            poses_at: column(row, 7)?,
            format: column(row, 8)?,
            payload: column(row, 9)?,
        };
        check_format(read.format)?;
        let expected: Vec<u8> = column(row, 10)?;
        if read.checksum() != expected {
            return Err(StoreError::Damaged(format!(
                "commit {} does not have the checksum that it was written with",
                read.sequence
            )));
        }
        Ok(read)
    }

    pub fn into_commit(self) -> Result<Commit, StoreError> {
        let record = LoggedCommit::read(&self.payload)
            .map_err(|e| StoreError::Damaged(format!("commit {} cannot be read: {e}", self.sequence)))?;
        Ok(Commit {
            sequence: unsigned(self.sequence)?,
            revision: unsigned(self.revision)?,
            digest: self.digest,
            build: self.build,
            facts_at: unsigned(self.facts_at)?,
            poses_at: unsigned(self.poses_at)?,
            record,
        })
    }
}

/// Refuses records of a later version.
pub(super) fn check_format(format: i64) -> Result<(), StoreError> {
    if (1..=RECORD_FORMAT).contains(&format) {
        return Ok(());
    }
    Err(StoreError::Refused(format!(
        "the session was written in format {format}, this program reads formats up to {RECORD_FORMAT}"
    )))
}

/// The checksum of a row.
pub(super) fn checksum(parts: &[&[u8]], numbers: &[i64]) -> Vec<u8> {
    let mut hasher = Xxh3::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    numbers.iter().for_each(|n| hasher.update(&n.to_le_bytes()));
    hasher.digest128().to_le_bytes().to_vec()
}

/// A column's value; another type than was written is damage.
pub(super) fn column<'r, T>(row: &'r AnyRow, index: usize) -> Result<T, StoreError>
where
    T: sqlx::Decode<'r, sqlx::Any> + sqlx::Type<sqlx::Any>,
{
    row.try_get(index)
        .map_err(|e| StoreError::Damaged(format!("a row cannot be read: {e}")))
}

/// A number as databases hold it. Those of sessions never come near the limit.
pub(super) fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// A number that a database held.
pub(super) fn unsigned(number: i64) -> Result<u64, StoreError> {
    u64::try_from(number).map_err(|_| StoreError::Damaged(format!("a row holds the number {number}")))
}
