//! A connection: its place among those that may be open, the client that its certificate names, and its socket.

use super::auth::Principal;
use std::collections::HashMap;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, ReadBuf};
use tokio::sync::OwnedSemaphorePermit;

/// The caller that the client's certificate names, if it names one; travels with each request of the connection.
#[derive(Debug, Clone)]
pub(super) struct CertificateCaller(pub Option<Principal>);

/// A connection's place among those that may be open, in all and of its peer; the connection holds it, and the WebSocket it becomes.
#[derive(Clone)]
pub(super) struct ConnectionSlot {
    _held: Arc<(OwnedSemaphorePermit, PeerSlot)>,
}

impl ConnectionSlot {
    /// Holds a place until the last clone is dropped.
    pub fn new(permit: OwnedSemaphorePermit, peer: PeerSlot) -> Self {
        Self {
            _held: Arc::new((permit, peer)),
        }
    }
}

/// How many connections each address has open. Cloning shares the count.
#[derive(Clone, Default)]
pub(super) struct Peers(Arc<Mutex<HashMap<IpAddr, u32>>>);

impl Peers {
    /// Counts one more connection of a peer; `None` where it has as many as are allowed.
    pub fn admit(&self, peer: IpAddr, most: u32) -> Option<PeerSlot> {
        let peer = peer.to_canonical();
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = open.entry(peer).or_insert(0);
        if *count >= most {
            return None;
        }
        *count += 1;
        Some(PeerSlot {
            peers: self.clone(),
            peer,
        })
    }
}

/// A connection of a peer; dropping it reduces the count.
pub(super) struct PeerSlot {
    peers: Peers,
    peer: IpAddr,
}

impl Drop for PeerSlot {
    fn drop(&mut self) {
        let mut open = self.peers.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = open.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.peer);
            }
        }
    }
}

/// How long a socket is read at most after its end.
const LINGER: Duration = Duration::from_secs(2);
/// How many bytes of it at most.
const MOST: u64 = 64 << 20;

/// Bytes of HTTP/2's preface. Until so many have come, only the server's header timeout watches the connection; afterwards
/// the protocol libraries do.
const PREFACE: usize = 24;

/// What is known of a socket; travels with the requests that come by it.
#[derive(Debug, Clone, Default)]
pub(super) struct SocketFlags(Arc<Flags>);

#[derive(Debug, Default)]
struct Flags {
    has_preface: AtomicBool,
    lingers: AtomicBool,
}

impl SocketFlags {
    /// Whether as many bytes have come as a preface has.
    pub fn has_preface(&self) -> bool {
        self.0.has_preface.load(Relaxed)
    }

    /// Makes the server read the socket for a while after its end.
    pub fn linger(&self) {
        self.0.lingers.store(true, Relaxed);
    }
}

/// A socket that notes when its peer has sent the beginning of a request, and that can be read for a while after its end.
///
/// The second is by hand because no library does it: a peer that still sends when its connection is closed gets a reset, which
/// discards the last answer. So the server reads and drops what the peer sends until it has the answer.
pub(super) struct ClientSocket<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> {
    socket: Option<S>,
    flags: SocketFlags,
    received: usize,
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> ClientSocket<S> {
    /// Wraps a socket.
    pub fn new(socket: S, flags: SocketFlags) -> Self {
        Self {
            socket: Some(socket),
            flags,
            received: 0,
        }
    }

    /// The socket; it is there until this is dropped.
    fn socket(&mut self) -> io::Result<Pin<&mut S>> {
        let gone = || io::Error::from(io::ErrorKind::NotConnected);
        self.socket.as_mut().map(Pin::new).ok_or_else(gone)
    }
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> Drop for ClientSocket<S> {
    fn drop(&mut self) {
        let (Some(mut socket), true) = (self.socket.take(), self.flags.0.lingers.load(Relaxed)) else {
            return;
        };
        let Ok(runtime) = tokio::runtime::Handle::try_current() else {
            return;
        };
        runtime.spawn(tokio::time::timeout(LINGER, async move {
            let _ = socket.shutdown().await;
            let _ = tokio::io::copy(&mut socket.take(MOST), &mut tokio::io::sink()).await;
        }));
    }
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> AsyncRead for ClientSocket<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = self.socket()?.poll_read(cx, buffer);
        if self.received < PREFACE {
            self.received += buffer.filled().len() - before;
            if self.received >= PREFACE {
                self.flags.0.has_preface.store(true, Relaxed);
            }
        }
        read
    }
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> AsyncWrite for ClientSocket<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.socket()?.poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.socket()?.poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.socket()?.poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.socket()?.poll_write_vectored(cx, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.as_ref().is_some_and(AsyncWrite::is_write_vectored)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_that_leaves_makes_room_and_is_forgotten() {
        let peers = Peers::default();
        let [here, mapped, other]: [IpAddr; 3] = ["127.0.0.1", "::ffff:127.0.0.1", "::1"].map(|a| a.parse().unwrap());
        let first = peers.admit(here, 2);
        let second = peers.admit(mapped, 2);
        assert!(first.is_some() && second.is_some() && peers.admit(here, 2).is_none());
        assert!(peers.admit(other, 2).is_some());
        drop(first);
        assert!(peers.admit(here, 2).is_some());
        drop(second);
        assert!(peers.0.lock().unwrap().is_empty());
    }
}
