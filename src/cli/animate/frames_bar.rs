//! How far an animation is, for people, on a terminal only.

use crate::progress::{CancelFlag, Progress};
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Parts of a whole bar.
const WHOLE: u64 = 10_000;

/// Watches an animation: shows solved frames, frames a second and the time left on stderr when that is a terminal, and gives the work
/// up when its flag is raised.
pub(super) struct FramesBar {
    bar: ProgressBar,
    stop: Arc<CancelFlag>,
    begun: Instant,
    solved: AtomicUsize,
    frames: usize,
}

impl FramesBar {
    /// Starts a bar over so many frames; a quiet one shows nothing.
    pub(super) fn new(quiet: bool, frames: usize, stop: Arc<CancelFlag>) -> Self {
        // indicatif draws nothing when stderr is not a terminal.
        let bar = if quiet {
            ProgressBar::hidden()
        } else {
            ProgressBar::new(WHOLE)
        };
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {msg}") {
            bar.set_style(style);
        }
        Self {
            bar,
            stop,
            begun: Instant::now(),
            solved: AtomicUsize::new(0),
            frames,
        }
    }

    /// One more frame is solved.
    pub(super) fn step(&self) {
        self.solved.fetch_add(1, Ordering::Relaxed);
    }

    /// Takes the bar off the terminal.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for FramesBar {
    fn drop(&mut self) {
        self.finish();
    }
}

impl Progress for FramesBar {
    fn cancelled(&self) -> bool {
        self.stop.cancelled()
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        if stage != "frames" || self.bar.is_hidden() || self.bar.is_finished() {
            return;
        }
        let fraction = f64::from(fraction).clamp(0.0, 1.0);
        self.bar.set_position((fraction * WHOLE as f64) as u64);
        let solved = self.solved.load(Ordering::Relaxed);
        self.bar
            .set_message(bar_text([solved, self.frames], self.begun.elapsed(), fraction));
    }
}

/// What stands beside a bar. The time left follows from the share of the work that is done, frames that only lead to others
/// included, so that it is right before the first frame is there too.
fn bar_text([solved, frames]: [usize; 2], elapsed: Duration, fraction: f64) -> String {
    let mut text = format!("{solved} of {frames} frames");
    if solved > 0 {
        text += &format!(", {:.1}/s", solved as f64 / elapsed.as_secs_f64().max(1e-3));
    }
    if fraction > 0.0 {
        let left = (elapsed.as_secs_f64() * (1.0 - fraction) / fraction).round() as u64;
        text += &match [left / 3600, left / 60 % 60, left % 60] {
            [0, 0, seconds] => format!(", {seconds}s left"),
            [0, minutes, seconds] => format!(", {minutes}m {seconds}s left"),
            [hours, minutes, _] => format!(", {hours}h {minutes}m left"),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_follows_from_the_work_that_is_done() {
        let text = |solved: usize, seconds: u64, fraction: f64| {
            bar_text([solved, 300], Duration::from_secs(seconds), fraction)
        };
        assert_eq!(text(0, 0, 0.0), "0 of 300 frames");
        assert_eq!(text(0, 2, 0.1), "0 of 300 frames, 18s left");
        assert_eq!(text(90, 10, 0.25), "90 of 300 frames, 9.0/s, 30s left");
        assert_eq!(text(1, 10, 0.1), "1 of 300 frames, 0.1/s, 1m 30s left");
        assert_eq!(text(1, 100, 0.01), "1 of 300 frames, 0.0/s, 2h 45m left");
    }
}
