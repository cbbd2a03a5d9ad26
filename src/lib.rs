//! pliant: a headless mesh-deformation service.
//!
//! A client opens a session with a model, says which parts are handles, streams handle poses and gets vertex buffers
//! back. The method is that of "A Fast Multigrid Algorithm for Mesh Deformation" (Shi, Yu, Bell, Yu, SIGGRAPH 2006).
//!
//! The house has floors; a module uses the floors below its own only:
//!
//! | floor | modules | what |
//! |---|---|---|
//! | 5 | [`cli`], [`server`] | people at a terminal; gRPC, HTTP and WebSocket |
//! | 4 | [`session`], [`check`] | sessions: state, commits, undo, the deform stream; results beside goldens |
//! | 3 | [`job`] | the declarative request, its JSON, and a bench that runs it |
//! | 2 | [`deform`], [`edit`] | two passes: rotation fields, positions; topology operations |
//! | 1 | [`solver`], [`graph`], [`render`] | multigrid on a weighted graph; surface and volume graphs; pictures |
//! | 0 | [`mesh`], [`asset`], [`pool`], [`progress`], [`exec`], [`stage_clock`] | triangles; model formats; threads; cancelling; both as one; times of stages |
//!
//! [`solver`], [`pool`], [`progress`] and [`exec`] are the crate `pliant-solver`, in `src/solver`.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod asset;
pub mod check;
pub mod cli;
pub mod deform;
pub mod edit;
pub mod graph;
pub mod job;
pub mod mesh;
pub mod render;
pub mod server;
pub mod session;
pub mod stage_clock;

/// Multigrid on a weighted graph, with the threads and the watcher that every computing function takes: a crate of its own.
pub use pliant_solver as solver;
pub use pliant_solver::{exec, pool, progress};
