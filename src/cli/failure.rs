//! Why a command ends badly, and with which exit code.

use crate::wire::Error as WireError;
use std::process::ExitCode;

/// Why a command ends with something other than 0.
#[derive(Debug)]
pub enum CliFailure {
    /// A check did not hold: exit code 1.
    Check(String),
    /// Bad input or usage: exit code 2.
    Input(String),
    /// A defect or a broken machine: exit code 3.
    Internal(String),
    /// A signal asked the command to stop: exit code 130, as shells have it for SIGINT.
    Stopped(String),
    /// Logged already; with its exit code.
    Logged(u8),
}

impl CliFailure {
    pub(super) fn exit_code(&self) -> u8 {
        match self {
            Self::Check(_) => 1,
            Self::Input(_) => 2,
            Self::Internal(_) => 3,
            Self::Stopped(_) => 130,
            Self::Logged(code) => *code,
        }
    }

    /// What the exit code means, for programs.
    pub(super) fn kind(&self) -> &'static str {
        match self.exit_code() {
            1 => "check",
            2 => "input",
            130 => "stopped",
            _ => "internal",
        }
    }

    /// Says why in the last line of stderr.
    pub(super) fn report_and_exit(&self) -> ExitCode {
        if !matches!(self, Self::Logged(_)) {
            eprintln!("pliant: {}", self.message());
        }
        ExitCode::from(self.exit_code())
    }

    /// The same failure, with the place of the mistake in the input.
    pub(super) fn in_place(self, place: impl std::fmt::Display) -> Self {
        match self {
            Self::Input(text) => Self::Input(format!("{place}: {text}")),
            other => other,
        }
    }

    /// What went wrong, in words.
    pub(super) fn message(&self) -> &str {
        match self {
            Self::Check(text) | Self::Input(text) | Self::Internal(text) | Self::Stopped(text) => text,
            Self::Logged(_) => "the log says why",
        }
    }
}

impl From<crate::engine::Error> for CliFailure {
    fn from(e: crate::engine::Error) -> Self {
        WireError::from(e).into()
    }
}

impl From<WireError> for CliFailure {
    fn from(e: WireError) -> Self {
        match e {
            WireError::Internal(_) => Self::Internal(e.to_string()),
            WireError::Cancelled => Self::Stopped(e.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}
