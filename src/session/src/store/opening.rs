//! How a store is opened: by one process that has it for itself, or by one of several nodes that share it.

use super::build_identity;
use super::connection::{DatabaseAddress, SharingNode, WritingConnection, release_exclusive, take_exclusive};
use super::database::SessionTables;
use super::database_store::{Store, StoreWriting};
use super::location::{
    DATABASE_FILE, FolderHold, StoreLocation, existing_database, make_private_file, refuse_objects_alone,
};
use super::newest_write::NewestWrite;
use super::objects::Objects;
use super::schema::{Dialect, TABLES, any_object, identity, migrate, version};
use super::session_store::{NodeIdentity, NodeLoad, StoreError};
use super::shared_store::SharedStore;
use super::sql_nodes::SqlNodes;
use super::sql_reading::SqlTables;
use super::transaction::SqlWriter;
use super::write_order::WriteOrder;
use super::writer::{StoreHealth, Writer};
use crate::surroundings::RealSurroundings;
use sqlx::AnyConnection;
use std::path::PathBuf;
use std::sync::atomic::AtomicI64;
use std::sync::{Arc, Weak};
use std::time::Duration;

impl Store {
    /// Opens a store, makes or brings up to date what is missing.
    ///
    /// # Errors
    /// [`StoreError::Refused`] when another process has it, a later version wrote it or objects are there without their database,
    /// [`StoreError::Unavailable`] when folder or database cannot be had.
    pub async fn open(location: &StoreLocation) -> Result<Self, StoreError> {
        if let Some(node) = &location.node {
            return Self::open_shared(location, node).await;
        }
        let hold = location.data_dir.as_deref().map(FolderHold::alone).transpose()?;
        if let (Some(folder), None) = (&location.data_dir, &location.database) {
            refuse_objects_alone(folder)?;
            let file = folder.join(DATABASE_FILE);
            // The folder of objects is made before anything is written into the file: without it the models would be missing.
            if location.objects.is_none() && file.metadata().is_ok_and(|facts| facts.len() > 0) {
                Objects::in_folder_to_read(folder)?;
            }
            make_private_file(&file).map_err(|e| StoreError::Unavailable(format!("{}: {e}", file.display())))?;
        }
        Self::open_held(location, hold, true).await
    }

    /// Opens a store that is there, to change it. Nothing is made where none is.
    ///
    /// # Errors
    /// As [`Store::open`]; [`StoreError::Refused`] where there is no store.
    pub async fn open_existing(location: &StoreLocation) -> Result<Self, StoreError> {
        if let (Some(folder), None) = (&location.data_dir, &location.database) {
            existing_database(folder)?;
        }
        let hold = location.data_dir.as_deref().filter(|folder| folder.is_dir());
        let hold = hold.map(FolderHold::alone).transpose()?;
        Self::open_held(location, hold, false).await
    }

    async fn open_held(location: &StoreLocation, hold: Option<FolderHold>, makes: bool) -> Result<Self, StoreError> {
        let nowhere =
            || StoreError::Refused("sessions need a data folder, or both a database and a place of objects".into());
        let folder = || location.data_dir.as_deref().ok_or_else(nowhere);
        let address = match &location.database {
            Some(url) => DatabaseAddress::server(url)?,
            None => DatabaseAddress::file(&folder()?.join(DATABASE_FILE))?,
        };
        let objects = match &location.objects {
            Some(url) => Objects::in_bucket(url)?,
            None if makes => Objects::in_folder(folder()?)?,
            None => Objects::in_folder_to_read(folder()?).and_then(|_| Objects::in_folder(folder()?))?,
        };
        let mut writing = WritingConnection::open(&address).await?;
        let connection = writing.get().await?;
        if version(connection, address.dialect()).await?.is_none() {
            if !makes {
                return Err(address.no_tables());
            }
            if objects.are_in_use().await? {
                return Err(address.objects_of_another());
            }
        }
        migrate(connection, address.dialect()).await?;
        mark_objects(connection, &address, &objects, location).await?;
        let newest = match address.dialect() {
            Dialect::Sqlite => Some(NewestWrite::open(folder()?, connection).await?),
            Dialect::Postgres => None,
        };
        let health = Arc::new(StoreHealth::of_places(places(location))?);
        let writing = StoreWriting {
            writer: Arc::new(Writer::start(
                Box::new(SqlWriter {
                    connection: writing,
                    newest,
                }),
                Arc::clone(&health),
            )),
            health,
            shared: None,
        };
        let tables = SqlTables {
            pool: address.readers().await?,
            dialect: address.dialect(),
        };
        Self::looked_after(location, writing, Arc::new(tables), Arc::new(objects), hold).await
    }

    /// Opens a store for one of several nodes.
    async fn open_shared(location: &StoreLocation, node: &NodeIdentity) -> Result<Self, StoreError> {
        let (Some(database), Some(objects)) = (&location.database, &location.objects) else {
            let text = "nodes share a database and a place of objects; set both database and objects";
            return Err(StoreError::Refused(text.into()));
        };
        let mut random = [0u8; 16];
        getrandom::fill(&mut random).map_err(|e| StoreError::Unavailable(format!("no random numbers: {e}")))?;
        let sharing = SharingNode {
            key: i64::from_be_bytes(*random.first_chunk().unwrap_or(&[0; 8])),
            patience: node.lease,
        };
        let address = DatabaseAddress::server(database)?.shared_by(sharing);
        let objects = Objects::in_bucket(objects)?;
        let open_lock = address.open_lock().await?;
        let mut writing = WritingConnection::open(&address).await?;
        let connection = writing.get().await?;
        prepare_tables(connection, &address, &objects).await?;
        mark_objects(connection, &address, &objects, location).await?;
        drop(open_lock);
        let id = random.map(|byte| format!("{byte:02x}")).concat();
        let health = Arc::new(StoreHealth::of_places([])?);
        let pool = address.readers().await?;
        let shared = SharedStore {
            node: node.clone(),
            id,
            tables: Arc::new(SqlNodes {
                heartbeat: address.heartbeat_pool().await?,
                pool: pool.clone(),
            }),
            lapses: AtomicI64::new(0),
            writer: Arc::new(Writer::start(
                Box::new(SqlWriter {
                    connection: writing,
                    newest: None,
                }),
                Arc::clone(&health),
            )),
            objects: Arc::new(objects),
            health,
        };
        shared.beat(NodeLoad::default()).await?;
        let tables = SqlTables {
            pool,
            dialect: address.dialect(),
        };
        let objects = Arc::clone(&shared.objects);
        let writing = StoreWriting {
            writer: Arc::clone(&shared.writer),
            health: Arc::clone(&shared.health),
            shared: Some(shared),
        };
        Self::looked_after(location, writing, Arc::new(tables), objects, None).await
    }

    /// The store, looked after for as long as it is open.
    async fn looked_after(
        location: &StoreLocation,
        writing: StoreWriting,
        tables: Arc<dyn SessionTables>,
        objects: Arc<Objects>,
        hold: Option<FolderHold>,
    ) -> Result<Self, StoreError> {
        let (writer, shelves) = (Arc::downgrade(&writing.writer), Arc::downgrade(&objects));
        tokio::spawn(watch_store(Arc::clone(&writing.health), writer, shelves));
        let store = Self {
            build: location.build.clone().unwrap_or_else(build_identity),
            tables,
            objects,
            writing: Some(writing),
            is_written: false,
            folder: location.data_dir.clone().filter(|_| location.database.is_none()),
            _hold: hold,
            faults: None,
            surroundings: Arc::new(RealSurroundings),
        };
        store.measure_objects().await?;
        Ok(store)
    }
}

/// The files and folders of a store, all of which have to stay where they are.
fn places(location: &StoreLocation) -> Vec<PathBuf> {
    let Some(folder) = &location.data_dir else {
        return Vec::new();
    };
    let database = location.database.is_none().then(|| folder.join(DATABASE_FILE));
    let objects = location.objects.is_none().then(|| folder.join("objects"));
    [Some(folder.clone()), database, objects]
        .into_iter()
        .flatten()
        .collect()
}

/// Makes the tables or brings them up to date, while no other node has the store open.
async fn prepare_tables(
    connection: &mut AnyConnection,
    address: &DatabaseAddress,
    objects: &Objects,
) -> Result<(), StoreError> {
    let there = version(connection, address.dialect()).await?;
    if there.is_some_and(|version| usize::try_from(version) == Ok(TABLES)) {
        return Ok(());
    }
    if !take_exclusive(connection).await? {
        let text = format!("{address:?} has tables of another version and nodes that use them; stop those nodes first");
        return Err(StoreError::Refused(text));
    }
    if there.is_none() && objects.are_in_use().await? {
        return Err(address.objects_of_another());
    }
    migrate(connection, address.dialect()).await?;
    release_exclusive(connection).await
}

/// Makes sure that a database and the place of its objects belong together. A place that knows no database is marked with this one,
/// unless the database names objects that are not there: then it is another place than the one that they were written to.
async fn mark_objects(
    connection: &mut AnyConnection,
    address: &DatabaseAddress,
    objects: &Objects,
    location: &StoreLocation,
) -> Result<(), StoreError> {
    let identity = identity(connection).await?;
    if objects.agree_with(&identity).await? {
        return Ok(());
    }
    if let Some(object) = any_object(connection).await?
        && !objects.has_object(&object).await?
    {
        let folder = location.data_dir.as_ref().map(|folder| folder.display().to_string());
        let place = location.objects.clone().or(folder).unwrap_or_default();
        return Err(StoreError::Refused(format!(
            "the sessions of {address:?} have their objects elsewhere than in {place}, which has not the mark of that database; name \
             the place that they were written to, or restore them there"
        )));
    }
    objects.belong_to(&identity).await
}

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
