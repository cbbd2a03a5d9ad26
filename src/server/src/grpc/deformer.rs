//! The calls of `pliant.v1.Deformer`.

use super::codec::status;
use super::codec::{Call, call_key};
use super::services::deformer_server::Deformer;
use super::streams;
use crate::messages::{self, parse_format_name};
use crate::redirect;
use crate::state::ServerState;
use bytes::Bytes;
use futures::Stream;
use pliant_session::{Error, ExportedModel};
use pliant_wire::frames::{OutgoingResponse, encode};
use pliant_wire::pb;
use std::pin::Pin;
use tonic::{Request, Response, Status, Streaming};

/// Bytes of one chunk of an export.
const CHUNK: usize = 1 << 20;

/// Answers calls over a state.
pub(super) struct Calls {
    state: ServerState,
}

type GrpcAnswer<T> = Result<Response<T>, Status>;
type Sent<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

impl Calls {
    pub fn new(state: ServerState) -> Self {
        Self { state }
    }

    fn session(&self, session: Result<pb::Session, Error>) -> GrpcAnswer<pb::Session> {
        let config = self.state.manager.config();
        answer(session.map(|session| messages::described_session(session, config)))
    }
}

fn answer<T>(result: Result<T, Error>) -> GrpcAnswer<T> {
    result.map(Response::new).map_err(status)
}

fn sent<T: Send + 'static>(items: impl IntoIterator<Item = T, IntoIter: Send + 'static>) -> Sent<T> {
    Box::pin(futures::stream::iter(items.into_iter().map(Ok)))
}

#[tonic::async_trait]
impl Deformer for Calls {
    async fn create_session(&self, request: Request<Streaming<pb::CreateSessionRequest>>) -> GrpcAnswer<pb::Session> {
        let was_sent = request.metadata().contains_key(redirect::NODE);
        let call = Call::work(&self.state, request).await?;
        self.state.manager.place_new(was_sent).await.map_err(status)?;
        let upload = streams::receive_upload(&self.state, &call.tenant, call.message).await?;
        let key = call_key(call.key, &upload.options);
        let ttls = call.manager.ttl_range(&call.tenant).map_err(status)?;
        let options = pliant_wire::session_options(&upload.options, ttls).map_err(status)?;
        // From here on the session's own reservation has room for them.
        drop(upload.held);
        let created = call.manager.create(&call.tenant, upload.files, options, key).await;
        self.session(created.map(|created| created.value))
    }

    async fn get_session(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let call = Call::read(&self.state, request)?;
        self.session(call.manager.get(&call.tenant, &call.message.session_id).await)
    }

    async fn list_sessions(&self, request: Request<pb::ListSessionsRequest>) -> GrpcAnswer<pb::ListSessionsResponse> {
        let call = Call::read(&self.state, request)?;
        let page = pliant_wire::session_page(&call.message).map_err(status)?;
        let list = call.manager.list(&call.tenant, page).await;
        answer(list.map(|list| messages::session_list(list, call.manager.config())))
    }

    async fn delete_session(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::DeleteSessionResponse> {
        let call = Call::read(&self.state, request)?;
        let deleted = call.manager.delete(&call.tenant, &call.message.session_id).await;
        answer(deleted.map(|()| pb::DeleteSessionResponse {}))
    }

    async fn set_handles(&self, request: Request<pb::SetHandlesRequest>) -> GrpcAnswer<pb::Session> {
        let call = Call::work(&self.state, request).await?.on_session(&self.state).await?;
        let (key, handles) = (call.call_key(), pliant_wire::handle_set(&call.message).map_err(status)?);
        let set = call
            .manager
            .set_handles(&call.tenant, &call.message.session_id, handles, key);
        self.session(set.await)
    }

    type DeformStream = Sent<OutgoingResponse>;

    async fn deform(&self, request: Request<Streaming<pb::DeformRequest>>) -> GrpcAnswer<Self::DeformStream> {
        // The head of the answer goes out at once: clients wait for it before they send their first message.
        let responses = streams::responses(self.state.clone(), Call::read(&self.state, request)?);
        Ok(Response::new(Box::pin(responses)))
    }

    type SolveStream = Sent<pb::Frame>;

    async fn solve(&self, request: Request<pb::SolveRequest>) -> GrpcAnswer<Self::SolveStream> {
        let call = Call::work(&self.state, request).await?.on_session(&self.state).await?;
        let pose = pliant_wire::pose_commit(&call.message, call.manager.config().window).map_err(status)?;
        let solved = call
            .manager
            .solve(&call.tenant, &call.message.session_id, pose, call.call_key());
        answer(solved.await.map(|solved| sent(encode(solved.frame))))
    }

    async fn edit(&self, request: Request<pb::EditRequest>) -> GrpcAnswer<pb::EditResult> {
        let call = Call::work(&self.state, request).await?.on_session(&self.state).await?;
        let edit = pliant_wire::session_edit(&call.message).map_err(status)?;
        let done = call
            .manager
            .edit(&call.tenant, &call.message.session_id, edit, call.call_key());
        answer(done.await)
    }

    async fn undo(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let call = Call::work(&self.state, request).await?;
        let undone = call
            .manager
            .undo(&call.tenant, &call.message.session_id, call.key.as_deref());
        self.session(undone.await)
    }

    async fn redo(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::Session> {
        let call = Call::work(&self.state, request).await?;
        let redone = call
            .manager
            .redo(&call.tenant, &call.message.session_id, call.key.as_deref());
        self.session(redone.await)
    }

    async fn history(&self, request: Request<pb::SessionRequest>) -> GrpcAnswer<pb::HistoryResponse> {
        let call = Call::read(&self.state, request)?;
        answer(call.manager.history(&call.tenant, &call.message.session_id).await)
    }

    type ExportStream = Sent<pb::Chunk>;

    async fn export(&self, request: Request<pb::ExportRequest>) -> GrpcAnswer<Self::ExportStream> {
        let call = Call::read(&self.state, request)?;
        let format = match call.message.format.as_str() {
            "" => None,
            name => Some(parse_format_name("format", name).map_err(status)?),
        };
        let exported = call.manager.export(&call.tenant, &call.message.session_id, format);
        Ok(Response::new(sent(model_chunks(exported.await.map_err(status)?, None))))
    }

    async fn carry(&self, request: Request<pb::CarryRequest>) -> GrpcAnswer<pb::CarryResponse> {
        let call = Call::read(&self.state, request)?.on_session(&self.state).await?;
        let order = pliant_wire::carry_order(&call.message).map_err(status)?;
        answer(call.manager.carry(&call.tenant, &call.message.session_id, order).await)
    }

    async fn crossings(&self, request: Request<pb::CrossingsRequest>) -> GrpcAnswer<pb::CrossingsResponse> {
        let call = Call::read(&self.state, request)?.on_session(&self.state).await?;
        let order = pliant_wire::crossings_order(&call.message).map_err(status)?;
        answer(
            (call.manager)
                .crossings(&call.tenant, &call.message.session_id, order)
                .await,
        )
    }

    async fn make_rig(&self, request: Request<pb::MakeRigRequest>) -> GrpcAnswer<pb::MakeRigResponse> {
        let call = Call::read(&self.state, request)?.on_session(&self.state).await?;
        let order = pliant_wire::make_rig_order(&call.message).map_err(status)?;
        answer(
            (call.manager)
                .make_rig(&call.tenant, &call.message.session_id, order)
                .await,
        )
    }

    type TransferStream = Sent<pb::Chunk>;

    async fn transfer(&self, request: Request<pb::TransferRequest>) -> GrpcAnswer<Self::TransferStream> {
        let call = Call::work(&self.state, request).await?.on_session(&self.state).await?;
        let order = messages::transfer_order(&call.message).map_err(status)?;
        let came = call.manager.transfer(&call.tenant, &call.message.session_id, order);
        let came = came.await.map_err(status)?;
        Ok(Response::new(sent(model_chunks(came.model, Some(came.report)))))
    }

    type AnimateStream = Sent<pb::Frame>;

    async fn animate(&self, request: Request<Streaming<pb::AnimateRequest>>) -> GrpcAnswer<Self::AnimateStream> {
        // The head of the answer goes out at once: clients wait for it before they send their first message.
        let frames = streams::animation_frames(self.state.clone(), Call::read(&self.state, request)?);
        Ok(Response::new(Box::pin(frames)))
    }

    async fn get_limits(&self, request: Request<pb::GetLimitsRequest>) -> GrpcAnswer<pb::Limits> {
        let call = Call::read(&self.state, request)?;
        let left = call.manager.quotas_left(&call.tenant).await.map_err(status)?;
        let longest = *call.manager.ttl_range(&call.tenant).map_err(status)?.end();
        Ok(Response::new(messages::limits_left(
            call.manager.config(),
            left,
            longest,
        )))
    }
}

/// The files of a model in chunks; the first has what there is to say of them.
fn model_chunks(
    exported: ExportedModel,
    mut transferred: Option<pb::TransferReport>,
) -> impl Iterator<Item = pb::Chunk> + Send {
    let mut followed = pliant_wire::followed_message(&exported.written.followed);
    let mut warnings = pliant_wire::written_warnings(&exported.written);
    let main = (String::new(), exported.written.main);
    let files: Vec<_> = std::iter::once(main).chain(exported.written.companions).collect();
    let all = files.into_iter().flat_map(|(uri, bytes)| chunks(uri, bytes.into()));
    all.map(move |chunk| pb::Chunk {
        followed: followed.take(),
        warnings: std::mem::take(&mut warnings),
        transferred: transferred.take(),
        ..chunk
    })
}

/// A file in chunks; an empty file is one empty chunk, so that its name arrives.
fn chunks(uri: String, bytes: Bytes) -> impl Iterator<Item = pb::Chunk> + Send {
    let count = bytes.len().div_ceil(CHUNK).max(1);
    (0..count).map(move |k| {
        let (first, last) = (k * CHUNK, bytes.len().min((k + 1) * CHUNK));
        pb::Chunk {
            data: bytes.slice(first..last),
            uri: uri.clone(),
            ..Default::default()
        }
    })
}
