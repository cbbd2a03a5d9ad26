//! Tools for agents: sessions over the Model Context Protocol.
//!
//! An agent opens a model, looks at it (a picture comes back), names regions in words, poses, edits, undoes and exports. Tools call the
//! same [`Manager`](pliant_session::Manager) as all transports, and read poses, options and edits in the JSON forms of HTTP, with the same checks
//! in pliant-wire; what is new here is words for regions (`words`) and pictures (`picture`).
//!
//! Over stdio one agent has a process of its own and a folder; over HTTP the server mounts the same tools, with its tokens and tenants.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod agent;
mod answer;
mod folder;
mod kept;
mod picture;
mod tools;
mod words;

pub use agent::{AgentCaller, AgentTools, HttpAgents};
pub use folder::AgentFolder;
