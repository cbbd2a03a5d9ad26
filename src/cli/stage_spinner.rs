//! The stage under way, for people, on a terminal only.

use crate::progress::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;

/// Time between two frames of the spinner, which turns without progress too.
const TICK: Duration = Duration::from_millis(100);

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
        if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} ({elapsed})") {
            bar.set_style(style);
        }
        if !bar.is_hidden() {
            bar.enable_steady_tick(TICK);
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
    fn report(&self, stage: &'static str, fraction: f32) {
        self.0.set_message(stage_text(stage, fraction));
    }
}

/// A stage's text, with its percentage once that is above 0.
fn stage_text(stage: &str, fraction: f32) -> String {
    let percent = (f64::from(fraction).clamp(0.0, 1.0) * 100.0) as u32;
    match percent {
        0 => stage.to_owned(),
        percent => format!("{stage} {percent} %"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_tell_how_far_they_are() {
        assert_eq!(stage_text("graph", 0.0), "graph");
        assert_eq!(stage_text("graph", 0.5), "graph 50 %");
        assert_eq!(stage_text("graph", 7.0), "graph 100 %");
        assert_eq!(stage_text("graph", f32::NAN), "graph");
    }
}
