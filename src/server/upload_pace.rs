//! How fast an upload must come. A peer that sends a byte now and then holds a connection and memory as one that sends nothing
//! does; so besides the longest silence there is a slowest mean rate, and a longest time for all of it.

use super::config::ServerConfig;
use crate::session::{Error, ErrorCode};
use std::time::Duration;
use tokio::time::Instant;

/// The clock of one upload.
#[derive(Debug)]
pub(super) struct UploadPace {
    begun: Instant,
    heard: Instant,
    bytes: u64,
    silence: Duration,
    rate: u64,
    whole: Duration,
}

impl UploadPace {
    /// Of an upload that begins now.
    pub fn new(config: &ServerConfig) -> Self {
        let now = Instant::now();
        Self {
            begun: now,
            heard: now,
            bytes: 0,
            silence: config.keepalive_interval + config.keepalive_timeout,
            rate: config.upload_rate,
            whole: config.upload_deadline,
        }
    }

    /// Counts bytes that came.
    pub fn take(&mut self, bytes: usize) {
        self.heard = Instant::now();
        self.bytes = self.bytes.saturating_add(bytes as u64);
    }

    /// When more must have come, at the latest.
    pub fn due(&self) -> Instant {
        (self.heard + self.silence)
            .min(self.too_slow_at())
            .min(self.begun + self.whole)
    }

    /// The error when nothing more came in time.
    pub fn late(&self) -> Error {
        let silent_at = self.heard + self.silence;
        let text = if self.due() == silent_at {
            format!("nothing more came for {}", humantime::format_duration(self.silence))
        } else if self.due() == self.begun + self.whole {
            let whole = humantime::format_duration(self.whole);
            format!("it took longer than {whole}; the key upload_deadline allows more")
        } else {
            format!(
                "it came slower than {} bytes a second; the key upload_rate allows less",
                self.rate
            )
        };
        Error::new(ErrorCode::DeadlineExceeded, format!("the upload is given up: {text}"))
    }

    /// When the mean rate falls below the slowest. The longest silence is granted on top, so that a slow beginning is none.
    fn too_slow_at(&self) -> Instant {
        let granted = Duration::from_secs_f64(self.bytes as f64 / self.rate.max(1) as f64);
        self.begun + self.silence + granted
    }
}
