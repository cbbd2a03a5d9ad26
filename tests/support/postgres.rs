//! A server of PostgreSQL that tests start as an ordinary user, where Debian's package `postgresql` is installed.

use super::server::retried_here;
use sqlx::{AnyConnection, AssertSqlSafe, Connection as _};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::unix::OwnedReadHalf;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::watch;

/// A server of databases. Dropping it stops it.
pub struct PostgresServer {
    programs: PathBuf,
    folder: TempDir,
    process: Mutex<Option<Child>>,
    databases: AtomicU32,
}

/// A database of a running server.
#[derive(Clone)]
pub struct TestDatabase {
    pub server: Arc<PostgresServer>,
    pub url: String,
    pub name: String,
}

/// The newest installed version; reports when there is none.
fn programs() -> Option<PathBuf> {
    let versions = fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut found: Vec<(u32, PathBuf)> = versions
        .filter_map(|v| Some((v.file_name().to_str()?.parse().ok()?, v.path().join("bin"))))
        .filter(|(_, bin)| bin.join("initdb").exists() && bin.join("postgres").exists())
        .collect();
    found.sort();
    let found = found.pop().map(|(_, bin)| bin);
    if found.is_none() {
        println!("SKIPPED: PostgreSQL is not installed (apt-get install postgresql); sessions were not kept in it");
    }
    found
}

/// A command as somebody whom the server of databases accepts: it refuses to run as root.
fn ordinary(program: &Path) -> Command {
    if !is_root() {
        return Command::new(program);
    }
    let mut command = Command::new("setpriv");
    command.args(["--reuid=nobody", "--regid=nogroup", "--clear-groups", "--"]);
    command.arg(program);
    command
}

fn is_root() -> bool {
    let id = Command::new("id").arg("-u").output();
    id.is_ok_and(|id| id.stdout.trim_ascii() == b"0")
}

impl PostgresServer {
    /// A server of its own; `None` where there is none to start.
    pub fn start() -> Option<Arc<Self>> {
        let programs = programs()?;
        let folder = tempfile::tempdir().expect("a folder");
        if is_root() {
            let owned = Command::new("chown").arg("nobody:nogroup").arg(folder.path()).status();
            assert!(owned.expect("chown runs").success());
        }
        let made = ordinary(&programs.join("initdb"))
            .args([
                "--no-sync",
                "--auth=trust",
                "--username=pliant",
                "--encoding=UTF8",
                "--locale=C",
                "-D",
            ])
            .arg(folder.path().join("data"))
            .current_dir("/")
            .output()
            .expect("initdb runs");
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let server = Arc::new(Self {
            programs,
            folder,
            process: Mutex::default(),
            databases: AtomicU32::new(0),
        });
        server.go_on();
        Some(server)
    }

    /// The server that tests share while any of them runs.
    pub fn shared() -> Option<Arc<Self>> {
        static SHARED: Mutex<Weak<PostgresServer>> = Mutex::new(Weak::new());
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(server) = shared.upgrade() {
            return Some(server);
        }
        let server = Self::start()?;
        *shared = Arc::downgrade(&server);
        Some(server)
    }

    /// The folder of its socket.
    pub fn socket(&self) -> &Path {
        self.folder.path()
    }

    /// Starts the process, and waits until it answers.
    pub fn go_on(&self) {
        let log = fs::File::create(self.folder.path().join("log")).expect("a log");
        let process = ordinary(&self.programs.join("postgres"))
            .arg("-D")
            .arg(self.folder.path().join("data"))
            .arg("-k")
            .arg(self.folder.path())
            .args([
                "-c",
                "listen_addresses=",
                "-c",
                "max_connections=200",
                "-c",
                "shared_buffers=16MB",
            ])
            .current_dir("/")
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("postgres starts");
        *self.process.lock().expect("no panic") = Some(process);
        let ready = retried_here(Duration::from_secs(60), || {
            let asked = Command::new(self.programs.join("pg_isready"))
                .arg("-h")
                .arg(self.folder.path())
                .stdout(Stdio::null())
                .status();
            asked.is_ok_and(|status| status.success()).then_some(())
        });
        let log = fs::read_to_string(self.folder.path().join("log"));
        assert!(ready.is_some(), "{}", log.unwrap_or_default());
    }

    /// Ends the process as a crash does: no client is notified, nothing is written.
    pub fn crash(&self) {
        self.end("-QUIT");
    }

    fn end(&self, signal: &str) {
        let Some(mut process) = self.process.lock().unwrap_or_else(PoisonError::into_inner).take() else {
            return;
        };
        let _ = Command::new("kill").args([signal, &process.id().to_string()]).status();
        retried_here(Duration::from_secs(20), || process.try_wait().transpose());
        let _ = process.kill();
        let _ = process.wait();
    }

    fn url_of(&self, database: &str, socket: &Path) -> String {
        format!("postgres://pliant@localhost/{database}?host={}", socket.display())
    }

    /// A new database.
    pub async fn database(self: &Arc<Self>) -> TestDatabase {
        let name = format!("d{}", self.databases.fetch_add(1, Relaxed));
        sqlx::any::install_default_drivers();
        let url = self.url_of("postgres", self.socket());
        let mut connection = AnyConnection::connect(&url).await.expect("a connection");
        let create = format!("CREATE DATABASE {name}");
        sqlx::query(AssertSqlSafe(create))
            .execute(&mut connection)
            .await
            .expect("a database");
        connection.close().await.expect("closed");
        TestDatabase {
            server: Arc::clone(self),
            url: self.url_of(&name, self.socket()),
            name,
        }
    }
}

impl TestDatabase {
    /// The database, reached through another socket.
    pub fn through(&self, socket: &Path) -> String {
        self.server.url_of(&self.name, socket)
    }
}

impl Drop for PostgresServer {
    fn drop(&mut self) {
        self.end("-INT");
    }
}

/// The socket's name in its folder, by which clients find it.
const SOCKET: &str = ".s.PGSQL.5432";

/// A socket before a server. It goes with the test.
pub struct PostgresProxy {
    folder: TempDir,
    cut: Arc<Mutex<PlannedCut>>,
    silent: watch::Sender<bool>,
}

#[derive(Default)]
struct PlannedCut {
    /// Messages of the connection that writes until it breaks off; none: it never does.
    after: Option<u32>,
    process: Option<u32>,
}

impl PostgresProxy {
    /// Serves the socket.
    pub fn serve(database: &TestDatabase) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let listener = UnixListener::bind(folder.path().join(SOCKET)).expect("a socket");
        let cut = Arc::new(Mutex::new(PlannedCut::default()));
        let (silent, is_silent) = watch::channel(false);
        let (behind, planned) = (database.server.socket().join(SOCKET), Arc::clone(&cut));
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let forwarded = forward(client, behind.clone(), Arc::clone(&planned), is_silent.clone());
                tokio::spawn(forwarded);
            }
        });
        Self { folder, cut, silent }
    }

    /// The folder of the socket.
    pub fn socket(&self) -> &Path {
        self.folder.path()
    }

    /// Whether nothing that clients say goes on to the server. Connections stay.
    pub fn set_silent(&self, is_silent: bool) {
        self.silent.send_replace(is_silent);
    }

    /// Breaks off after so many messages from now on, and ends a process first, if one is given.
    pub fn cut_after(&self, messages: u32, process: Option<u32>) {
        *self.cut.lock().expect("no panic") = PlannedCut {
            after: Some(messages),
            process,
        };
    }

    /// Takes the plan back; false when it was carried out.
    pub fn take_back(&self) -> bool {
        self.cut.lock().expect("no panic").after.take().is_some()
    }
}

/// One message of a client, whole; the first ones have no letter.
async fn message(from: &mut OwnedReadHalf, has_letter: bool) -> std::io::Result<Vec<u8>> {
    let head = 4 + usize::from(has_letter);
    let mut message = vec![0; head];
    from.read_exact(&mut message).await?;
    let length = u32::from_be_bytes(message[head - 4..].try_into().expect("four bytes"));
    message.resize(length as usize + head - 4, 0);
    from.read_exact(&mut message[head..]).await?;
    Ok(message)
}

async fn forward(
    client: UnixStream,
    behind: PathBuf,
    cut: Arc<Mutex<PlannedCut>>,
    mut silent: watch::Receiver<bool>,
) -> std::io::Result<()> {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_server, mut to_server) = UnixStream::connect(behind).await?.into_split();
    let answers = tokio::spawn(async move { tokio::io::copy(&mut from_server, &mut to_client).await });
    let (mut has_letter, mut writes) = (false, false);
    while let Ok(message) = message(&mut from_client, has_letter).await {
        // Protocol 3.0; what comes before asks for encryption.
        has_letter = has_letter || message[4..8] == [0, 3, 0, 0];
        writes = writes || message.windows(11).any(|w| w == b"pg_try_advi");
        let _ = silent.wait_for(|is_silent| !is_silent).await;
        to_server.write_all(&message).await?;
        let is_cut = {
            let mut planned = cut.lock().expect("no panic");
            let left = planned.after.filter(|_| writes).map(|n| n - 1);
            planned.after = left.or(planned.after).filter(|n| *n > 0);
            left == Some(0)
        };
        if is_cut {
            let process = cut.lock().expect("no panic").process.take();
            if let Some(process) = process {
                let ended = std::process::Command::new("kill")
                    .args(["-KILL", &process.to_string()])
                    .status();
                assert!(ended.expect("kill runs").success());
            }
            answers.abort();
            return Ok(());
        }
    }
    answers.abort();
    Ok(())
}
