// Prints a line for each sweep of a sensor that sweepd publishes on this host, or with `--objects` for each object while the
// head turns: crates/sweepd-client/examples/consumer.rs in C++17. CMakeLists.txt beside this file builds it:
//
//     cargo build --release
//     cmake -S examples -B build -DCMAKE_PREFIX_PATH=target/release && cmake --build build
//     build/consumer roof --timeout 5
//
// It may be started before the daemon, and goes on when that was restarted. Ctrl-C ends it; `--timeout` does, as an error, when
// nothing came for so many seconds.

#include "sweepd.hpp"

#include <chrono>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>

namespace {

/// How old a time is, milliseconds.
double age_ms(int64_t time_ns) {
    const auto since_1970 = std::chrono::system_clock::now().time_since_epoch();
    const int64_t now_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(since_1970).count();
    return (static_cast<double>(now_ns) - static_cast<double>(time_ns)) * 1e-6;
}

/// A line about a sweep, and the nearest point that belongs to a segment.
void print(const std::string& name, const sweepd::Sweep& sweep) {
    const auto range = sweep.range();
    const auto label = sweep.label();
    size_t nearest = range.size();
    for (size_t pixel = 0; pixel < range.size(); ++pixel) {
        const bool is_obstacle = label[pixel] >= SWEEPD_LABEL_FIRST_SEGMENT && sweepd_is_return(range[pixel]);
        if (is_obstacle && (nearest == range.size() || range[pixel] < range[nearest])) nearest = pixel;
    }
    std::printf("%s %" PRIu64 ": %.1f ms, %zu segments", name.c_str(), sweep.header().sequence,
                age_ms(sweep.header().arrival_ns), sweep.segments().size());
    if (nearest < range.size()) {
        const auto row = static_cast<uint32_t>(nearest % sweep.rows());
        const auto column = static_cast<uint32_t>(nearest / sweep.rows());
        double xyz[3];
        sweepd_point_m(&sweep.view(), row, column, range[nearest], xyz);
        std::printf(", nearest %.2f m at (%.2f %.2f %.2f)", static_cast<double>(range[nearest]), xyz[0], xyz[1], xyz[2]);
    }
    std::printf("\n");
}

/// A line for each object.
void print(const std::string& name, const sweepd::Objects& told) {
    for (const sweepd_object& object : told.objects()) {
        const char* what = object.why == SWEEPD_WHY_WIDE ? "part" : "object";
        std::printf("%s %" PRIu64 ": %s %" PRIu32 ", %.1f ms, %" PRIu32 " points, nearest %.2f m\n", name.c_str(),
                    told.header().sequence, what, object.ordinal, age_ms(told.header().time_ns + object.last_ns),
                    object.segment.points, static_cast<double>(object.segment.nearest_m));
    }
}

/// Prints whatever comes. `limit_s` is 0 where there is no limit.
template <class Client>
int follow(Client& client, const std::string& name, const std::string& root, double limit_s) {
    const std::chrono::duration<double> limit(limit_s);
    sweepd::Next how = sweepd::Next::interrupted;
    for (;;) {
        auto next = limit_s > 0.0 ? client.next(std::chrono::duration_cast<std::chrono::nanoseconds>(limit), &how) : client.next();
        // It was stopped and goes on. It handles no signal: one that is to end it does so.
        if (!next && how == sweepd::Next::interrupted) continue;
        if (!next) break;
        print(name, *next);
        // Given back before anything may make this wait.
        next.reset();
        std::fflush(stdout);
    }
    const char* why = how == sweepd::Next::unpublished ? ", which nobody publishes" : "";
    std::fprintf(stderr, "consumer: for %g s nothing came of %s%s; there is:", limit_s, name.c_str(), why);
    const auto sensors = sweepd::sensors(root);
    for (const std::string& sensor : sensors) std::fprintf(stderr, " %s", sensor.c_str());
    std::fprintf(stderr, sensors.empty() ? " nothing\n" : "\n");
    return 1;
}

} // namespace

int main(int argc, char** argv) {
    std::string name, root;
    bool is_objects = false, is_wrong = false;
    double limit_s = 0.0;
    for (int at = 1; at < argc; ++at) {
        const std::string argument = argv[at];
        if (argument == "--objects") is_objects = true;
        else if (argument == "--timeout" && at + 1 < argc) is_wrong |= !((limit_s = std::atof(argv[++at])) > 0.0 && limit_s < 1e9);
        else if (argument[0] == '-' || !root.empty()) is_wrong = true;
        else (name.empty() ? name : root) = argument;
    }
    if (is_wrong || name.empty()) {
        std::fprintf(stderr, "usage: consumer [--objects] NAME [ROOT] [--timeout SECONDS]   (ROOT: the daemon's folder)\n");
        return 2;
    }
    try {
        sweepd::Client client(name, root);
        if (!is_objects) return follow(client, name, root, limit_s);
        sweepd::ObjectsClient objects = client.objects();
        return follow(objects, name, root, limit_s);
    } catch (const sweepd::Error& error) {
        std::fprintf(stderr, "consumer: %s\n", error.what());
        return 1;
    }
}
