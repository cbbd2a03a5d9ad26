//! Clients as their authors run them, with Python, Node and a browser, and the commands that the documentation shows.

mod node;
mod pages;
mod python;
#[path = "../support/mod.rs"]
mod support;
