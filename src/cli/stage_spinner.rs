//! The stage under way, for people, on a terminal only.

use crate::progress::Progress;
use indicatif::{ProgressBar, ProgressStyle};

/// Shows the stage under way on stderr when that is a terminal; silent otherwise.
pub(super) struct StageSpinner(ProgressBar);

impl StageSpinner {
    /// Starts a spinner; a quiet one shows nothing.
    pub fn new(quiet: bool) -> Self {
        // indicatif draws nothing when stderr is not a terminal.
        let bar = if quiet {
            ProgressBar::hidden()
        } else {
            ProgressBar::new_spinner()
        };
        if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} {elapsed}") {
            bar.set_style(style);
        }
        Self(bar)
    }

    /// Takes the spinner off the terminal.
    pub fn finish(&self) {
        self.0.finish_and_clear();
    }
}

impl Drop for StageSpinner {
    fn drop(&mut self) {
        self.finish();
    }
}

impl Progress for StageSpinner {
    fn report(&self, stage: &'static str, _fraction: f32) {
        self.0.set_message(stage);
        self.0.tick();
    }
}
