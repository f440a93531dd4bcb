// Says "stop" while an obstacle is in the way: in a box ahead of the robot that stands on the floor.
//
//     stop SENSOR [WIDTH [LENGTH [MODEL]]]
//
// The way is WIDTH wide and LENGTH long, metres, from the robot's origin; it begins 0.5 m ahead and goes from 5 cm to 2 m over the
// floor. "stop" is also said while whole turns stay away for 0.3 s, while the sensor does not see what it should or its height is not
// known, and of a sweep of another model: a number of docs/layout.md, 0 (the default) for that of the first sweep.
//
// "stop" takes sweeps. "object ahead, not confirmed" comes earlier, while the head turns: the box of an object reaches into the
// way. So does that of a wall beside it: slow down, do not stop.
//
// No output does not mean that the way is free. What lies nearer than the lowest beam, or than the way, is not seen any more. What one
// row alone strikes can be ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and steps down are no obstacles.
// `cargo run --release --example obstacles` prints what is seen by sensor, height and distance.
#include "sweepd.hpp"
#include <cmath>
#include <cstdio>
#include <cstdlib>

using Clock = std::chrono::steady_clock;
// Where the way begins, and from where to where it goes over the floor, metres.
constexpr double ahead_m = 0.5, low_m = 0.05, high_m = 2.0;
// A sensor that is well gives a sweep at least this often: it turns five times a second or faster.
constexpr std::chrono::milliseconds silence(300);

// Says why the robot must stop by a sweep.
static void sweep_says(const char* name, const sweepd::Sweep& sweep, const sweepd_zone& way, std::uint32_t model) {
    const sweepd_header& header = sweep.header();
    if (header.model != model) std::printf("stop: %s is of model %u, not %u\n", name, header.model, model);
    if (header.flags & SWEEPD_NOT_SEEING)
        std::printf("stop: %s does not see what it should, its flags are 0x%x\n", name, header.flags);
    if (header.height_m == 0)
        std::printf("stop: the height of %s is not known: set `height_m` in `[sensor.mount]`\n", name);
    else if (const auto found = sweep.obstacle(way))
        std::printf("stop: an obstacle at %.2f m, sweep %llu\n", found->distance_m, static_cast<unsigned long long>(header.sequence));
}

// Says which objects may be in the way.
static void objects_say(const sweepd::Objects& message, const sweepd_zone& way) {
    const sweepd_objects_header& header = message.header();
    const sweepd_pose mount = sweepd_objects_mount(&header);
    const double floor_m[3] = {0, 0, sweepd_floor_m(header.position_m, header.height_m)};
    for (const sweepd_object& object : message.objects()) {
        double box[2][3];
        sweepd_bounds(&mount, &object.segment, box);
        // What is wide was there in parts before, whose boxes say more.
        bool is_ahead = (object.segment.flags & SWEEPD_SEGMENT_WIDE) == 0;
        for (int i = 0; i < 3; ++i)
            is_ahead &= !(box[0][i] - floor_m[i] > way.most_m[i]) && !(box[1][i] - floor_m[i] < way.least_m[i]);
        if (!is_ahead) continue;
        const std::chrono::duration<double, std::milli> now = std::chrono::system_clock::now().time_since_epoch();
        const double at_m = object.segment.nearest_m, age_ms = now.count() - (static_cast<double>(header.time_ns) + object.last_ns) * 1e-6;
        std::printf("object ahead, not confirmed: %.2f m from the sensor, seen %.0f ms ago\n", at_m, age_ms);
    }
}

int main(int argc, char** argv) try {
    const auto number = [&](int at, double absent) {
        if (argc <= at) return absent;
        char* end = nullptr;
        const double value = std::strtod(argv[at], &end);
        return end == argv[at] || *end != '\0' ? std::nan("") : value;
    };
    const double width_m = number(2, 2.0), length_m = number(3, 5.0), code = number(4, 0);
    const bool is_model = code >= 0 && code <= UINT32_MAX && code == std::floor(code);
    if (argc < 2 || argc > 5 || !(width_m >= 0 && length_m >= ahead_m && is_model))
        throw sweepd::Error("SENSOR [WIDTH [LENGTH [MODEL]]]: WIDTH is at least 0 and LENGTH 0.5, metres; MODEL is a number of docs/layout.md");
    auto model = static_cast<std::uint32_t>(code);
    const sweepd_zone way = {{-width_m / 2, ahead_m, low_m}, {width_m / 2, length_m, high_m}};
    sweepd::Client client(argv[1]);
    sweepd::ObjectsClient objects = client.objects();
    for (auto heard = Clock::now();; std::fflush(stdout)) {
        // Not longer, as a sweep may come meanwhile.
        if (const auto message = objects.next(std::chrono::milliseconds(10))) objects_say(*message, way);
        while (const auto sweep = client.next(std::chrono::milliseconds(0))) {
            if (model == 0) model = sweep->header().model;
            sweep_says(argv[1], *sweep, way, model);
            // Only a whole turn has looked everywhere.
            if (!(sweep->header().flags & (SWEEPD_PARTIAL | SWEEPD_STOPPED))) heard = Clock::now();
        }
        if (Clock::now() - heard <= silence) continue;
        std::printf("stop: no whole turn of %s came for 0.3 s\n", argv[1]);
        heard = Clock::now();
    }
} catch (const std::exception& error) { return std::fprintf(stderr, "stop: %s\n", error.what()), 1; }
