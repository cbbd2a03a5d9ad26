//! Looks after the health of a store for as long as it is open.

use super::objects::Objects;
use super::store_health::StoreHealth;
use super::write_order::WriteOrder;
use super::writer::Writer;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Between two looks.
const PERIOD: Duration = Duration::from_secs(1);

/// Looks after the health of a store for as long as it is open.
pub(super) async fn watch_store(health: Arc<StoreHealth>, writer: Weak<Writer>, objects: Weak<Objects>) {
    loop {
        tokio::time::sleep(PERIOD).await;
        let (Some(writer), Some(objects)) = (writer.upgrade(), objects.upgrade()) else {
            return;
        };
        if health.note(health.check_places()).is_ok() && !health.takes_writes() && try_writing(&writer, &objects).await
        {
            health.recover();
        }
    }
}

/// Whether both a row and an object can be written.
async fn try_writing(writer: &Writer, objects: &Objects) -> bool {
    objects.try_writing().await.is_ok() && writer.write(WriteOrder::Touch).await.is_ok()
}
