// Tells when something comes into a zone, a box in the robot's frame, and when it is gone: zones SENSOR.
// Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.
#include "sweepd.hpp"
#include <cstdio>

struct Zone {
    const char* name;
    double least_m[3], most_m[3];
    int empty; // sweeps
};
// Least and greatest x (right), y (ahead) and z (up), metres. They reach below the ground, which is no thing.
static Zone zones[] = {{"ahead", {-1.0, 0.5, -5.0}, {1.0, 5.0, 2.0}, 3}, {"left", {-3.0, -1.0, -5.0}, {-1.0, 1.0, 2.0}, 3}};
// Fewest returns of a thing, and sweeps without them after which it is gone.
constexpr int least_returns = 3, gone = 3;

int main(int argc, char** argv) try {
    if (argc != 2) throw sweepd::Error("which sensor?");
    for (sweepd::Client client(argv[1]);;) {
        const auto sweep = client.next(std::chrono::seconds(1));
        if (!sweep) std::fprintf(stderr, "nothing is heard of %s\n", argv[1]);
        if (!sweep) continue;
        if (sweep->header().height_m == 0) std::fprintf(stderr, "there are no objects before the height of %s is known\n", argv[1]);
        const sweepd_pose mount = sweepd_mount(&sweep->header());
        for (Zone& zone : zones) {
            int returns = 0;
            for (const sweepd::Return& one : sweep->returns()) {
                double at_m[3], point_m[3] = {one.x, one.y, one.z};
                sweepd_apply(&mount, point_m, at_m);
                bool is_in = one.label >= SWEEPD_LABEL_FIRST_SEGMENT;
                for (int i = 0; i < 3; ++i) is_in &= zone.least_m[i] < at_m[i] && at_m[i] < zone.most_m[i];
                returns += is_in;
            }
            if (returns >= least_returns && zone.empty >= gone) std::printf("%s: occupied\n", zone.name);
            zone.empty = returns >= least_returns ? 0 : zone.empty + 1;
            if (zone.empty == gone) std::printf("%s: empty\n", zone.name);
            std::fflush(stdout);
        }
    }
} catch (const sweepd::Error& error) { return std::fprintf(stderr, "zones: %s\n", error.what()), 1; }
