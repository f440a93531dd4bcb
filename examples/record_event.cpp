// Records for 10 s when an obstacle comes into a box ahead of the robot: record_event SENSOR [SECONDS]. The daemon writes
// event_TIME.pcap into this folder, if it may (docs/install.md), with what comes from then on.
#include "sweepd.hpp"
#include <cstdio>
#include <cstdlib>

// Least and greatest x (right), y (ahead) and z (up from the floor), metres.
constexpr sweepd_zone zone = {{-1.0, 0.5, 0.05}, {1.0, 5.0, 2.0}};

int main(int argc, char** argv) try {
    char* end = nullptr;
    const double seconds = argc > 2 ? std::strtod(argv[2], &end) : 10;
    if (argc < 2 || argc > 3 || (end && *end) || !(seconds >= 0.1 && seconds <= 1e9))
        throw sweepd::Error("SENSOR [SECONDS]: SECONDS is 0.1 to 1e9");
    const std::string sensor = argv[1];
    for (sweepd::Client client(sensor);;) {
        const auto sweep = client.next(std::chrono::seconds(1));
        if (!sweep) std::fprintf(stderr, "nothing is heard of %s\n", sensor.c_str());
        if (!sweep) continue;
        if (sweep->header().height_m == 0)
            std::fprintf(stderr, "the height of %s is not known: set `height_m` in `[sensor.mount]`\n", sensor.c_str());
        if (!sweep->obstacle(zone)) continue;
        const auto time_ms = std::chrono::system_clock::now().time_since_epoch() / std::chrono::milliseconds(1);
        const std::string file = "event_" + std::to_string(time_ms) + ".pcap";
        std::printf("recording %s\n", file.c_str());
        std::fflush(stdout);
        const std::string command = "sweepd record --from " + sensor + " -o " + file + " --seconds " + std::to_string(seconds);
        // It says what goes wrong.
        if (std::system(command.c_str()) != 0) return 1;
    }
} catch (const sweepd::Error& error) { return std::fprintf(stderr, "record_event: %s\n", error.what()), 1; }
