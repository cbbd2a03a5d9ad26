// checks ADDRESS MODEL TOKEN: what the example of the C++ client does not show. Prints a line for each; a wrong one ends it.
#include <cstdlib>
#include <functional>
#include <iostream>

#include "pliant/client.h"

namespace {

void expect(bool is_right, const std::string& what) {
    std::cout << (is_right ? "right: " : "WRONG: ") << what << std::endl;
    if (!is_right) std::exit(1);
}

/// The status and words of a call that must fail.
void refused(const std::string& what, grpc::StatusCode code, const std::string& words, const std::function<void()>& call) {
    try {
        call();
    } catch (const pliant::Error& error) {
        const std::string said = error.what();
        return expect(error.code == code && said.find(words) != std::string::npos, what + ": " + std::to_string(error.code) + " " + said);
    }
    expect(false, what + " is not refused");
}

const char* OBJ = "mtllib paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl red\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

}  // namespace

int main(int count, char** words) {
    if (count != 4) return 2;
    pliant::Client client(words[1], {words[3], ""});
    expect(client.limits().window() > 1, "limits");
    auto session = client.open(words[2]);
    session.set_handles({pliant::half_space("feet", {0, -1, 0}, -0.14), pliant::sphere("head", {0.76, 1.22, 0}, 0.36)});
    expect(session.info().model().vertices() == 8628, "info");

    pliant::pb::Options options;
    options.mutable_output()->set_normals(true);
    const auto solved = session.solve({pliant::moved("head", {0, 0.1, 0})}, options);
    expect(solved.normals.size() == solved.positions.size() && solved.positions.size() == 3 * 8628, "normals");
    expect(solved.quality && solved.is_final, "a recorded pose has a quality");

    auto stream = session.stream(options);
    const auto first = stream->wait(stream->send({pliant::turned("head", {0, 0.1, 0})}));
    expect(first->normals.size() == first->positions.size(), "normals on a stream");
    expect(stream->take() == first && stream->take() == nullptr, "a frame is taken once");
    refused("an unknown handle", grpc::StatusCode::INVALID_ARGUMENT, "tail", [&] {
        stream->commit({pliant::moved("tail", {0, 0.1, 0})});
    });
    expect(stream->commit({pliant::turned("head", {0, 0.2, 0})})->quality.has_value(), "the stream goes on after a refusal");
    options.mutable_output()->set_encoding(pliant::pb::Frame::U16);
    refused("a packed encoding", grpc::StatusCode::INVALID_ARGUMENT, "F32", [&] { session.stream(options); });

    auto other = client.session(session.id());
    const auto revision = other.info().revision();
    expect(other.undo().revision() != revision && other.redo().revision() != revision, "undo and redo");
    other.close();
    refused("a stream of a deleted session", grpc::StatusCode::NOT_FOUND, "session", [&] {
        for (;;) stream->wait(stream->send({pliant::turned("head", {0, 0.3, 0})}));
    });
    refused("a deleted session", grpc::StatusCode::NOT_FOUND, "session", [&] { session.info(); });
    refused("a session that never was", grpc::StatusCode::NOT_FOUND, "session", [&] { client.session("none"); });

    pliant::pb::CreateOptions obj;
    obj.set_format("obj");
    const auto painted = client.open_bytes(OBJ, obj, {{"paint.mtl", "newmtl red\nKd 1 0 0\n"}});
    expect(painted.export_model("glb").find("baseColorFactor") != std::string::npos, "a companion's colour is in the export");
    client.session(painted.id()).close();
}
