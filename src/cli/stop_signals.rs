//! The wishes of a person or a supervisor to stop: SIGINT, which Ctrl-C sends, and SIGTERM.

use super::failure::CliFailure;
use crate::progress::CancelFlag;
use std::sync::Arc;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Waits for signals that ask to stop.
pub(super) struct StopSignals {
    terminate: Signal,
    interrupt: Signal,
}

impl StopSignals {
    /// Takes the signals over: they no longer end the process.
    pub(super) fn new() -> std::io::Result<Self> {
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    /// Waits for the next one.
    pub(super) async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

/// A flag that is raised when the process is asked to stop, from now on until its end.
pub(super) fn raised_on_stop() -> Result<Arc<CancelFlag>, CliFailure> {
    let flag = Arc::new(CancelFlag::default());
    let raised = Arc::clone(&flag);
    let failed = |e: std::io::Error| CliFailure::Internal(format!("cannot wait for signals: {e}"));
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()
        .map_err(failed)?;
    let mut signals = {
        let _inside = runtime.enter();
        StopSignals::new().map_err(failed)?
    };
    let wait = move || {
        runtime.block_on(signals.next());
        raised.cancel();
    };
    std::thread::Builder::new()
        .name("pliant-signals".into())
        .spawn(wait)
        .map_err(failed)?;
    Ok(flag)
}
