//! Files that are followed while the server runs: its tokens, the keys that tokens are checked with, and its certificates.
//!
//! Their content is checked every second: a replaced file, a link that points elsewhere and a renewed certificate are
//! all noticed. An unreadable file changes nothing, and is logged once.

use super::config::{FileKeys, changed_keys, keys_of_file, tokens_of_file};
use super::state::ServerState;
use std::time::Duration;

/// The longest time until a change is noticed.
const PERIOD: Duration = Duration::from_secs(1);

/// Follows changes of files.
pub(super) async fn follow_files(state: ServerState) {
    let mut logged = Logged {
        keys: state.config.auth.file.as_deref().and_then(keys_of_file),
        ..Logged::default()
    };
    let mut known = state.config.auth.tokens.clone();
    loop {
        state.authenticator.follow_keys().await;
        tokio::time::sleep(PERIOD).await;
        if let Some(file) = state.config.auth.file.clone() {
            let read = move || (tokens_of_file(&file), keys_of_file(&file));
            let Ok((tokens, keys)) = tokio::task::spawn_blocking(read).await else {
                return;
            };
            logged.log_changed_keys(keys);
            match tokens {
                Ok(tokens) => {
                    logged.tokens = None;
                    if tokens != known {
                        tracing::info!(auth.tokens = tokens.len(), "the tokens have changed");
                        state.authenticator.replace_tokens(tokens.clone());
                        known = tokens;
                    }
                }
                Err(error) => log_once(&mut logged.tokens, "the tokens stay as they were", error.to_string()),
            }
        }
        if let Some(tls) = state.tls.clone() {
            let Ok(reloaded) = tokio::task::spawn_blocking(move || tls.reload()).await else {
                return;
            };
            if reloaded.has_changed {
                tracing::info!("the TLS certificates have changed");
            }
            match reloaded.problem {
                None => logged.certificates = None,
                Some(problem) => log_once(
                    &mut logged.certificates,
                    "what was read before of a TLS file stays in use",
                    problem,
                ),
            }
        }
    }
}

/// What was logged last, so that it is not logged every second.
#[derive(Default)]
struct Logged {
    tokens: Option<String>,
    certificates: Option<String>,
    /// The keys of the configuration file at the start, without the tokens.
    keys: Option<FileKeys>,
    changed: Vec<String>,
}

impl Logged {
    /// Logs which keys have changed, without the tokens.
    fn log_changed_keys(&mut self, keys: Option<FileKeys>) {
        let Some(now) = keys else { return };
        let changed = changed_keys(self.keys.get_or_insert_with(|| now.clone()), &now);
        if changed != self.changed && !changed.is_empty() {
            tracing::warn!(
                "the configuration file has changed, and what it says of {} counts from the next start on; tokens alone are followed",
                changed.join(", ")
            );
        }
        self.changed = changed;
    }
}

fn log_once(last: &mut Option<String>, what: &str, problem: String) {
    if last.as_ref() != Some(&problem) {
        tracing::error!("{what}: {problem}");
        *last = Some(problem);
    }
}
