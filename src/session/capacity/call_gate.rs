//! Counts open calls, so that a server that stops can wait for the last one.

use tokio::sync::watch;

/// Counts calls and streams under way.
#[derive(Debug)]
pub(in crate::session) struct CallGate(watch::Sender<usize>);

/// One call or stream under way.
#[derive(Debug)]
pub(in crate::session) struct CallGuard(watch::Sender<usize>);

impl CallGate {
    pub fn new() -> Self {
        Self(watch::Sender::new(0))
    }

    /// Counts one more until the guard is dropped.
    pub fn enter(&self) -> CallGuard {
        self.0.send_modify(|n| *n += 1);
        CallGuard(self.0.clone())
    }

    /// Waits until none is open.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn empty(&self) {
        // Fails only when the sender is gone, and it is `self`.
        let _ = self.0.subscribe().wait_for(|&n| n == 0).await;
    }
}

impl Drop for CallGuard {
    fn drop(&mut self) {
        self.0.send_modify(|n| *n = n.saturating_sub(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn empty_once_the_last_has_left() {
        let gate = CallGate::new();
        gate.empty().await;
        let (a, b) = (gate.enter(), gate.enter());
        drop(a);
        let wait = gate.empty();
        tokio::pin!(wait);
        assert!(futures::poll!(wait.as_mut()).is_pending());
        drop(b);
        wait.await;
    }
}
