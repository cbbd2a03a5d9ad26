//! The calls of `pliant.v1.Deformer`.

use super::animate;
use super::services::deformer_server::Deformer;
use super::status::status;
use super::stream;
use super::upload;
use crate::server::auth;
use crate::server::format_name::parse_format_name;
use crate::server::state::State;
use crate::server::{messages, redirect};
use crate::session::{CallKey, Error, Manager, SessionFacts, Tenant};
use crate::wire::frames::{OutgoingResponse, encode};
use crate::wire::{self, pb};
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

    /// Refuses a request on a session that is not there before it looks at what else is wrong with it.
    async fn check_session(&self, tenant: &Tenant, id: &str) -> Result<(), Status> {
        self.state.manager.get(tenant, id).await.map(drop).map_err(status)
    }

    fn session(&self, session: Result<SessionFacts, Error>) -> GrpcAnswer<pb::Session> {
        let session = session.map_err(status)?;
        let message = messages::described_session(&session, self.state.manager.config());
        Ok(Response::new(message))
    }
}

/// What is wrong with a request, as a status.
fn refused(error: wire::Error) -> Status {
    status(error.into())
}

/// The key of a call together with its request.
fn call_key(key: Option<String>, request: &impl prost::Message) -> Option<CallKey> {
    let request = |key| CallKey {
        key,
        request: request.encode_to_vec(),
    };
    key.map(request)
}

/// The sessions, with what is done noted as the caller's.
fn acting<T>(state: &State, request: &Request<T>) -> Result<Manager, Status> {
    let principal = auth::principal(request.extensions()).map_err(status)?;
    Ok(state.manager.on_behalf_of(&principal.name))
}

fn tenant<T>(request: &Request<T>) -> Result<Tenant, Status> {
    let principal = auth::principal(request.extensions()).map_err(status)?;
    Ok(principal.tenant.clone())
}

/// New work is refused while the server is going away; what only reads is not.
async fn work<T>(state: &State, request: Request<T>) -> Result<(Tenant, Option<String>, T), Status> {
    let parts = keyed(request)?;
    if state.draining.is_cancelled() {
        Err(status(state.manager.leaving().await))
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
        let manager = acting(&self.state, &request)?;
        let was_sent = request.metadata().contains_key(redirect::NODE);
        let (tenant, key, inbound) = work(&self.state, request).await?;
        self.state.manager.place_new(was_sent).await.map_err(status)?;
        let upload::Upload { files, options, held } = upload::receive(&self.state, &tenant, inbound).await?;
        let key = call_key(key, &options);
        let options = wire::session_options(&options, manager.ttl_range(&tenant).map_err(status)?).map_err(refused)?;
        // From here on the session's own reservation has room for them.
        drop(held);
        let created = manager.create(&tenant, files, options, key).await;
        self.session(created.map(|answer| answer.value))
    }

    async fn get_session(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let tenant = tenant(&request)?;
        let id = request.into_inner().session_id;
        self.session(self.state.manager.get(&tenant, &id).await)
    }

    async fn list_sessions(&self, request: Request<pb::ListSessionsRequest>) -> GrpcAnswer<pb::ListSessionsResponse> {
        let tenant = tenant(&request)?;
        let page = wire::session_page(request.get_ref()).map_err(refused)?;
        let manager = &self.state.manager;
        let list = manager.list(&tenant, page).await.map_err(status)?;
        Ok(Response::new(messages::session_list(&list, manager.config())))
    }

    async fn delete_session(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::DeleteSessionResponse> {
        let manager = acting(&self.state, &request)?;
        let tenant = tenant(&request)?;
        let id = request.into_inner().session_id;
        manager.delete(&tenant, &id).await.map_err(status)?;
        Ok(Response::new(pb::DeleteSessionResponse {}))
    }

    async fn set_handles(&self, request: Request<pb::SetHandlesRequest>) -> GrpcAnswer<pb::Session> {
        let manager = acting(&self.state, &request)?;
        let (tenant, key, message) = work(&self.state, request).await?;
        self.check_session(&tenant, &message.session_id).await?;
        let (key, handles) = (call_key(key, &message), wire::handle_set(&message).map_err(refused)?);
        self.session(manager.set_handles(&tenant, &message.session_id, handles, key).await)
    }

    type DeformStream = Sent<OutgoingResponse>;

    async fn deform(&self, request: Request<Streaming<pb::DeformRequest>>) -> GrpcAnswer<Self::DeformStream> {
        let (manager, tenant) = (acting(&self.state, &request)?, tenant(&request)?);
        // The head of the answer goes out at once: clients wait for it before they send their first message.
        Ok(Response::new(Box::pin(stream::responses(
            self.state.clone(),
            (manager, tenant),
            request.into_inner(),
        ))))
    }

    type SolveStream = Sent<pb::Frame>;

    async fn solve(&self, request: Request<pb::SolveRequest>) -> GrpcAnswer<Self::SolveStream> {
        let manager = acting(&self.state, &request)?;
        let (tenant, key, message) = work(&self.state, request).await?;
        self.check_session(&tenant, &message.session_id).await?;
        let pose = wire::pose_commit(&message, manager.config().window).map_err(refused)?;
        let key = call_key(key, &message);
        let solved = manager.solve(&tenant, &message.session_id, pose, key).await;
        Ok(Response::new(sent(encode(solved.map_err(status)?.frame))))
    }

    async fn edit(&self, request: Request<pb::EditRequest>) -> GrpcAnswer<pb::EditResult> {
        let manager = acting(&self.state, &request)?;
        let (tenant, key, message) = work(&self.state, request).await?;
        self.check_session(&tenant, &message.session_id).await?;
        let edit = wire::session_edit(&message).map_err(refused)?;
        let key = call_key(key, &message);
        let done = manager.edit(&tenant, &message.session_id, edit, key).await;
        Ok(Response::new(messages::committed_edit(done.map_err(status)?)))
    }

    async fn undo(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let manager = acting(&self.state, &request)?;
        let (tenant, key, message) = work(&self.state, request).await?;
        self.session(manager.undo(&tenant, &message.session_id, key.as_deref()).await)
    }

    async fn redo(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let manager = acting(&self.state, &request)?;
        let (tenant, key, message) = work(&self.state, request).await?;
        self.session(manager.redo(&tenant, &message.session_id, key.as_deref()).await)
    }

    async fn history(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::HistoryResponse> {
        let tenant = tenant(&request)?;
        let id = request.into_inner().session_id;
        let history = self.state.manager.history(&tenant, &id).await.map_err(status)?;
        Ok(Response::new(messages::history_message(history)))
    }

    type ExportStream = Sent<pb::Chunk>;

    async fn export(&self, request: Request<pb::ExportRequest>) -> GrpcAnswer<Self::ExportStream> {
        let manager = acting(&self.state, &request)?;
        let tenant = tenant(&request)?;
        let message = request.into_inner();
        let format = match message.format.as_str() {
            "" => None,
            name => Some(parse_format_name("format", name).map_err(status)?),
        };
        let exported = manager
            .export(&tenant, &message.session_id, format)
            .await
            .map_err(status)?;
        let mut followed = wire::followed_message(&exported.written.followed);
        let main = (String::new(), exported.written.main);
        let files: Vec<_> = std::iter::once(main).chain(exported.written.companions).collect();
        let all = files.into_iter().flat_map(|(uri, bytes)| chunks(uri, bytes.into()));
        Ok(Response::new(sent(all.map(move |chunk| pb::Chunk {
            followed: followed.take(),
            ..chunk
        }))))
    }

    async fn carry(&self, request: Request<pb::CarryRequest>) -> GrpcAnswer<pb::CarryResponse> {
        let manager = acting(&self.state, &request)?;
        let tenant = tenant(&request)?;
        let message = request.into_inner();
        self.check_session(&tenant, &message.session_id).await?;
        let order = wire::carry_order(&message).map_err(refused)?;
        let carried = manager.carry(&tenant, &message.session_id, order).await;
        Ok(Response::new(messages::carried_message(carried.map_err(status)?)))
    }

    type AnimateStream = Sent<pb::Frame>;

    async fn animate(&self, request: Request<Streaming<pb::AnimateRequest>>) -> GrpcAnswer<Self::AnimateStream> {
        let (manager, tenant) = (acting(&self.state, &request)?, tenant(&request)?);
        // The head of the answer goes out at once: clients wait for it before they send their first message.
        Ok(Response::new(Box::pin(animate::animation_frames(
            self.state.clone(),
            (manager, tenant),
            request.into_inner(),
        ))))
    }

    async fn get_limits(&self, request: Request<pb::GetLimitsRequest>) -> GrpcAnswer<pb::Limits> {
        let tenant = tenant(&request)?;
        let manager = &self.state.manager;
        let left = manager.quotas_left(&tenant).await.map_err(status)?;
        let longest = *manager.ttl_range(&tenant).map_err(status)?.end();
        Ok(Response::new(messages::limits_left(manager.config(), &left, longest)))
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
            followed: None,
        }
    })
}
