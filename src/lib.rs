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
//! | 4 | [`session`], [`batch`], [`check`] | sessions: state, commits, undo, the deform stream; jobs run in process; results beside goldens |
//! | 3 | [`wire`] | messages, their JSON, and what they mean as values of the engine; the only checks of what clients send |
//! | 3 | [`engine`] | the deformer: typed handles, regions, poses and edits; used by `wire`, never the other way round |
//! | 2 | [`deform`], [`edit`] | two passes: rotation fields, positions; topology operations |
//! | 1 | [`solver`], [`graph`], [`render`] | multigrid on a weighted graph; surface and volume graphs; pictures |
//! | 0 | [`mesh`], [`asset`], [`pool`], [`progress`], [`exec`], [`stage_clock`] | triangles; model formats; threads; cancelling; both as one; times of stages |
//!
//! Two crates below this one hold the walls that the compiler checks: `pliant-solver` in `src/solver` ([`solver`], [`pool`],
//! [`progress`], [`exec`]) and `pliant-core` in `src/core` (the other floors up to [`engine`]).

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod batch;
pub mod check;
pub mod cli;

/// Mesh deformation without a server: a crate of its own, with the solver's in it.
pub use pliant_core as core;
pub use pliant_core::{asset, deform, edit, engine, exec, graph, mesh, motion, pool, progress, render, solver};

/// The schema; sessions; the server: a crate each.
pub use {pliant_server as server, pliant_session as session, pliant_wire as wire};
