// bend.cpp: bend HOST:PORT MODEL.glb
#include <fstream>
#include <iostream>
#include <iterator>

#include <grpcpp/grpcpp.h>

#include "pliant/v1/pliant.grpc.pb.h"

namespace pb = pliant::v1;

static std::shared_ptr<grpc::Channel> connect(const std::string& address) {
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
    return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), settings);
}

static void check(const grpc::Status& status) {
    if (!status.ok()) {
        std::cerr << status.error_message() << "\n";
        std::exit(1);
    }
}

int main(int count, char** words) {
    if (count != 3) return 2;
    auto deformer = pb::Deformer::NewStub(connect(words[1]));
    std::ifstream file(words[2], std::ios::binary);
    const std::string model{std::istreambuf_iterator<char>(file), {}};

    // Options first, then the model in pieces.
    pb::Session session;
    {
        grpc::ClientContext context;
        auto upload = deformer->CreateSession(&context, &session);
        pb::CreateSessionRequest request;
        request.mutable_options()->set_label("bend.cpp");
        upload->Write(request);
        for (size_t first = 0; first < model.size(); first += 1 << 20) {
            request.set_chunk(model.substr(first, 1 << 20));
            upload->Write(request);
        }
        upload->WritesDone();
        check(upload->Finish());
    }

    // One handle fixes the feet, one moves the head.
    {
        pb::SetHandlesRequest request;
        request.set_session_id(session.id());
        auto* feet = request.add_handles();
        feet->set_id("feet");
        auto* below = feet->mutable_region()->mutable_half_space();
        for (double x : {0.0, -1.0, 0.0}) below->add_normal(x);
        below->set_offset(-0.14);
        auto* head = request.add_handles();
        head->set_id("head");
        auto* ball = head->mutable_region()->mutable_sphere();
        for (double x : {0.76, 1.22, 0.0}) ball->add_center(x);
        ball->set_radius(0.36);
        grpc::ClientContext context;
        check(deformer->SetHandles(&context, request, &session));
    }

    // A pose on a stream, its frame in parts; an acknowledgement lets the next frame come.
    grpc::ClientContext context;
    auto stream = deformer->Deform(&context);
    pb::DeformRequest request;
    request.set_session_id(session.id());
    request.mutable_options()->set_tolerance(1e-4);
    stream->Write(request);
    request.Clear();
    auto* pose = request.mutable_pose();
    pose->set_seq(1);
    auto* entry = pose->add_handles();
    entry->set_id("head");
    for (double x : {0.0, 0.8, 0.0}) entry->mutable_pose()->add_rotation_vector(x);
    stream->Write(request);

    std::string positions;  // little-endian float x, y, z for every render vertex
    pb::DeformResponse response;
    while (stream->Read(&response)) {
        if (response.has_error()) {
            std::cerr << response.error().message() << "\n";
            return 1;
        }
        const auto& frame = response.frame();
        positions += frame.data();
        if (frame.final() && frame.part() + 1 == frame.parts()) {
            request.Clear();
            request.mutable_ack()->set_seq(frame.seq());
            stream->Write(request);
            stream->WritesDone();
        }
    }
    check(stream->Finish());
    std::cout << positions.size() / 12 << " vertices\n";
}
