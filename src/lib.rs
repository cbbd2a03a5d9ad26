//! pliant: a headless mesh-deformation service.
//!
//! A client opens a session with a model, says which parts are handles, streams handle poses and gets vertex buffers
//! back. The method is that of "A Fast Multigrid Algorithm for Mesh Deformation" (Shi, Yu, Bell, Yu, SIGGRAPH 2006).
//!
//! | module | what |
//! |---|---|
//! | [`cli`], [`batch`], [`check`] | people at a terminal; jobs run in process; results beside goldens |
//! | [`server`] | gRPC, HTTP and WebSocket |
//! | [`mcp`] | tools for agents |
//! | [`session`] | state, commits, undo, the deform stream |
//! | [`wire`] | messages, their JSON, and what they mean as values of the engine; the only checks of what clients send |
//! | [`core`] | the deformer without a server: [`engine`] and what it is made of |
//!
//! Each of the last five is a crate of its own in `src`; `deploy/docs/architecture.md` lists them all.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod batch;
pub mod check;
pub mod cli;

/// Mesh deformation without a server: a crate of its own, with the solver's in it.
pub use pliant_core as core;
pub use pliant_core::{asset, deform, edit, engine, exec, graph, mesh, motion, pool, progress, render, solver};

/// The schema; sessions; tools for agents; the server: a crate each.
pub use {pliant_mcp as mcp, pliant_server as server, pliant_session as session, pliant_wire as wire};
