//! Transactions of a database of SQL.

use super::connection::WritingConnection;
use super::database::{TransactionWriter, WriteFailure, Written};
use super::newest_write::{NewestWrite, number_transaction};
use super::session_store::StoreError;
use super::sql_nodes::note_loose;
use super::write_order::{UncertainCommits, WriteOrder, undo_uncertain};
use async_trait::async_trait;
use sqlx::{AnyConnection, Connection as _};
use std::time::Duration;

/// Longest transaction. A disk that takes longer does not answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// The connection that writes.
#[derive(Debug)]
pub(super) struct SqlWriter {
    pub connection: WritingConnection,
    /// How far a file has been written.
    pub newest: Option<NewestWrite>,
}

#[async_trait]
impl TransactionWriter for SqlWriter {
    async fn write(
        &mut self,
        uncertain: &UncertainCommits,
        orders: &[&WriteOrder],
    ) -> Result<Vec<Written>, WriteFailure> {
        let is_shared = self.connection.is_shared();
        let connection = self.connection.get().await.map_err(StoreError::from);
        let connection = connection.map_err(WriteFailure::NoConnection)?;
        let number = self.newest.as_ref().map(NewestWrite::next);
        let transaction = write_together(connection, uncertain, number, orders, is_shared);
        let late = |_| StoreError::Unavailable(format!("it took longer than {PATIENCE:?}"));
        let written = tokio::time::timeout(PATIENCE, transaction).await;
        let answers = written
            .map_err(late)
            .and_then(|answers| answers)
            .map_err(WriteFailure::Transaction)?;
        if let (Some(newest), Some(number)) = (&mut self.newest, number) {
            newest.note(number);
        }
        Ok(answers)
    }

    async fn finish(&mut self) {
        self.connection.finish().await;
    }

    async fn give_up(&mut self) {
        self.connection.give_up().await;
    }
}

/// Writes orders in one transaction, after what is to be removed, and its number.
async fn write_together(
    connection: &mut AnyConnection,
    uncertain: &UncertainCommits,
    number: Option<u32>,
    orders: &[&WriteOrder],
    is_shared: bool,
) -> Result<Vec<Written>, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    let mut transaction = connection.begin().await.map_err(failed)?;
    for doubt in uncertain.values() {
        undo_uncertain(doubt, &mut transaction).await?;
    }
    let mut answers = Vec::with_capacity(orders.len());
    for order in orders {
        answers.push(match order.carry_out(&mut transaction).await {
            Ok(mut unnamed) => {
                // Another node may be about to name them again: they go when no node has for long.
                if is_shared {
                    for object in std::mem::take(&mut unnamed) {
                        note_loose(&object, &mut *transaction).await?;
                    }
                }
                Ok(unnamed)
            }
            // Those have written nothing, and are no reason to take back what others have.
            Err(error @ (StoreError::Moved | StoreError::Repeated)) => Err(error),
            Err(error) => return Err(error),
        });
    }
    if let Some(number) = number {
        number_transaction(&mut transaction, number).await?;
    }
    transaction.commit().await.map_err(failed)?;
    Ok(answers)
}
