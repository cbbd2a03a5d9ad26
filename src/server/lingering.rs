//! Sockets that are read for a while after their end. A peer that still sends when its connection is closed gets a
//! reset, which discards the last answer; so what it sends is read and dropped until it has the answer.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, ReadBuf};

/// How long a socket is read on at most.
const LINGER: Duration = Duration::from_secs(2);
/// How many bytes of it at most.
const MOST: u64 = 64 << 20;

/// Whether a socket is to be read on after its end; travels with the requests that come by it.
#[derive(Debug, Clone, Default)]
pub(super) struct Linger(Arc<AtomicBool>);

impl Linger {
    /// Has the socket read on after its end.
    pub fn ask(&self) {
        self.0.store(true, Relaxed);
    }
}

/// A socket that is read on after its end where somebody has asked for that.
pub(super) struct LingeringSocket<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> {
    socket: Option<S>,
    linger: Linger,
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> LingeringSocket<S> {
    /// Wraps a socket.
    pub fn new(socket: S, linger: Linger) -> Self {
        let socket = Some(socket);
        Self { socket, linger }
    }

    /// The socket; it is there until this is dropped.
    fn socket(&mut self) -> io::Result<Pin<&mut S>> {
        let gone = || io::Error::from(io::ErrorKind::NotConnected);
        self.socket.as_mut().map(Pin::new).ok_or_else(gone)
    }
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> Drop for LingeringSocket<S> {
    fn drop(&mut self) {
        let (Some(mut socket), true) = (self.socket.take(), self.linger.0.load(Relaxed)) else {
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

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> AsyncRead for LingeringSocket<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.socket()?.poll_read(cx, buffer)
    }
}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + 'static> AsyncWrite for LingeringSocket<S> {
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
