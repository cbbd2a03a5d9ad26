// A session of pliant in C++: open a model, mark handles, stream poses, commit, edit, export.
//
// Messages are those of proto/pliant/v1/pliant.proto, generated when this library is built; `pliant::pb` is short for their namespace.
// Calls throw `pliant::Error`. A `Client` and a `Session` may be used by several threads.
#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <grpcpp/grpcpp.h>

#include "pliant/v1/pliant.grpc.pb.h"

namespace pliant {

namespace pb = ::pliant::v1;

/// x, y, z, in model space.
using Vec3 = std::array<double, 3>;

/// A call that failed: what the server saw and what it allows.
class Error : public std::runtime_error {
  public:
    Error(grpc::StatusCode code, const std::string& message) : std::runtime_error(message), code(code) {}

    grpc::StatusCode code;
};

/// How a client connects.
struct ClientOptions {
    /// Access token; empty without authentication.
    std::string token;
    /// Authorities to trust (PEM) with https; empty: the system's.
    std::string authorities;
};

/// A file that a model refers to by a relative URI.
struct Companion {
    std::string uri;
    std::string bytes;
};

/// A solved vertex buffer.
struct Frame {
    /// The pose that it answers.
    std::uint64_t seq = 0;
    /// The session's revision after it.
    std::uint64_t revision = 0;
    /// x, y, z of every render vertex, from `origin`.
    std::vector<float> positions;
    /// As many normals, if `Options.output.normals` asks for them.
    std::vector<float> normals;
    /// What is added to positions of a model far from zero; zeros for others.
    Vec3 origin{};
    /// No better frame for this pose will follow.
    bool is_final = false;
    /// Estimate of the largest displacement still missing, as a fraction of the bounding-box diagonal.
    double max_error = 0;
    /// Milliseconds of solving.
    double solve_ms = 0;
    /// Poses skipped since the frame before because newer ones came.
    std::uint32_t superseded = 0;
    /// Of a committed pose: the shape against the rest shape.
    std::optional<pb::Quality> quality;
};

/// Handles by the regions that games and tools use most. `Region` of the schema has more.
pb::Handle half_space(const std::string& id, const Vec3& normal, double offset);
pb::Handle sphere(const std::string& id, const Vec3& center, double radius);
pb::Handle box(const std::string& id, const Vec3& low, const Vec3& high);
pb::Handle vertices(const std::string& id, const std::vector<std::uint32_t>& indices);

/// Entries of a pose: a displacement, and a turn about an axis (its length is the angle in radians).
pb::Pose::Entry moved(const std::string& id, const Vec3& translation);
pb::Pose::Entry turned(const std::string& id, const Vec3& rotation_vector);

class PoseStream;

/// One model on the server and the log of its changes.
class Session {
  public:
    /// The session's id, by which another client finds it.
    const std::string& id() const { return id_; }

    /// Model, handles, revision and warnings as they are now.
    pb::Session info() const;

    /// Replaces all handles.
    pb::Session set_handles(const std::vector<pb::Handle>& handles);
    /// As above, with symmetry, a region of interest or stiff parts. `session_id` is filled in.
    pb::Session set_handles(pb::SetHandlesRequest request);

    /// Solves and records one pose. Handles without an entry keep theirs.
    Frame solve(const std::vector<pb::Pose::Entry>& entries, const pb::Options& options = {});

    /// Changes the topology: cut, remesh, fill, … `session_id` is filled in.
    pb::EditResult edit(pb::EditRequest request);
    pb::Session undo();
    pb::Session redo();

    /// The model in its current shape, as bytes of a format: glb, obj, ply, …
    std::string export_model(const std::string& format) const;

    /// Opens a stream of poses.
    std::unique_ptr<PoseStream> stream(const pb::Options& options = {});

    /// Deletes the session. Without it the session expires when it is unused.
    void close();

  private:
    friend class Client;
    Session(std::shared_ptr<struct Connection> connection, std::string id);

    std::shared_ptr<struct Connection> connection_;
    std::string id_;
};

/// A connection to a server.
class Client {
  public:
    /// `address` is http://HOST:PORT or https://HOST:PORT.
    explicit Client(const std::string& address, const ClientOptions& options = {});

    /// Uploads a model. Its format is the file's extension unless `options.format` names one.
    Session open(const std::filesystem::path& file, pb::CreateOptions options = {});
    /// Uploads a model from memory, with files that it refers to. `options.format` names its format.
    Session open_bytes(const std::string& model, const pb::CreateOptions& options, const std::vector<Companion>& companions = {});
    /// A session that is there.
    Session session(const std::string& id);

    /// What the server allows.
    pb::Limits limits();

  private:
    std::shared_ptr<struct Connection> connection_;
};

/// Poses go up, frames come down; the newest pose wins. A thread of its own receives and acknowledges frames.
class PoseStream {
  public:
    ~PoseStream();
    PoseStream(const PoseStream&) = delete;
    PoseStream& operator=(const PoseStream&) = delete;

    /// Sends a pose and returns its number at once.
    std::uint64_t send(const std::vector<pb::Pose::Entry>& entries);
    /// The newest frame, once; nothing when none has come since the last call. For a render loop.
    std::shared_ptr<const Frame> take();
    /// Waits for the final frame of this pose or of a newer one.
    std::shared_ptr<const Frame> wait(std::uint64_t seq);
    /// Records a pose, one step for undo, and waits for its frame, which has `quality`.
    std::shared_ptr<const Frame> commit(const std::vector<pb::Pose::Entry>& entries);
    /// Ends the stream. Throws what the server said of the stream, if it failed.
    void close();

  private:
    friend class Session;
    PoseStream(std::shared_ptr<struct Connection> connection, const std::string& id, const pb::Options& options);

    void write(const pb::DeformRequest& request);
    void receive();
    std::uint64_t send_pose(const std::vector<pb::Pose::Entry>& entries, bool is_commit);

    std::shared_ptr<struct Connection> connection_;
    grpc::ClientContext context_;
    std::unique_ptr<grpc::ClientReaderWriter<pb::DeformRequest, pb::DeformResponse>> calls_;
    std::mutex writing_;
    std::uint64_t sent_ = 0;
    bool is_closed_ = false;

    std::mutex arriving_;
    std::condition_variable arrived_;
    std::shared_ptr<const Frame> newest_;
    std::shared_ptr<const Frame> final_;
    bool is_taken_ = true;
    std::map<std::uint64_t, Error> failed_;
    bool is_ended_ = false;
    grpc::Status end_;
    std::thread receiver_;
};

}  // namespace pliant
