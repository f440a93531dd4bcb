// Tells when an obstacle comes into a zone, a box on the floor in the robot's frame, and when it is gone: zones SENSOR.
// Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.
#include "sweepd.hpp"
#include <cstdio>
#include <utility>

struct Zone {
    const char* name;
    sweepd_zone box;
    int empty; // whole turns
};
// Least and greatest x (right), y (ahead) and z (up from the floor), metres.
static Zone zones[] = {{"ahead", {{-1.0, 0.5, 0.05}, {1.0, 5.0, 2.0}}, 3}, {"left", {{-3.0, -1.0, 0.05}, {-1.0, 1.0, 2.0}}, 3}};
// Whole turns without an obstacle after which it is gone.
constexpr int gone = 3;

int main(int argc, char** argv) try {
    if (argc != 2) throw sweepd::Error("which sensor?");
    for (sweepd::Client client(argv[1]);;) {
        const auto sweep = client.next(std::chrono::seconds(1));
        if (!sweep) std::fprintf(stderr, "nothing is heard of %s\n", argv[1]);
        if (!sweep) continue;
        const sweepd_header& header = sweep->header();
        if (header.height_m == 0) std::fprintf(stderr, "the height of %s is not known: set `height_m` in `[sensor.mount]`\n", argv[1]);
        const bool is_whole = !(header.flags & (SWEEPD_PARTIAL | SWEEPD_STOPPED));
        for (Zone& zone : zones) {
            const bool is_occupied = sweep->obstacle(zone.box).has_value();
            // Only a whole turn has looked everywhere.
            const int before = std::exchange(zone.empty, is_occupied ? 0 : zone.empty + is_whole);
            if (is_occupied && before >= gone) std::printf("%s: occupied\n", zone.name);
            if (before < gone && zone.empty == gone) std::printf("%s: empty\n", zone.name);
            std::fflush(stdout);
        }
    }
} catch (const sweepd::Error& error) { return std::fprintf(stderr, "zones: %s\n", error.what()), 1; }
