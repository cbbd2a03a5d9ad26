//! Files that are followed while the server runs: its tokens, the keys that tokens are checked with, and its certificates.
//!
//! They are looked at every now and then, by content: an editor that replaces a file, a link that points elsewhere and a renewed
//! certificate are all seen. What cannot be read changes nothing, and is told once.

use super::config::tokens_of_file;
use super::state::State;
use std::time::Duration;

/// How long a change may go unseen.
const PERIOD: Duration = Duration::from_secs(1);

/// Follows the files for ever.
pub(super) async fn follow_files(state: State) {
    let mut told = Told::default();
    let mut known = state.config.auth.tokens.clone();
    loop {
        state.gatekeeper.follow_keys().await;
        tokio::time::sleep(PERIOD).await;
        if let Some(file) = state.config.auth.file.clone() {
            match tokio::task::spawn_blocking(move || tokens_of_file(&file)).await {
                Ok(Ok(tokens)) => {
                    told.tokens = None;
                    if tokens != known {
                        tracing::info!(auth.tokens = tokens.len(), "the tokens have changed");
                        state.gatekeeper.replace_tokens(tokens.clone());
                        known = tokens;
                    }
                }
                Ok(Err(error)) => tell(&mut told.tokens, "the tokens stay as they were", error.to_string()),
                Err(_) => return,
            }
        }
        if let Some(tls) = state.tls.clone() {
            match tokio::task::spawn_blocking(move || tls.reload()).await {
                Ok(Ok(false)) => {}
                Ok(Ok(true)) => {
                    told.certificates = None;
                    tracing::info!("the TLS certificates have changed");
                }
                Ok(Err(problem)) => tell(
                    &mut told.certificates,
                    "the TLS certificates stay as they were",
                    problem,
                ),
                Err(_) => return,
            }
        }
    }
}

/// What was said last, so that it is not said every second.
#[derive(Default)]
struct Told {
    tokens: Option<String>,
    certificates: Option<String>,
}

fn tell(last: &mut Option<String>, what: &str, problem: String) {
    if last.as_ref() != Some(&problem) {
        tracing::error!("{what}: {problem}");
        *last = Some(problem);
    }
}
