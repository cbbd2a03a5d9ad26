//! Clients as their authors run them, with Python, Node and a browser, and the commands that the documentation shows.

mod agents;
mod avatars;
mod cluster;
mod containers;
mod languages;
mod monitoring;
mod node;
mod packages;
mod pages;
mod python;
#[path = "../support/mod.rs"]
mod support;
mod through_proxy;
mod workflows;

use std::sync::{Mutex, MutexGuard};

/// Held by who installs or builds the TypeScript package: `npm ci` empties its folder of packages before it fills it.
static TYPESCRIPT_PACKAGE: Mutex<()> = Mutex::new(());

fn hold_typescript_package() -> MutexGuard<'static, ()> {
    TYPESCRIPT_PACKAGE.lock().unwrap_or_else(|failed| failed.into_inner())
}
