//! How far an animation is, for people, on a terminal only.

use indicatif::{ProgressBar, ProgressStyle};

/// Shows frames, frames a second and the time left on stderr when that is a terminal; silent otherwise.
pub(super) struct FramesBar(ProgressBar);

impl FramesBar {
    /// Starts a bar over so many frames; a quiet one shows nothing.
    pub(super) fn new(quiet: bool, frames: usize) -> Self {
        // indicatif draws nothing when stderr is not a terminal.
        let bar = if quiet {
            ProgressBar::hidden()
        } else {
            ProgressBar::new(frames as u64)
        };
        let template = "{wide_bar} {pos} of {len} frames, {per_sec}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        Self(bar)
    }

    /// One more frame is done.
    pub(super) fn step(&self) {
        self.0.inc(1);
    }
}

impl Drop for FramesBar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
