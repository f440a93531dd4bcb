// Records for 10 s when something comes into a box ahead of the robot: record_event SENSOR [SECONDS]. The daemon writes
// event_TIME.pcap into this folder, if it may (docs/install.md), with what comes from then on.
#include "sweepd.hpp"
#include <cstdio>
#include <cstdlib>

// Least and greatest x (right), y (ahead) and z (up), metres. It reaches below the ground, which is no thing.
constexpr double least_m[] = {-1.0, 0.5, -5.0}, most_m[] = {1.0, 5.0, 2.0};
// Fewest returns of a thing.
constexpr int least_returns = 3;

int main(int argc, char** argv) try {
    const std::string sensor = argc > 1 ? argv[1] : "";
    const double seconds = argc > 2 ? std::atof(argv[2]) : 10;
    for (sweepd::Client client(sensor);;) {
        const auto sweep = client.next(std::chrono::seconds(1));
        if (!sweep) std::fprintf(stderr, "nothing is heard of %s\n", sensor.c_str());
        if (!sweep) continue;
        if (sweep->header().height_m == 0) std::fprintf(stderr, "there are no objects before the height of %s is known\n", sensor.c_str());
        const sweepd_pose mount = sweepd_mount(&sweep->header());
        int returns = 0;
        for (const sweepd::Return& one : sweep->returns()) {
            double at_m[3], point_m[3] = {one.x, one.y, one.z};
            sweepd_apply(&mount, point_m, at_m);
            bool is_in = one.label >= SWEEPD_LABEL_FIRST_SEGMENT;
            for (int i = 0; i < 3; ++i) is_in = is_in && least_m[i] < at_m[i] && at_m[i] < most_m[i];
            returns += is_in;
        }
        if (returns < least_returns) continue;
        const auto time_ms = std::chrono::system_clock::now().time_since_epoch() / std::chrono::milliseconds(1);
        const std::string file = "event_" + std::to_string(time_ms) + ".pcap";
        std::printf("recording %s\n", file.c_str());
        std::fflush(stdout);
        const std::string command = "sweepd record --from " + sensor + " -o " + file + " --seconds " + std::to_string(seconds);
        // It says what goes wrong.
        if (std::system(command.c_str()) != 0) return 1;
    }
} catch (const sweepd::Error& error) { return std::fprintf(stderr, "record_event: %s\n", error.what()), 1; }
