// bend ADDRESS MODEL OUTPUT: drags the head of the built-in creature, records where it ends, cuts a foot off and exports the model.
#include <cstdlib>
#include <fstream>
#include <iostream>

#include "pliant/client.h"

int main(int count, char** words) {
    if (count != 4) {
        std::cerr << "bend http://HOST:PORT MODEL.glb OUTPUT.glb\n";
        return 2;
    }
    try {
        const char* token = std::getenv("PLIANT_TOKEN");
        pliant::Client client(words[1], {token ? token : "", ""});
        pliant::Session session = client.open(words[2]);
        session.set_handles({
            pliant::half_space("feet", {0, -1, 0}, -0.14),  // what stays
            pliant::sphere("head", {0.76, 1.22, 0}, 0.36),     // what moves
        });

        // As often as the pointer moves; the newest pose wins. A render loop takes the newest frame.
        auto stream = session.stream();
        std::uint64_t seq = 0;
        for (int degrees = 1; degrees <= 30; degrees++) {
            seq = stream->send({pliant::turned("head", {0, degrees * 3.14159265 / 180, 0})});
            if (auto frame = stream->take()) std::cout << "pose " << frame->seq << ": " << frame->solve_ms << " ms\n";
        }
        const auto last = stream->wait(seq);
        std::cout << last->positions.size() / 3 << " vertices\n";

        // On release: recorded, refined, and one step for undo.
        const auto kept = stream->commit({pliant::turned("head", {0, 0.5236, 0})});
        std::cout << "revision " << kept->revision << ": " << kept->quality->flipped_triangles() << " triangles flipped\n";
        stream->close();

        pliant::pb::EditRequest cut;
        auto* plane = cut.mutable_cut()->mutable_plane();
        for (double x : {0.0, 1.0, 0.0}) plane->add_normal(x);
        plane->set_offset(0.05);
        cut.mutable_cut()->set_keep(pliant::pb::EditRequest::Cut::ABOVE);
        cut.mutable_cut()->set_fill(true);
        const auto edited = session.edit(cut);
        std::cout << "the cut: " << edited.before().faces() << " faces become " << edited.after().faces() << "\n";
        session.undo();

        std::ofstream(words[3], std::ios::binary) << session.export_model("glb");
        session.close();
    } catch (const pliant::Error& error) {
        std::cerr << error.what() << "\n";
        return 1;
    }
}
