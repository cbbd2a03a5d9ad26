//! How far a database of SQLite has been written, noted in a file beside it.
//!
//! SQLite takes the first frame of its log that is not whole for the end of the log, so that a damaged byte, or a log that was
//! removed, silently takes away the transactions after it. Each transaction of this program writes its number into the
//! database (`user_version`), and the number is noted beside the database before the transaction is acknowledged. A
//! database that is behind its note has lost transactions.
//!
//! The note is written after the transaction was synced and is not synced itself: it costs a few microseconds, survives the end
//! of the process, and after a loss of power it may name an earlier transaction, never a later one than the disk has.

use super::location::make_private_file;
use super::schema::{identity, known_identity};
use super::session_store::StoreError;
use sha2::{Digest as _, Sha256};
use sqlx::{AnyConnection, AssertSqlSafe, Executor as _, Row as _};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

/// The file beside the database.
pub(super) const NOTE_FILE: &str = "sessions.newest";
/// What a note begins with.
const MARK: &str = "pliant-newest-1";
/// Numbers of transactions begin at one again after the last one.
const LAST: u32 = i32::MAX as u32;
/// A database that is further behind is taken for one that is ahead.
const FAR: u32 = LAST / 2;

/// What a note says.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Note {
    /// The database that it is about.
    identity: String,
    /// The newest transaction that was acknowledged.
    number: u32,
    /// Acknowledged transactions that are missing and not dealt with yet.
    lost: u32,
}

/// The note beside a database that is written.
#[derive(Debug)]
pub(super) struct NewestWrite {
    file: File,
    path: PathBuf,
    note: Note,
    /// Whether the last note could not be written.
    is_failing: bool,
}

impl NewestWrite {
    /// Compares a database that was just opened with the note in its folder, and goes on from there. What is missing is logged,
    /// and noted for `pliant store check`.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] where the note cannot be written, or the database not be read.
    pub async fn open(folder: &Path, connection: &mut AnyConnection) -> Result<Self, StoreError> {
        let path = folder.join(NOTE_FILE);
        let failed = |e: io::Error| StoreError::Unavailable(format!("{}: {e}", path.display()));
        let identity = identity(connection).await?;
        let found = number_of(connection).await?;
        let before = read_note(folder, &identity).map_err(failed)?;
        let missing = before.as_ref().map_or(0, |note| behind(found, note.number));
        let lost_before = before.as_ref().map_or(0, |note| note.lost);
        let note = Note {
            identity,
            // The numbers of what was lost are not given again.
            number: before.filter(|_| missing > 0).map_or(found, |note| note.number),
            lost: lost_before.saturating_add(missing),
        };
        if note.lost > 0 {
            tracing::error!("DATA_LOSS: {}", lost_text(folder, note.lost));
        }
        let file = make_private_file(&path).map_err(failed)?;
        let newest = Self {
            file,
            path: path.clone(),
            note,
            is_failing: false,
        };
        newest.write().and_then(|()| newest.file.sync_all()).map_err(failed)?;
        Ok(newest)
    }

    /// The number of the next transaction.
    pub fn next(&self) -> u32 {
        match self.note.number {
            LAST => 1,
            number => number + 1,
        }
    }

    /// Notes a transaction that is on disk. A failed note does not reject the transaction: the log warns that the next
    /// loss may go unseen.
    pub fn note(&mut self, number: u32) {
        self.note.number = number;
        let written = self.write();
        if let (Err(error), false) = (&written, self.is_failing) {
            tracing::warn!(
                "{} cannot be written: {error}; transactions that are lost from now on may not be noticed",
                self.path.display()
            );
        }
        self.is_failing = written.is_err();
    }

    fn write(&self) -> io::Result<()> {
        self.file.write_all_at(self.note.to_text().as_bytes(), 0)
    }
}

/// Returns what a database lacks that is only read; `None` where nothing is known to be missing.
///
/// # Errors
/// [`StoreError::Unavailable`] where note or database cannot be read.
pub(super) async fn find_lost_writes(
    folder: &Path,
    connection: &mut AnyConnection,
) -> Result<Option<String>, StoreError> {
    let Some(identity) = known_identity(connection).await? else {
        return Ok(None);
    };
    let failed = |e: io::Error| StoreError::Unavailable(format!("{}: {e}", folder.join(NOTE_FILE).display()));
    // A server may be writing: what is noted now is in the database when that is read after it.
    let Some(note) = read_note(folder, &identity).map_err(failed)? else {
        return Ok(None);
    };
    let lost = note
        .lost
        .saturating_add(behind(number_of(connection).await?, note.number));
    Ok((lost > 0).then(|| lost_text(folder, lost)))
}

/// Writes the number of a transaction into the database, as part of it.
pub(super) async fn number_transaction(connection: &mut AnyConnection, number: u32) -> Result<(), StoreError> {
    let statement = format!("PRAGMA user_version = {number}");
    let done = connection.execute(AssertSqlSafe(statement)).await;
    done.map(drop).map_err(|e| StoreError::Unavailable(e.to_string()))
}

async fn number_of(connection: &mut AnyConnection) -> Result<u32, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    let row = connection.fetch_one("PRAGMA user_version").await.map_err(failed)?;
    let number: i64 = row.try_get(0).map_err(failed)?;
    Ok(u32::try_from(number).unwrap_or(0))
}

/// How many transactions a database is behind its note.
fn behind(found: u32, noted: u32) -> u32 {
    let missing = match noted >= found {
        true => noted - found,
        false => LAST - (found - noted),
    };
    if missing > FAR { 0 } else { missing }
}

fn lost_text(folder: &Path, lost: u32) -> String {
    format!(
        "the database in {} lacks the newest {lost} transactions that were acknowledged: its log was damaged or removed, or an older \
         database was put in its place. Sessions are as they were before these. Restore a backup, or remove {} to accept the \
         loss; `pliant store check` fails until then",
        folder.display(),
        folder.join(NOTE_FILE).display()
    )
}

/// The note in a folder; `None` where there is none, or none about this database, or it is torn.
fn read_note(folder: &Path, identity: &str) -> io::Result<Option<Note>> {
    let text = match std::fs::read(folder.join(NOTE_FILE)) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    Ok(Note::from_text(&text).filter(|note| note.identity == identity))
}

impl Note {
    /// One line, always of the same length for one database, so that a new note covers the old one.
    fn to_text(&self) -> String {
        let Self { identity, number, lost } = self;
        let line = format!("{MARK} {identity} {number:010} {lost:010}");
        format!("{line} {}\n", checksum(&line))
    }

    fn from_text(text: &[u8]) -> Option<Self> {
        let line = str::from_utf8(text).ok()?.lines().next()?;
        let (line, sum) = line.rsplit_once(' ')?;
        let mut words = line.split(' ');
        if sum != checksum(line) || words.next() != Some(MARK) {
            return None;
        }
        let (identity, number, lost) = (words.next()?, words.next()?, words.next()?);
        Some(Self {
            identity: identity.to_owned(),
            number: number.parse().ok()?,
            lost: lost.parse().ok()?,
        })
    }
}

fn checksum(line: &str) -> String {
    Sha256::digest(line)[..8]
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_note_comes_back_and_a_torn_one_is_none(
            number in 0..=LAST,
            lost in any::<u32>(),
            at in 0usize..100,
            byte in any::<u8>(),
        ) {
            let note = Note { identity: "0f".repeat(16), number, lost };
            let text = note.to_text();
            prop_assert_eq!(Note::from_text(text.as_bytes()), Some(note.clone()));
            let mut torn = text.clone().into_bytes();
            let at = at % torn.len();
            torn[at] = byte;
            let read = Note::from_text(&torn);
            prop_assert!(read.is_none() || read == Some(note), "{:?}", String::from_utf8_lossy(&torn));
        }

        #[test]
        fn a_database_is_behind_by_what_it_lacks_and_never_when_it_is_ahead(noted in 1..=LAST, lost in 0u32..1000) {
            let before = |n: u32, by: u32| if n > by { n - by } else { LAST - (by - n) };
            prop_assert_eq!(behind(before(noted, lost), noted), lost);
            prop_assert_eq!(behind(noted, before(noted, lost)), 0);
        }
    }
}
