//! What commands share at a terminal: progress, JSON on stdout, signals that stop, and threads.
//!
//! Why a command ends badly, and with which exit code.

use crate::pool::Pool;
use crate::progress::{CancelFlag, Progress};
use crate::wire;
use crate::wire::Error as WireError;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::borrow::Cow;
use std::io::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Prints a line on stderr, with what would steer a terminal escaped. Unlike `eprintln!` it goes on where nothing reads stderr
/// any more, such as `pliant … 2>&1 | head`: the work matters, not its report.
macro_rules! say {
    ($($part:tt)*) => { $crate::cli::terminal::report(&format!($($part)*)) };
}
/// Prints a line on stdout, as [`print_text`] does.
macro_rules! list {
    ($($part:tt)*) => { $crate::cli::terminal::print_text(&(format!($($part)*) + "\n")) };
}
pub(super) use {list, say};

/// Time between two frames of the spinner, which turns without progress too.
const TICK: Duration = Duration::from_millis(100);

/// Time between two plain lines of one stage.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// How progress is shown on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ProgressChoice {
    /// One line at a terminal, drawn again and again; nothing elsewhere, and nothing with --json
    Auto,
    /// A line for each stage, and another one every five seconds
    Plain,
    /// Nothing
    None,
}

/// Shows how far work is.
pub(super) struct ProgressDisplay {
    /// Hidden where nothing is drawn.
    bar: ProgressBar,
    lines: Option<PlainLines>,
}

/// Lines on stderr that stay.
struct PlainLines {
    begun: Instant,
    /// The stage of the last line, and when it was printed.
    last: Mutex<Option<(&'static str, Instant)>>,
}

impl ProgressDisplay {
    fn new(choice: ProgressChoice, quiet: bool, bar: ProgressBar, template: &str) -> Self {
        // indicatif draws nothing when stderr is not a terminal.
        let is_drawn = choice == ProgressChoice::Auto && !quiet;
        let bar = if is_drawn { bar } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        let lines = (choice == ProgressChoice::Plain).then(|| PlainLines {
            begun: Instant::now(),
            last: Mutex::default(),
        });
        Self { bar, lines }
    }

    /// Whether nothing is shown.
    pub fn is_hidden(&self) -> bool {
        self.lines.is_none() && (self.bar.is_hidden() || self.bar.is_finished())
    }

    /// Shows what is done at a stage, whose bar is at `position`.
    pub fn show(&self, stage: &'static str, position: u64, text: String) {
        match &self.lines {
            None => {
                self.bar.set_position(position);
                self.bar.set_message(text);
            }
            Some(lines) => lines.show(stage, &text),
        }
    }

    /// Takes what is drawn off the terminal.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for ProgressDisplay {
    fn drop(&mut self) {
        self.finish();
    }
}

impl PlainLines {
    fn show(&self, stage: &'static str, text: &str) {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let is_due = |(before, at): (&str, Instant)| before != stage || at.elapsed() >= BETWEEN_LINES;
        if last.is_none_or(is_due) {
            *last = Some((stage, Instant::now()));
            say!("pliant: {text} ({} s)", self.begun.elapsed().as_secs());
        }
    }
}

/// Shows the stage under way.
pub(super) struct StageSpinner(ProgressDisplay);

impl StageSpinner {
    /// Takes the spinner off the terminal.
    pub fn finish(&self) {
        self.0.finish();
    }
}

impl Progress for StageSpinner {
    fn report(&self, stage: &'static str, fraction: f32) {
        self.0.show(stage, 0, stage_text(stage, fraction));
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

/// Whether this process has printed its document, or a part of it.
static IS_PRINTED: AtomicBool = AtomicBool::new(false);

/// Prints one JSON document on stdout.
pub(super) fn print_json<M: prost::Message + prost::Name>(message: &M) -> Result<(), CliFailure> {
    print_value(&wire::json::to_json(message)?)
}

/// Prints one value on stdout.
pub(super) fn print_value(value: &serde_json::Value) -> Result<(), CliFailure> {
    print_text(&pretty_text(value)?)
}

/// A document as people read it, with the end of its last line.
pub(super) fn pretty_text(value: &serde_json::Value) -> Result<String, CliFailure> {
    let text = serde_json::to_string_pretty(value).map_err(|e| CliFailure::Internal(e.to_string()))?;
    Ok(text + "\n")
}

/// Prints the text of one document on stdout, with what would steer a terminal escaped.
pub(super) fn print_text(text: &str) -> Result<(), CliFailure> {
    IS_PRINTED.store(true, Ordering::Relaxed);
    let mut stdout = std::io::stdout();
    let written = stdout
        .write_all(harmless(text).as_bytes())
        .and_then(|()| stdout.flush());
    printed(written)
}

/// Whether printing on stdout succeeded. A reader that has left, as in `pliant … --json | head`, is not a failure.
pub(super) fn printed(written: std::io::Result<()>) -> Result<(), CliFailure> {
    match written {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(CliFailure::Internal(format!("cannot write to stdout: {e}")))
        }
        _ => Ok(()),
    }
}

/// Writes a line to stderr, if something reads it.
pub(super) fn report(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", harmless(text));
}

/// Text with the characters that steer a terminal, or turn the direction of what follows, escaped as JSON does: names come from files.
pub(super) fn harmless(text: &str) -> Cow<'_, str> {
    let steers = |c: char| {
        let turns = matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        turns || (c.is_control() && !matches!(c, '\n' | '\t'))
    };
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let each = |out: String, c: char| match steers(c) {
        true => out + &format!("\\u{:04x}", u32::from(c)),
        false => out + c.encode_utf8(&mut [0; 4]),
    };
    Cow::Owned(text.chars().fold(String::new(), each))
}

/// Runs a command that waits to its end, on this thread.
pub(super) fn block_on<T>(command: impl Future<Output = T>) -> Result<T, CliFailure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|e| CliFailure::Internal(format!("cannot start threads: {e}")))?;
    Ok(runtime.block_on(command))
}

/// Prints a command's failure as its JSON document, with `--json` and where none was printed; a failed check has
/// printed one.
fn print_failure(failure: &CliFailure) {
    let is_asked = std::env::args_os().skip(1).any(|argument| argument == "--json");
    if !is_asked || IS_PRINTED.load(Ordering::Relaxed) {
        return;
    }
    let error = json!({"kind": failure.kind(), "exitCode": failure.exit_code(), "message": failure.message()});
    // The last line of stderr says it too, and the exit code.
    let _ = print_value(&json!({ "error": error }));
}

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

/// How a command computes, and shows how far it is.
#[derive(Debug, Args)]
pub(super) struct ComputeArgs {
    #[command(flatten)]
    pub threads: ThreadArgs,
    /// How progress is shown on stderr
    #[arg(long, env = "PLIANT_PROGRESS", value_enum, default_value_t = ProgressChoice::Auto)]
    progress: ProgressChoice,
}

impl ComputeArgs {
    /// Starts to show stages; where `quiet`, only as lines.
    pub fn show_stages(&self, quiet: bool) -> StageSpinner {
        let template = "{spinner} {msg} ({elapsed})";
        let display = ProgressDisplay::new(self.progress, quiet, ProgressBar::new_spinner(), template);
        if !display.bar.is_hidden() {
            display.bar.enable_steady_tick(TICK);
        }
        StageSpinner(display)
    }

    /// Starts a bar of so many parts; where `quiet`, only lines.
    pub fn show_parts(&self, quiet: bool, parts: u64) -> ProgressDisplay {
        ProgressDisplay::new(self.progress, quiet, ProgressBar::new(parts), "{wide_bar} {msg}")
    }
}

/// The thread budget of commands that compute in process.
#[derive(Debug, Args)]
pub(super) struct ThreadArgs {
    /// Compute threads; 0 means one per core
    #[arg(long, env = "PLIANT_THREADS", default_value_t = 0)]
    threads: usize,
}

impl ThreadArgs {
    /// Starts the pool that the arguments ask for.
    pub fn start_pool(&self) -> Result<Pool, CliFailure> {
        if self.threads > 1024 {
            return Err(CliFailure::Input(format!(
                "--threads is {}, allowed are 0 to 1024",
                self.threads
            )));
        }
        Pool::new(self.threads).map_err(|e| CliFailure::Internal(e.to_string()))
    }
}

/// The number of an option, or its default, if it is one of those that are allowed.
pub(super) fn bounded(
    option: &str,
    given: Option<usize>,
    usual: usize,
    allowed: RangeInclusive<usize>,
) -> Result<usize, CliFailure> {
    let number = given.unwrap_or(usual);
    if allowed.contains(&number) {
        return Ok(number);
    }
    let (least, most) = (allowed.start(), allowed.end());
    let problem = format!("{option} is {number}, allowed are {least} to {most}");
    Err(CliFailure::Input(problem))
}

/// Most names that a refusal lists.
const LISTED: usize = 40;

/// The names that there are, for a refusal; `elsewhere` says where the others are listed.
pub(super) fn listed<T: ToString>(names: impl ExactSizeIterator<Item = T>, elsewhere: &str) -> String {
    let more = match names.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more{elsewhere}"),
    };
    let listed: Vec<String> = names.take(LISTED).map(|name| name.to_string()).collect();
    format!("there are {}{more}", listed.join(", "))
}

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

    /// Says why a command has failed: on stdout too where `--json` asks for a document, and in the last line of stderr.
    pub(super) fn report_and_exit(&self) -> ExitCode {
        print_failure(self);
        if !matches!(self, Self::Logged(_)) {
            say!("pliant: {}", self.message());
        }
        ExitCode::from(self.exit_code())
    }

    /// The failure to write a file.
    pub(super) fn unwritable(path: &Path, problem: impl std::fmt::Display) -> Self {
        Self::Input(format!("cannot write {}: {problem}", path.display()))
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

impl From<WireError> for CliFailure {
    fn from(e: WireError) -> Self {
        match e {
            WireError::Internal(_) => Self::Internal(e.to_string()),
            WireError::Cancelled => Self::Stopped(e.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_steer_a_terminal_is_escaped() {
        assert_eq!(harmless("größe\t\n"), "größe\t\n");
        assert_eq!(
            harmless("a\u{1b}[2J\u{7}\r\u{7f}\u{9b}31m\u{202e}b"),
            r"a\u001b[2J\u0007\u000d\u007f\u009b31m\u202eb"
        );
        // A document says the same as before.
        let document = json!({"name": "\u{9b}\u{1b}"});
        let text = pretty_text(&document).expect("text");
        let read: serde_json::Value = serde_json::from_str(&harmless(&text)).expect("JSON");
        assert_eq!(read, document);
    }

    #[test]
    fn stages_say_how_far_they_are() {
        assert_eq!(stage_text("graph", 0.0), "graph");
        assert_eq!(stage_text("graph", 0.5), "graph 50 %");
        assert_eq!(stage_text("graph", 7.0), "graph 100 %");
        assert_eq!(stage_text("graph", f32::NAN), "graph");
    }
}
