//! A socket before a server of PostgreSQL that breaks off the connection that writes after any of its messages.

use super::postgres::TestDatabase;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::unix::OwnedReadHalf;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::watch;

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
