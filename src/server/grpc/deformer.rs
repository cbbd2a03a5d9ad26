//! The calls of `pliant.v1.Deformer`.

use super::services::deformer_server::Deformer;
use super::status::status;
use super::stream;
use super::upload;
use crate::server::auth;
use crate::server::format_name::parse_format_name;
use crate::server::state::State;
use crate::session::{Error, Tenant};
use crate::wire::pb;
use bytes::Bytes;
use futures::Stream;
use std::pin::Pin;
use tonic::{Request, Response, Status, Streaming};

/// Bytes of one chunk of an export.
const CHUNK: usize = 1 << 20;

/// Answers calls over a state.
pub(super) struct Calls {
    state: State,
}

type GrpcAnswer<T> = Result<Response<T>, Status>;
type Sent<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

impl Calls {
    pub fn new(state: State) -> Self {
        Self { state }
    }
}

fn tenant<T>(request: &Request<T>) -> Result<Tenant, Status> {
    auth::tenant(request.metadata().as_ref()).map_err(status)
}

/// New work is refused while the server is going away; what only reads is not.
fn work<T>(state: &State, request: Request<T>) -> Result<(Tenant, Option<String>, T), Status> {
    let parts = keyed(request)?;
    if state.draining.is_cancelled() {
        Err(status(Error::draining()))
    } else {
        Ok(parts)
    }
}

/// The caller's idempotency key, its metadata and the message.
fn keyed<T>(request: Request<T>) -> Result<(Tenant, Option<String>, T), Status> {
    let tenant = tenant(&request)?;
    let key = match request.metadata().get("idempotency-key") {
        None => None,
        Some(value) => {
            let text = value
                .to_str()
                .map_err(|_| status(Error::invalid("idempotency-key", "is not printable ASCII")))?;
            Some(text.to_owned())
        }
    };
    Ok((tenant, key, request.into_inner()))
}

fn sent<T: Send + 'static>(items: impl IntoIterator<Item = T, IntoIter: Send + 'static>) -> Sent<T> {
    Box::pin(futures::stream::iter(items.into_iter().map(Ok)))
}

#[tonic::async_trait]
impl Deformer for Calls {
    async fn create_session(&self, request: Request<Streaming<pb::CreateSessionRequest>>) -> GrpcAnswer<pb::Session> {
        let (tenant, key, inbound) = work(&self.state, request)?;
        let upload::Upload { files, options, held } = upload::receive(&self.state, inbound).await?;
        let created = self.state.manager.create(&tenant, files, options, key.as_deref()).await;
        drop(held);
        created.map(|answer| Response::new(answer.value)).map_err(status)
    }

    async fn get_session(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let tenant = tenant(&request)?;
        let id = request.into_inner().session_id;
        self.state
            .manager
            .get(&tenant, &id)
            .await
            .map(Response::new)
            .map_err(status)
    }

    async fn list_sessions(&self, request: Request<pb::ListSessionsRequest>) -> GrpcAnswer<pb::ListSessionsResponse> {
        let tenant = tenant(&request)?;
        self.state
            .manager
            .list(&tenant, request.into_inner())
            .await
            .map(Response::new)
            .map_err(status)
    }

    async fn delete_session(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::DeleteSessionResponse> {
        let tenant = tenant(&request)?;
        let id = request.into_inner().session_id;
        self.state.manager.delete(&tenant, &id).await.map_err(status)?;
        Ok(Response::new(pb::DeleteSessionResponse {}))
    }

    async fn set_handles(&self, request: Request<pb::SetHandlesRequest>) -> GrpcAnswer<pb::Session> {
        let (tenant, key, message) = work(&self.state, request)?;
        self.state
            .manager
            .set_handles(&tenant, message, key.as_deref())
            .await
            .map(Response::new)
            .map_err(status)
    }

    type DeformStream = Sent<pb::DeformResponse>;

    async fn deform(&self, request: Request<Streaming<pb::DeformRequest>>) -> GrpcAnswer<Self::DeformStream> {
        let tenant = tenant(&request)?;
        // The head of the answer goes out at once: clients wait for it before they send their first message.
        Ok(Response::new(Box::pin(stream::responses(
            self.state.clone(),
            tenant,
            request.into_inner(),
        ))))
    }

    type SolveStream = Sent<pb::Frame>;

    async fn solve(&self, request: Request<pb::SolveRequest>) -> GrpcAnswer<Self::SolveStream> {
        let (tenant, key, message) = work(&self.state, request)?;
        let solved = self
            .state
            .manager
            .solve(&tenant, message, key.as_deref())
            .await
            .map_err(status)?;
        Ok(Response::new(sent(solved.frames)))
    }

    async fn edit(&self, request: Request<pb::EditRequest>) -> GrpcAnswer<pb::EditResult> {
        let (tenant, key, message) = work(&self.state, request)?;
        self.state
            .manager
            .edit(&tenant, message, key.as_deref())
            .await
            .map(Response::new)
            .map_err(status)
    }

    async fn undo(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let (tenant, key, message) = work(&self.state, request)?;
        self.state
            .manager
            .undo(&tenant, &message.session_id, key.as_deref())
            .await
            .map(Response::new)
            .map_err(status)
    }

    async fn redo(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let (tenant, key, message) = work(&self.state, request)?;
        self.state
            .manager
            .redo(&tenant, &message.session_id, key.as_deref())
            .await
            .map(Response::new)
            .map_err(status)
    }

    async fn history(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::HistoryResponse> {
        let tenant = tenant(&request)?;
        let id = request.into_inner().session_id;
        self.state
            .manager
            .history(&tenant, &id)
            .await
            .map(Response::new)
            .map_err(status)
    }

    type ExportStream = Sent<pb::Chunk>;

    async fn export(&self, request: Request<pb::ExportRequest>) -> GrpcAnswer<Self::ExportStream> {
        let tenant = tenant(&request)?;
        let message = request.into_inner();
        let format = match message.format.as_str() {
            "" => None,
            name => Some(parse_format_name("format", name).map_err(status)?),
        };
        let exported = self
            .state
            .manager
            .export(&tenant, &message.session_id, format)
            .await
            .map_err(status)?;
        let main = (String::new(), exported.written.main);
        let files: Vec<_> = std::iter::once(main).chain(exported.written.companions).collect();
        Ok(Response::new(sent(
            files.into_iter().flat_map(|(uri, bytes)| chunks(uri, bytes.into())),
        )))
    }

    async fn get_limits(&self, request: Request<pb::GetLimitsRequest>) -> GrpcAnswer<pb::Limits> {
        tenant(&request)?;
        Ok(Response::new(self.state.manager.limits()))
    }
}

/// A file in chunks; an empty file is one empty chunk, so that its name arrives.
fn chunks(uri: String, bytes: Bytes) -> impl Iterator<Item = pb::Chunk> + Send {
    let count = bytes.len().div_ceil(CHUNK).max(1);
    (0..count).map(move |k| {
        let (first, last) = (k * CHUNK, bytes.len().min((k + 1) * CHUNK));
        pb::Chunk {
            data: bytes.slice(first..last),
            uri: uri.clone(),
        }
    })
}
