//! The protocol: who calls, the list of tools, a call with its progress and its end, over stdio or HTTP.

use crate::answer::refusal;
use crate::folder::AgentFolder;
use crate::kept::Kept;
use crate::tools::{self, SessionCaller};
use bytes::Bytes;
use http::{Request, Response};
use http_body_util::Full;
use http_body_util::combinators::BoxBody;
use pliant_session::{Manager, Tenant};
use rmcp::model::{
    CallToolRequestParams, CallToolResponse, Implementation, ListToolsResult, PaginatedRequestParams,
    ProgressNotificationParam, ServerCapabilities, ServerConfig,
};
use rmcp::service::{RequestContext, RoleServer, ServiceExt as _};
use rmcp::transport::async_rw::AsyncRwTransport;
use rmcp::transport::streamable_http_server::session::never::NeverSessionManager;
use rmcp::transport::streamable_http_server::{StreamableHttpServerConfig, StreamableHttpService};
use rmcp::{ErrorData, ServerHandler};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite};
use tracing::{Instrument as _, Span};

/// How often a call that takes long reports that it works.
const BETWEEN_NOTES: Duration = Duration::from_secs(1);

/// What an agent reads before it calls anything.
const INSTRUCTIONS: &str = "Deforms 3D models. `open` a model, `look` at it, and name regions in plain words: names in the file (\"lid\"), \
parts of a body (\"left arm\", \"head\"), \"largest part\", \"tips\", \"tail\", sides (\"top quarter\", \"left half of the head\"). `pose` moves regions \
while others are held; all between bends smoothly. Every answer has a picture: look at it before the next step. Poses count from the rest \
shape, not from the last pose. y is up and figures look along z with their left at x, unless `open` says otherwise. `undo` takes a step \
back; `export` writes the model.";

/// Who calls over HTTP: the server puts it among the extensions of a request.
#[derive(Debug, Clone)]
pub struct AgentCaller {
    /// Whose sessions.
    pub tenant: Tenant,
    /// What the caller is called in the audit trail.
    pub name: Arc<str>,
    /// The span of the request, which work is part of.
    pub span: Span,
}

/// The tools over a manager of sessions.
#[derive(Clone)]
pub struct AgentTools {
    manager: Manager,
    /// The one caller of stdio; over HTTP each request has its own.
    caller: Option<AgentCaller>,
    folder: Option<Arc<AgentFolder>>,
    kept: Arc<Kept>,
}

impl AgentTools {
    /// Tools for one agent beside this process, which reads and writes files of a folder.
    pub fn with_folder(manager: Manager, folder: AgentFolder) -> Self {
        let caller = AgentCaller {
            tenant: Tenant::default(),
            name: "mcp".into(),
            span: Span::none(),
        };
        Self {
            manager,
            caller: Some(caller),
            folder: Some(Arc::new(folder)),
            kept: Arc::default(),
        }
    }

    /// Speaks the protocol over stdin and stdout until stdin ends or `stop` is done. To be called inside a runtime.
    ///
    /// # Errors
    /// As [`AgentTools::serve_streams`].
    pub async fn serve_stdio(self, stop: impl Future<Output = ()>) -> Result<(), String> {
        let (reader, writer) = rmcp::transport::stdio_pipes();
        self.serve_streams(reader, writer, stop).await
    }

    /// Speaks the protocol over a pair of streams until the reader ends or `stop` is done.
    ///
    /// # Errors
    /// A text, when the streams break or the first messages are no handshake.
    pub async fn serve_streams(
        self,
        reader: impl AsyncRead + Send + Unpin + 'static,
        writer: impl AsyncWrite + Send + Unpin + 'static,
        stop: impl Future<Output = ()>,
    ) -> Result<(), String> {
        let longest = usize::try_from(self.manager.config().message_bytes).unwrap_or(usize::MAX);
        let transport = AsyncRwTransport::new_server(reader, writer).with_max_line_length(longest);
        tokio::pin!(stop);
        let running = tokio::select! {
            running = self.serve(transport) => match running {
                Ok(running) => running,
                // The client has left before it said anything.
                Err(rmcp::service::ServerInitializeError::ConnectionClosed(_)) => return Ok(()),
                Err(error) => return Err(error.to_string()),
            },
            () = &mut stop => return Ok(()),
        };
        let end = running.cancellation_token();
        tokio::select! {
            done = running.waiting() => done.map(drop).map_err(|e| e.to_string()),
            () = &mut stop => {
                end.cancel();
                Ok(())
            }
        }
    }

    fn session_caller(&self, context: &RequestContext<RoleServer>) -> Result<(SessionCaller, Span), ErrorData> {
        let of_request = || {
            let parts = context.extensions.get::<http::request::Parts>()?;
            parts.extensions.get::<AgentCaller>().cloned()
        };
        let caller = self.caller.clone().or_else(of_request);
        let caller = caller.ok_or_else(|| ErrorData::internal_error("the caller of a request is unknown", None))?;
        let own = SessionCaller {
            manager: self.manager.on_behalf_of(&caller.name),
            tenant: caller.tenant,
            kept: Arc::clone(&self.kept),
        };
        Ok((own, caller.span))
    }
}

impl ServerHandler for AgentTools {
    fn get_info(&self) -> ServerConfig {
        let capabilities = ServerCapabilities::builder().enable_tools().build();
        ServerConfig::new(capabilities)
            .with_server_info(Implementation::new("pliant", env!("CARGO_PKG_VERSION")))
            .with_instructions(INSTRUCTIONS)
    }

    async fn list_tools(
        &self,
        _request: Option<PaginatedRequestParams>,
        _context: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        let tools = tools::list(self.folder.is_some());
        let tools = tools.map_err(|e| ErrorData::internal_error(format!("the list of tools: {e}"), None))?;
        Ok(ListToolsResult::with_all_items(tools))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        context: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        let (caller, span) = self.session_caller(&context)?;
        let token = context.meta.get_progress_token();
        let begun = Instant::now();
        let call = caller.run(&request.name, request.arguments, self.folder.as_deref());
        let call = call.instrument(span);
        tokio::pin!(call);
        // Dropping the call stops its work.
        let done = loop {
            tokio::select! {
                done = &mut call => break done,
                () = context.ct.cancelled() => return Err(ErrorData::internal_error("the call was cancelled", None)),
                () = tokio::time::sleep(BETWEEN_NOTES) => {
                    if let Some(token) = &token {
                        let note = ProgressNotificationParam::new(token.clone(), begun.elapsed().as_secs_f64())
                            .with_message(format!("{}: working", request.name));
                        // An agent that takes no notes gets the answer all the same.
                        let _ = context.peer.notify_progress(note).await;
                    }
                }
            }
        };
        let name: String = request.name.chars().take(64).collect();
        let answer = done.ok_or_else(|| ErrorData::invalid_params(format!("there is no tool \"{name}\""), None))?;
        let result = match answer {
            Ok(answer) => answer.into_result(),
            Err(error) => {
                tracing::debug!(tool = %name, "refused: {}", error.message);
                refusal(&error)
            }
        };
        Ok(result.into())
    }
}

/// The same tools over HTTP: each request is one call, with nothing between them but the sessions.
#[derive(Clone)]
pub struct HttpAgents(StreamableHttpService<AgentTools, NeverSessionManager>);

impl HttpAgents {
    /// Tools on the sessions of a server. Who calls, and whether a request may enter, is settled before.
    pub fn new(manager: &Manager) -> Self {
        let tools = AgentTools {
            manager: manager.clone(),
            caller: None,
            folder: None,
            kept: Arc::default(),
        };
        let config = StreamableHttpServerConfig::default()
            .with_legacy_session_mode(false)
            .with_json_response(true)
            .disable_allowed_hosts()
            .disable_allowed_origins()
            .with_max_request_body_bytes(usize::MAX);
        Self(StreamableHttpService::new(
            move || Ok(tools.clone()),
            Arc::default(),
            config,
        ))
    }

    /// Answers a request that has an [`AgentCaller`] among its extensions.
    pub async fn answer(&self, request: Request<Full<Bytes>>) -> Response<BoxBody<Bytes, Infallible>> {
        self.0.handle(request).await
    }
}
