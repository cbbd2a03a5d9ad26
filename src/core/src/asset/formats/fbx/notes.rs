//! Warnings about a translation.

/// Warnings, gathered while a file is translated.
#[derive(Default)]
pub(super) struct TranslationNotes {
    /// (code, message, place).
    pub warnings: Vec<(String, String, String)>,
    /// What the file has and glTF cannot express, or is not used, each once.
    left_out: Vec<&'static str>,
}

impl TranslationNotes {
    pub(super) fn warn(&mut self, code: &str, message: impl Into<String>, place: impl Into<String>) {
        self.warnings.push((code.into(), message.into(), place.into()));
    }

    /// Notes a kind of thing that does not come along.
    pub(super) fn leave_out(&mut self, what: &'static str) {
        if !self.left_out.contains(&what) {
            self.left_out.push(what);
        }
    }

    /// All warnings, the last of which says what does not come along.
    pub(super) fn finish(mut self) -> Vec<(String, String, String)> {
        if !self.left_out.is_empty() {
            let message = format!("not carried over: {}", self.left_out.join(", "));
            self.warn("fbx-left-out", message, "file");
        }
        self.warnings
    }
}
