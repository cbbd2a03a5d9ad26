//! Every parser and every message under arbitrary bytes: inputs that once were trouble, and a bounded number of mutated ones.
//! Long runs that coverage guides are in `coverage`; see its README.

mod corpora;
mod decoded_memory;
mod found;
mod mutated;
#[path = "../support/mod.rs"]
mod support;
mod targets;
