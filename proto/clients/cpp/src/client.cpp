#include "pliant/client.h"

#include <cstring>
#include <fstream>
#include <iterator>
#include <utility>

namespace pliant {

/// What the sessions of a client share.
struct Connection {
    std::shared_ptr<grpc::Channel> channel;
    std::unique_ptr<pb::Deformer::Stub> deformer;
    std::string token;

    void prepare(grpc::ClientContext& context) const {
        if (!token.empty()) context.AddMetadata("authorization", "Bearer " + token);
    }
};

namespace {

/// What is sent in one message of an upload.
constexpr std::size_t CHUNK = 1 << 20;

void check(const grpc::Status& status) {
    if (!status.ok()) throw Error(status.error_code(), status.error_message());
}

/// A call with one answer.
template <typename Answer, typename Request, typename Call>
Answer called(const Connection& connection, Call call, const Request& request) {
    grpc::ClientContext context;
    connection.prepare(context);
    Answer answer;
    check((connection.deformer.get()->*call)(&context, request, &answer));
    return answer;
}

pb::SessionRequest request_of(const std::string& id) {
    pb::SessionRequest request;
    request.set_session_id(id);
    return request;
}

template <typename Field>
void put(Field* field, const Vec3& numbers) {
    for (double number : numbers) field->Add(number);
}

/// This library reads plain frames with all vertices.
void check_output(const pb::Options& options) {
    const auto& output = options.output();
    if (output.encoding() != pb::Frame::F32 || output.has_changed_only() || output.tangents() || output.gradients())
        throw Error(grpc::StatusCode::INVALID_ARGUMENT, "options.output: this client reads F32 positions and normals of all vertices");
}

/// Puts the parts of frames together.
class Assembler {
  public:
    /// The frame that a part completes.
    std::shared_ptr<Frame> add(const pb::Frame& part) {
        if (part.part() == 0) frame_ = std::make_shared<Frame>();
        if (!frame_ || (part.part() != next_ && part.part() != 0) || part.encoding() != pb::Frame::F32)
            throw Error(grpc::StatusCode::INTERNAL, "a part of a frame is missing or packed");
        next_ = part.part() + 1;
        auto& numbers = part.attribute() == pb::Frame::NORMAL ? frame_->normals : frame_->positions;
        const std::size_t first = numbers.size(), count = part.data().size() / sizeof(float);
        if (first != 3 * static_cast<std::size_t>(part.first_vertex()))
            throw Error(grpc::StatusCode::INTERNAL, "the parts of a frame do not follow each other");
        numbers.resize(first + count);
        std::memcpy(numbers.data() + first, part.data().data(), count * sizeof(float));
        if (next_ < part.parts()) return nullptr;
        frame_->seq = part.seq();
        frame_->revision = part.revision();
        for (int k = 0; k < part.origin_size() && k < 3; k++) frame_->origin[k] = part.origin(k);
        frame_->is_final = part.final();
        frame_->max_error = part.max_error();
        frame_->solve_ms = part.solve_ms();
        frame_->superseded = part.superseded();
        if (part.has_quality()) frame_->quality = part.quality();
        return std::exchange(frame_, nullptr);
    }

  private:
    std::shared_ptr<Frame> frame_;
    std::uint32_t next_ = 0;
};

pb::Handle handle(const std::string& id) {
    pb::Handle made;
    made.set_id(id);
    return made;
}

pb::Pose pose_of(const std::vector<pb::Pose::Entry>& entries) {
    pb::Pose pose;
    for (const auto& entry : entries) *pose.add_handles() = entry;
    return pose;
}

}  // namespace

pb::Handle half_space(const std::string& id, const Vec3& normal, double offset) {
    auto made = handle(id);
    auto* region = made.mutable_region()->mutable_half_space();
    put(region->mutable_normal(), normal);
    region->set_offset(offset);
    return made;
}

pb::Handle sphere(const std::string& id, const Vec3& center, double radius) {
    auto made = handle(id);
    auto* region = made.mutable_region()->mutable_sphere();
    put(region->mutable_center(), center);
    region->set_radius(radius);
    return made;
}

pb::Handle box(const std::string& id, const Vec3& low, const Vec3& high) {
    auto made = handle(id);
    auto* region = made.mutable_region()->mutable_box();
    put(region->mutable_min(), low);
    put(region->mutable_max(), high);
    return made;
}

pb::Handle vertices(const std::string& id, const std::vector<std::uint32_t>& indices) {
    auto made = handle(id);
    auto* region = made.mutable_region()->mutable_vertices();
    for (auto index : indices) region->add_indices(index);
    return made;
}

pb::Pose::Entry moved(const std::string& id, const Vec3& translation) {
    pb::Pose::Entry entry;
    entry.set_id(id);
    put(entry.mutable_pose()->mutable_translation(), translation);
    return entry;
}

pb::Pose::Entry turned(const std::string& id, const Vec3& rotation_vector) {
    pb::Pose::Entry entry;
    entry.set_id(id);
    put(entry.mutable_pose()->mutable_rotation_vector(), rotation_vector);
    return entry;
}

Client::Client(const std::string& address, const ClientOptions& options) : connection_(std::make_shared<Connection>()) {
    const auto separator = address.find("://");
    const auto scheme = separator == std::string::npos ? "" : address.substr(0, separator);
    if (scheme != "http" && scheme != "https")
        throw Error(grpc::StatusCode::INVALID_ARGUMENT, "\"" + address + "\" is not an address such as http://127.0.0.1:7411");
    // deploy/docs/other-languages.md says what these are for.
    grpc::ChannelArguments settings;
    settings.SetMaxReceiveMessageSize(16 << 20);
    settings.SetInt(GRPC_ARG_HTTP2_MAX_FRAME_SIZE, 1 << 20);
    settings.SetInt(GRPC_ARG_HTTP2_STREAM_LOOKAHEAD_BYTES, 8 << 20);
    settings.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 3000);
    settings.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 6000);
    settings.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
    settings.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
    settings.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
    settings.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    grpc::SslCredentialsOptions trusted;
    trusted.pem_root_certs = options.authorities;
    const auto credentials = scheme == "https" ? grpc::SslCredentials(trusted) : grpc::InsecureChannelCredentials();
    connection_->channel = grpc::CreateCustomChannel(address.substr(separator + 3), credentials, settings);
    connection_->deformer = pb::Deformer::NewStub(connection_->channel);
    connection_->token = options.token;
}

Session Client::open(const std::filesystem::path& file, pb::CreateOptions options) {
    std::ifstream stream(file, std::ios::binary);
    if (!stream) throw Error(grpc::StatusCode::NOT_FOUND, "cannot read " + file.string());
    const std::string model{std::istreambuf_iterator<char>(stream), {}};
    if (options.format().empty() && file.has_extension()) options.set_format(file.extension().string().substr(1));
    if (options.label().empty()) options.set_label(file.filename().string());
    return open_bytes(model, options);
}

Session Client::open_bytes(const std::string& model, const pb::CreateOptions& options, const std::vector<Companion>& companions) {
    grpc::ClientContext context;
    connection_->prepare(context);
    pb::Session session;
    auto upload = connection_->deformer->CreateSession(&context, &session);
    pb::CreateSessionRequest request;
    *request.mutable_options() = options;
    // A write that fails means that the server has answered; `Finish` says what.
    bool is_open = upload->Write(request);
    const auto send = [&](const std::string& bytes) {
        for (std::size_t first = 0; is_open && first < bytes.size(); first += CHUNK) {
            request.set_chunk(bytes.substr(first, CHUNK));
            is_open = upload->Write(request);
        }
    };
    send(model);
    for (const auto& companion : companions) {
        request.mutable_companion()->set_uri(companion.uri);
        is_open = is_open && upload->Write(request);
        send(companion.bytes);
    }
    upload->WritesDone();
    check(upload->Finish());
    return Session(connection_, session.id());
}

Session Client::session(const std::string& id) {
    return Session(connection_, called<pb::Session>(*connection_, &pb::Deformer::Stub::GetSession, request_of(id)).id());
}

pb::Limits Client::limits() {
    return called<pb::Limits>(*connection_, &pb::Deformer::Stub::GetLimits, pb::GetLimitsRequest());
}

Session::Session(std::shared_ptr<Connection> connection, std::string id) : connection_(std::move(connection)), id_(std::move(id)) {}

pb::Session Session::info() const {
    return called<pb::Session>(*connection_, &pb::Deformer::Stub::GetSession, request_of(id_));
}

pb::Session Session::set_handles(const std::vector<pb::Handle>& handles) {
    pb::SetHandlesRequest request;
    for (const auto& handle : handles) *request.add_handles() = handle;
    return set_handles(std::move(request));
}

pb::Session Session::set_handles(pb::SetHandlesRequest request) {
    request.set_session_id(id_);
    return called<pb::Session>(*connection_, &pb::Deformer::Stub::SetHandles, request);
}

Frame Session::solve(const std::vector<pb::Pose::Entry>& entries, const pb::Options& options) {
    check_output(options);
    pb::SolveRequest request;
    request.set_session_id(id_);
    *request.mutable_pose() = pose_of(entries);
    *request.mutable_options() = options;
    grpc::ClientContext context;
    connection_->prepare(context);
    auto parts = connection_->deformer->Solve(&context, request);
    Assembler assembler;
    pb::Frame part;
    std::shared_ptr<Frame> solved;
    while (parts->Read(&part))
        if (auto frame = assembler.add(part)) solved = frame;
    check(parts->Finish());
    if (!solved) throw Error(grpc::StatusCode::INTERNAL, "the server sent no frame");
    return std::move(*solved);
}

pb::EditResult Session::edit(pb::EditRequest request) {
    request.set_session_id(id_);
    return called<pb::EditResult>(*connection_, &pb::Deformer::Stub::Edit, request);
}

pb::Session Session::undo() { return called<pb::Session>(*connection_, &pb::Deformer::Stub::Undo, request_of(id_)); }

pb::Session Session::redo() { return called<pb::Session>(*connection_, &pb::Deformer::Stub::Redo, request_of(id_)); }

std::string Session::export_model(const std::string& format) const {
    pb::ExportRequest request;
    request.set_session_id(id_);
    request.set_format(format);
    grpc::ClientContext context;
    connection_->prepare(context);
    auto chunks = connection_->deformer->Export(&context, request);
    std::string model;
    pb::Chunk chunk;
    while (chunks->Read(&chunk)) model += chunk.data();
    check(chunks->Finish());
    return model;
}

std::unique_ptr<PoseStream> Session::stream(const pb::Options& options) {
    check_output(options);
    return std::unique_ptr<PoseStream>(new PoseStream(connection_, id_, options));
}

void Session::close() {
    called<pb::DeleteSessionResponse>(*connection_, &pb::Deformer::Stub::DeleteSession, request_of(id_));
}

PoseStream::PoseStream(std::shared_ptr<Connection> connection, const std::string& id, const pb::Options& options)
    : connection_(std::move(connection)) {
    connection_->prepare(context_);
    calls_ = connection_->deformer->Deform(&context_);
    pb::DeformRequest request;
    request.set_session_id(id);
    *request.mutable_options() = options;
    write(request);
    receiver_ = std::thread([this] { receive(); });
}

PoseStream::~PoseStream() {
    try {
        close();
    } catch (const Error&) {
        // Who wants to know calls `close`.
    }
}

void PoseStream::write(const pb::DeformRequest& request) {
    std::lock_guard<std::mutex> lock(writing_);
    // A stream that has ended says why at the next `wait` or `close`.
    if (!is_closed_) calls_->Write(request);
}

std::uint64_t PoseStream::send_pose(const std::vector<pb::Pose::Entry>& entries, bool is_commit) {
    pb::DeformRequest request;
    *request.mutable_pose() = pose_of(entries);
    request.mutable_pose()->set_commit(is_commit);
    std::lock_guard<std::mutex> lock(writing_);
    if (is_closed_) throw Error(grpc::StatusCode::CANCELLED, "the stream is closed");
    request.mutable_pose()->set_seq(++sent_);
    calls_->Write(request);
    return sent_;
}

std::uint64_t PoseStream::send(const std::vector<pb::Pose::Entry>& entries) { return send_pose(entries, false); }

std::shared_ptr<const Frame> PoseStream::commit(const std::vector<pb::Pose::Entry>& entries) { return wait(send_pose(entries, true)); }

std::shared_ptr<const Frame> PoseStream::take() {
    std::lock_guard<std::mutex> lock(arriving_);
    return std::exchange(is_taken_, true) ? nullptr : newest_;
}

std::shared_ptr<const Frame> PoseStream::wait(std::uint64_t seq) {
    std::unique_lock<std::mutex> lock(arriving_);
    const auto has_come = [&] { return final_ && final_->seq >= seq; };
    arrived_.wait(lock, [&] { return has_come() || failed_.count(seq) || is_ended_; });
    if (has_come()) return final_;
    if (const auto failed = failed_.find(seq); failed != failed_.end()) throw failed->second;
    check(end_);
    throw Error(grpc::StatusCode::CANCELLED, "the stream is closed");
}

void PoseStream::receive() {
    Assembler assembler;
    pb::DeformResponse response;
    grpc::Status unreadable = grpc::Status::OK;
    while (calls_->Read(&response)) {
        if (response.has_error() && response.error().seq() != 0) {
            std::lock_guard<std::mutex> lock(arriving_);
            const auto& error = response.error();
            failed_.emplace(error.seq(), Error(static_cast<grpc::StatusCode>(error.code()), error.message()));
            arrived_.notify_all();
        } else if (response.has_error()) {
            unreadable = grpc::Status(static_cast<grpc::StatusCode>(response.error().code()), response.error().message());
        } else if (response.has_frame()) {
            std::shared_ptr<const Frame> frame;
            try {
                frame = assembler.add(response.frame());
            } catch (const Error& error) {
                unreadable = grpc::Status(error.code, error.what());
                context_.TryCancel();
                break;
            }
            if (!frame) continue;
            {
                std::lock_guard<std::mutex> lock(arriving_);
                newest_ = frame;
                is_taken_ = false;
                if (frame->is_final) final_ = frame;
                failed_.erase(failed_.begin(), failed_.lower_bound(frame->seq));
                arrived_.notify_all();
            }
            pb::DeformRequest request;
            request.mutable_ack()->set_seq(frame->seq);
            write(request);
        }
    }
    const grpc::Status end = calls_->Finish();
    std::lock_guard<std::mutex> lock(arriving_);
    is_ended_ = true;
    end_ = unreadable.ok() ? end : unreadable;
    arrived_.notify_all();
}

void PoseStream::close() {
    if (receiver_.joinable()) {
        {
            std::lock_guard<std::mutex> lock(writing_);
            is_closed_ = true;
            calls_->WritesDone();
        }
        receiver_.join();
    }
    check(end_);
}

}  // namespace pliant
