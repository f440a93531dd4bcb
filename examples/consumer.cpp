// Prints a line for each sweep of a sensor that sweepd publishes on this host, or with `--objects` for each object while the
// head turns: crates/sweepd-client/examples/consumer.rs in C++14, on iceoryx2's C++ binding, version 0.10, which is built from its
// sources (https://github.com/eclipse-iceoryx/iceoryx2, iceoryx2-cxx). CMakeLists.txt beside this file builds it:
//
//     cmake -S examples -B build && cmake --build build && build/consumer roof
//
// Where the binding's headers are not found, or with -DSWEEPD_WITHOUT_ICEORYX2, this compiles to a program that checks a sweep in
// a file, or objects (`consumer [--objects] FILE`): what it does with a sweep is in the first half.

#if defined(__has_include)
#if !__has_include("iox2/iceoryx2.hpp") && !defined(SWEEPD_WITHOUT_ICEORYX2)
#define SWEEPD_WITHOUT_ICEORYX2
#endif
#endif

#include "sweepd.h"

#include <algorithm>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include <dirent.h>
#include <pwd.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

namespace {

// ---- A sweep, and objects ----

const char* explain(sweepd_status status) {
    switch (status) {
    case SWEEPD_OK:
        return "nothing is wrong";
    case SWEEPD_TOO_SHORT_OR_UNALIGNED:
        return "too few bytes, or not aligned";
    case SWEEPD_OTHER_VERSION:
        return "nothing of the layout version that this program reads";
    case SWEEPD_INCONSISTENT:
        break;
    }
    return "a header whose counts and offsets contradict each other";
}

int64_t now_ns() {
    timespec now{};
    clock_gettime(CLOCK_REALTIME, &now);
    return static_cast<int64_t>(now.tv_sec) * 1000000000 + now.tv_nsec;
}

/// A line about a sweep, and the nearest point that belongs to a segment.
void print(const std::string& name, const sweepd_sweep& sweep) {
    double nearest_m = HUGE_VAL;
    double nearest[3] = {0.0, 0.0, 0.0};
    for (uint32_t column = 0; column < sweep.columns_len; ++column) {
        for (uint32_t row = 0; row < sweep.rows; ++row) {
            const size_t pixel = sweepd_pixel(&sweep, row, column);
            const float range_m = sweep.range[pixel];
            const bool is_obstacle = sweep.label[pixel] >= SWEEPD_LABEL_FIRST_SEGMENT;
            if (is_obstacle && sweepd_is_return(range_m) && static_cast<double>(range_m) < nearest_m) {
                nearest_m = static_cast<double>(range_m);
                sweepd_point_m(&sweep, row, column, range_m, nearest);
            }
        }
    }
    const double latency_ms = (static_cast<double>(now_ns()) - static_cast<double>(sweep.header.arrival_ns)) * 1e-6;
    std::printf("%s %" PRIu64 ": %.1f ms, %" PRIu32 " segments", name.c_str(), sweep.header.sequence, latency_ms,
                sweep.segments_len);
    if (nearest_m < HUGE_VAL) {
        std::printf(", nearest %.2f m at (%.2f %.2f %.2f)", nearest_m, nearest[0], nearest[1], nearest[2]);
    }
    std::printf("\n");
    std::fflush(stdout);
}

/// A line for each object.
void print(const std::string& name, const sweepd_objects& told) {
    for (uint32_t at = 0; at < told.objects_len; ++at) {
        const sweepd_object& object = told.objects[at];
        const bool is_part = object.why == SWEEPD_WHY_WIDE;
        const double newest_ns = static_cast<double>(told.header.time_ns) + static_cast<double>(object.last_ns);
        const double age_ms = (static_cast<double>(now_ns()) - newest_ns) * 1e-6;
        std::printf("%s %" PRIu64 ": %s %" PRIu32 ", %.1f ms, %" PRIu32 " points, nearest %.2f m\n", name.c_str(),
                    told.header.sequence, is_part ? "part" : "object", object.ordinal, age_ms, object.segment.points,
                    static_cast<double>(object.segment.nearest_m));
    }
    std::fflush(stdout);
}

/// What the bytes are, or why not.
sweepd_status print(const std::string& name, const void* bytes, size_t len, bool is_objects) {
    sweepd_status status = SWEEPD_OK;
    if (is_objects) {
        sweepd_objects told;
        status = sweepd_objects_open(bytes, len, &told);
        if (status == SWEEPD_OK) print(name, told);
    } else {
        sweepd_sweep sweep;
        status = sweepd_open(bytes, len, &sweep);
        if (status == SWEEPD_OK) print(name, sweep);
    }
    return status;
}

/// Takes an option from the arguments; says whether it was there.
bool take_option(int& argc, char**& argv, const char* option) {
    if (argc < 2 || std::string(argv[1]) != option) return false;
    --argc;
    ++argv;
    return true;
}

// ---- Where daemon and consumers find each other ----

std::string default_root() {
    const char* named = std::getenv("SWEEPD_ROOT");
    if (named != nullptr && *named != '\0') return named;
    struct stat run {};
    const bool is_there = stat("/run/sweepd", &run) == 0 && S_ISDIR(run.st_mode);
    return is_there ? "/run/sweepd/iox2" : "/tmp/sweepd/iox2";
}

/// What the names of all files of a folder begin with, there and in /dev/shm. An absolute path is expected.
std::string prefix(const std::string& root) {
    if (root == "/run/sweepd/iox2" || root == "/tmp/sweepd/iox2") return "sweepd_";
    uint64_t fnv_1a = 0xcbf29ce484222325u;
    for (const char byte : root) fnv_1a = (fnv_1a ^ static_cast<unsigned char>(byte)) * 0x100000001b3u;
    char text[32];
    std::snprintf(text, sizeof text, "sweepd_%016" PRIx64 "_", fnv_1a);
    return text;
}

std::string user_name(uid_t uid) {
    const passwd* entry = getpwuid(uid);
    return entry != nullptr ? entry->pw_name : "number " + std::to_string(uid);
}

/// Whether the folder is there. One of another user is an error: it would silently deliver nothing.
bool check_owner(const std::string& root) {
    struct stat folder {};
    // A link of another user is not followed.
    if (lstat(root.c_str(), &folder) != 0) return false;
    if (folder.st_uid == geteuid() && stat(root.c_str(), &folder) != 0) return false;
    if (folder.st_uid == geteuid()) return true;
    throw std::runtime_error(root + " belongs to user " + user_name(folder.st_uid) + ", this program runs as " +
                             user_name(geteuid()) + ": sweeps are shared within one user alone");
}

/// Whether a file of shared memory belongs to a folder: the prefix, 40 hexadecimal digits, and the rest. (The prefix of the
/// usual folders is the beginning of all others.)
bool is_named(const std::string& file, const std::string& prefix) {
    const size_t end = prefix.size() + 40;
    return file.size() > end && file.compare(0, prefix.size(), prefix) == 0 && file[end] == '_' &&
           file.find_first_not_of("0123456789abcdef", prefix.size()) == end;
}

/// Whether iceoryx2 can be called now. It would wait for ever for a file that a process left empty when it died, and a page
/// that is missing would end this program without a word. The daemon removes such files within a second or two.
bool is_shared_memory_ready(const std::string& root) {
    const std::string shared_memory = "/dev/shm";
    const unsigned long long wanted = 256 * 1024;
    struct statvfs room {};
    if (statvfs(shared_memory.c_str(), &room) != 0) throw std::runtime_error("cannot look at " + shared_memory);
    const unsigned long long free = static_cast<unsigned long long>(room.f_bavail) * room.f_frsize;
    if (free < wanted) {
        throw std::runtime_error(shared_memory + " has " + std::to_string(free) + " bytes free and " +
                                 std::to_string(wanted) + " are needed, " + std::to_string(wanted - free) +
                                 " more: make it larger (mount -o remount,size=1G " + shared_memory +
                                 ", or --shm-size for a container) or free some");
    }
    bool is_ready = true;
    DIR* folder = opendir(shared_memory.c_str());
    if (folder == nullptr) throw std::runtime_error("cannot look into " + shared_memory);
    const std::string of_root = prefix(root);
    while (const dirent* entry = readdir(folder)) {
        const std::string path = shared_memory + "/" + entry->d_name;
        struct stat file {};
        if (!is_named(entry->d_name, of_root) || lstat(path.c_str(), &file) != 0) continue;
        if (file.st_uid != geteuid() && path.find(".global_mgmt") != std::string::npos) {
            throw std::runtime_error(path + " belongs to user " + user_name(file.st_uid) +
                                     " and stands where a file of this user must be: have it removed");
        }
        if (file.st_uid == geteuid() && (file.st_size == 0 || (file.st_mode & S_IRUSR) == 0)) {
            const bool is_abandoned = time(nullptr) - file.st_ctime > 1;
            if (is_abandoned) unlink(path.c_str());
            is_ready = is_ready && is_abandoned;
        }
    }
    closedir(folder);
    return is_ready;
}

/// The bytes of a file, or nothing where there is none.
std::string content(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

} // namespace

#if defined(SWEEPD_WITHOUT_ICEORYX2)

int main(int argc, char** argv) {
    if (argc == 3 && std::string(argv[1]) == "--prefix") {
        std::printf("%s\n", prefix(argv[2]).c_str());
        return 0;
    }
    if (argc == 3 && (std::string(argv[1]) == "--owner" || std::string(argv[1]) == "--ready")) {
        try {
            const bool asks_owner = std::string(argv[1]) == "--owner";
            const char* is_or_not[] = {"not there", "this user's", "not ready", "ready"};
            std::printf("%s\n", is_or_not[asks_owner ? check_owner(argv[2]) : 2 + is_shared_memory_ready(argv[2])]);
            return 0;
        } catch (const std::runtime_error& error) {
            std::fprintf(stderr, "consumer: %s\n", error.what());
            return 1;
        }
    }
    const bool is_objects = take_option(argc, argv, "--objects");
    const std::string bytes = content(argc == 2 ? argv[1] : default_root());
    // As aligned as in shared memory.
    void* aligned = nullptr;
    if (posix_memalign(&aligned, SWEEPD_ALIGN, bytes.size() + 1) != 0) return 1;
    std::copy(bytes.begin(), bytes.end(), static_cast<char*>(aligned));
    const sweepd_status status = print("file", aligned, bytes.size(), is_objects);
    if (status != SWEEPD_OK) std::fprintf(stderr, "consumer: %s\n", explain(status));
    std::free(aligned);
    return status == SWEEPD_OK ? 0 : 1;
}

#else

#include "iox2/iceoryx2.hpp"

namespace {

using namespace iox2;

/// iceoryx2's user header. sweepd_preamble is the same, without the name by which iceoryx2 knows it.
struct alignas(SWEEPD_ALIGN) Preamble {
    static constexpr const char* IOX2_TYPE_NAME = "sweepd.Preamble";
    sweepd_preamble bytes;
};
static_assert(sizeof(Preamble) == sizeof(sweepd_preamble), "64 bytes");

using Bytes = bb::Slice<uint8_t>;
using Samples = PortFactoryPublishSubscribe<ServiceType::Ipc, Bytes, Preamble>;

/// A service that was found. Dropped from the last to the first.
struct Open {
    Node<ServiceType::Ipc> node;
    Samples service;
    Listener<ServiceType::Ipc> listener;
    Subscriber<ServiceType::Ipc, Bytes, Preamble> subscriber;
    std::string file;
    std::string file_content;

    /// Whether it is the one that others find: nobody tells when its files are deleted, or made anew.
    bool is_current() const {
        return !file_content.empty() && content(file) == file_content;
    }
};

template <uint64_t N>
bb::StaticString<N> text(const std::string& from) {
    auto made = bb::StaticString<N>::from_utf8_null_terminated_unchecked(from.c_str());
    if (!made.has_value()) throw std::runtime_error(from + " is too long");
    return *made;
}

Config config_of(const std::string& root) {
    auto config = Config();
    const auto path = bb::Path::create(text<bb::Path::capacity()>(root));
    const auto name = bb::FileName::create(text<bb::FileName::capacity()>(prefix(root)));
    if (!path.has_value() || !name.has_value()) throw std::runtime_error(root + " cannot be the root of iceoryx2");
    config.global().set_root_path(path.value());
    config.global().set_prefix(name.value());
    // The daemon does that, on a thread that may wait.
    config.global().node().set_cleanup_dead_nodes_on_creation(false);
    config.global().node().set_cleanup_dead_nodes_on_destruction(false);
    config.global().service().set_cleanup_dead_nodes_on_open(false);
    return config;
}

auto open_samples(const Node<ServiceType::Ipc>& node, const ServiceName& name) {
    // Not by its attribute `schema`: what a tunnel mirrors from another host has none. Each sweep says its version.
    return node.service_builder(name).publish_subscribe<Bytes>().user_header<Preamble>().open();
}

/// The service, or nothing while it is not there. Throws for what waiting does not mend.
std::unique_ptr<Open> find(const std::string& root, const std::string& sensor, bool is_objects) {
    if (!check_owner(root) || !is_shared_memory_ready(root)) return nullptr;
    auto node = NodeBuilder()
                    .config(config_of(root))
                    .signal_handling_mode(SignalHandlingMode::Disabled)
                    .create<ServiceType::Ipc>();
    const auto name = ServiceName::create(("sweepd/" + sensor + (is_objects ? "/objects" : "/sweep")).c_str());
    if (!node.has_value() || !name.has_value()) throw std::runtime_error("cannot make a node in " + root);
    // Opened twice: only then it is sure that what is read of its file is not newer than what is opened.
    const auto first = open_samples(node.value(), name.value());
    if (!first.has_value()) {
        switch (first.error()) {
        case PublishSubscribeOpenError::IncompatibleTypes:
        case PublishSubscribeOpenError::VersionMismatch:
            throw std::runtime_error("the sweeps of `" + sensor + "` have another layout than version " +
                                     std::to_string(SWEEPD_LAYOUT_VERSION) +
                                     ", which this program reads; build it with the sweepd.h of the sweepd on this host");
        case PublishSubscribeOpenError::ExceedsMaxNumberOfNodes:
            throw std::runtime_error("`" + sensor + "` has as many consumers as it has room for");
        default:
            return nullptr;
        }
    }
    const std::string file = root + "/services/" + prefix(root) + first.value().service_hash().c_str() + ".service";
    std::string before = content(file);
    auto service = open_samples(node.value(), name.value());
    auto event = node.value().service_builder(name.value()).event().open();
    if (!service.has_value() || !event.has_value()) return nullptr;
    auto listener = event.value().listener_builder().create();
    auto subscriber = service.value().subscriber_builder().create();
    if (!listener.has_value() || !subscriber.has_value()) {
        throw std::runtime_error("`" + sensor + "` has as many consumers as it has room for (max_consumers)");
    }
    return std::unique_ptr<Open>(new Open{std::move(node.value()), std::move(service.value()), std::move(listener.value()),
                                          std::move(subscriber.value()), file, std::move(before)});
}

/// Takes all that waits; each sweep or message is given back before the next is taken.
void receive_all(Open& open, const std::string& sensor, bool is_objects) {
    for (;;) {
        auto sample = open.subscriber.receive();
        // An error: the memory of a daemon that is going away. Looking after the service finds the next one.
        if (!sample.has_value() || !sample.value().has_value()) return;
        const auto bytes = sample.value()->payload();
        const uint64_t named = sample.value()->user_header().bytes.sweep_bytes;
        const size_t len = static_cast<size_t>(std::min(named, bytes.number_of_elements()));
        const sweepd_status status = print(sensor, bytes.data(), len, is_objects);
        if (status != SWEEPD_OK) throw std::runtime_error("`" + sensor + "`: " + explain(status));
    }
}

void follow(const std::string& root, const std::string& sensor, bool is_objects) {
    const auto look_every = bb::Duration::from_millis(200);
    for (;;) {
        const auto found = find(root, sensor, is_objects);
        if (found == nullptr) {
            usleep(100000);
            continue;
        }
        while (found->is_current()) {
            receive_all(*found, sensor, is_objects);
            (void)found->listener.timed_wait([](auto) -> void {}, look_every);
        }
    }
}

} // namespace

int main(int argc, char** argv) {
    const bool is_objects = take_option(argc, argv, "--objects");
    if (argc < 2 || argc > 3) {
        std::fprintf(stderr, "usage: consumer [--objects] NAME [ROOT]   (the root as an absolute path)\n");
        return 2;
    }
    set_log_level(LogLevel::Fatal);
    try {
        follow(argc == 3 ? argv[2] : default_root(), argv[1], is_objects);
    } catch (const std::runtime_error& error) {
        std::fprintf(stderr, "consumer: %s\n", error.what());
        return 1;
    }
    return 0;
}

#endif
