// Tells a person who walks in, once, some milliseconds after the last beam on them: person SENSOR. That is an object of a
// person's size that has gone half a metre since it was first seen. The robot stands still.
#include "sweepd.hpp"
#include <cmath>
#include <cstdio>

struct Track {
    double first_x, first_y, x, y;
    std::int64_t seen_ns;
    bool is_told;
};
// How far one goes at least until it is told, and less than that from turn to turn, metres.
constexpr double walk_m = 0.5, forgotten_ns = 1e9;

int main(int argc, char** argv) try {
    std::vector<Track> tracks;
    sweepd::ObjectsClient objects = sweepd::Client(argc == 2 ? argv[1] : "").objects();
    for (const sweepd::Objects& message : objects) {
        const sweepd_pose mount = sweepd_objects_mount(&message.header());
        for (const sweepd_object& object : message.objects()) {
            double box[2][3];
            sweepd_bounds(&mount, &object.segment, box);
            const double width_m = std::max(box[1][0] - box[0][0], box[1][1] - box[0][1]), height_m = box[1][2] - box[0][2];
            if (width_m < 0.2 || width_m > 1.2 || height_m < 0.8 || height_m > 2.1) continue;
            const double x = (box[0][0] + box[1][0]) / 2, y = (box[0][1] + box[1][1]) / 2;
            const std::int64_t seen_ns = message.header().time_ns + object.last_ns;
            const auto is_old = [&](const Track& one) { return static_cast<double>(seen_ns - one.seen_ns) > forgotten_ns; };
            tracks.erase(std::remove_if(tracks.begin(), tracks.end(), is_old), tracks.end());
            const auto is_near = [&](const Track& one) { return std::hypot(x - one.x, y - one.y) < walk_m; };
            auto track = std::find_if(tracks.begin(), tracks.end(), is_near);
            if (track == tracks.end()) track = tracks.insert(track, {x, y, x, y, seen_ns, false});
            track->x = x, track->y = y, track->seen_ns = seen_ns;
            if (track->is_told || std::hypot(x - track->first_x, y - track->first_y) <= walk_m) continue;
            track->is_told = true;
            const auto now_ns = std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count();
            std::printf("a person: %.2f m right, %.2f m ahead, seen %.0f ms ago\n", x, y, static_cast<double>(now_ns - seen_ns) * 1e-6);
            std::fflush(stdout);
        }
    }
} catch (const sweepd::Error& error) { return std::fprintf(stderr, "person: %s\n", error.what()), 1; }
