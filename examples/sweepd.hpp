// Receives sweeps, and objects while the head turns, in C++17: sweepd.h with owners, spans and loops. Link to libsweepd.so.
//
//     sweepd::Client client("roof");
//     for (const sweepd::Sweep& sweep : client) {
//         for (const sweepd::Return& one : sweep.returns()) {
//             if (one.label >= SWEEPD_LABEL_FIRST_SEGMENT) use(one.x, one.y, one.z);
//         }
//     }
//
// A loop goes on until the program leaves it; next() tells of a signal, or that nothing comes. Nothing is copied: planes and tables
// are spans of the memory that the daemon wrote, which does not change as long as the Sweep is there. So a span cannot be had of a
// Sweep without a name. What fails is an exception, sweepd::Error. sweepd.h says what holds for each function.

#ifndef SWEEPD_HPP
#define SWEEPD_HPP

#include "sweepd.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace sweepd {

/// What is wrong, and how to mend it. Waiting does not, unless it is Invalid.
class Error : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// What came is not valid. What comes next may be: next() may be called again.
class Invalid : public Error {
public:
    using Error::Error;
};

/// How a wait ended that did not fail.
enum class Next {
    received = SWEEPD_NEXT_RECEIVED,
    timeout = SWEEPD_NEXT_TIMEOUT,
    /// Nothing came, and nobody publishes it at present: see sensors().
    unpublished = SWEEPD_NEXT_UNPUBLISHED,
    /// The program handled a signal, or was stopped and goes on.
    interrupted = SWEEPD_NEXT_INTERRUPTED,
};

/// Values beside each other that belong to something else, as std::span of C++20.
template <class T>
class Span {
public:
    using value_type = T;

    Span() = default;
    Span(const T* data, std::size_t size) : data_(data), size_(data == nullptr ? 0 : size) {}
    const T* data() const { return data_; }
    std::size_t size() const { return size_; }
    bool empty() const { return size_ == 0; }
    const T* begin() const { return data_; }
    const T* end() const { return data_ + size_; }
    const T& operator[](std::size_t at) const { return data_[at]; }

private:
    const T* data_ = nullptr;
    std::size_t size_ = 0;
};

/// A return with all that is known of it.
struct Return {
    std::uint32_t row, column;
    /// Whether it is of the planes "2".
    bool is_other;
    /// SWEEPD_KIND_STRONGEST or SWEEPD_KIND_LAST.
    std::uint32_t kind;
    std::uint32_t label;
    std::uint8_t reflectivity;
    float range_m;
    /// When it was measured, nanoseconds since 1970 in the clock of the header's time_source.
    std::int64_t time_ns;
    /// Metres from the sensor: right, forward, up.
    double x, y, z;
};

/// The returns of a sweep, column after column, in each from the top; of a pixel with two, the segmented one first.
class Returns {
public:
    class Iterator {
        struct Arrow {
            Return one;
            const Return* operator->() const { return &one; }
        };

    public:
        using iterator_category = std::input_iterator_tag;
        using value_type = Return;
        using difference_type = std::ptrdiff_t;
        using pointer = Arrow;
        using reference = Return;

        Iterator() = default;
        Iterator(const sweepd_sweep* sweep, std::size_t at) : sweep_(sweep), at_(at) { skip(); }
        Return operator*() const;
        Arrow operator->() const { return {**this}; }
        Iterator& operator++() {
            ++at_;
            skip();
            return *this;
        }
        Iterator operator++(int) {
            const Iterator before = *this;
            ++*this;
            return before;
        }
        bool operator==(const Iterator& other) const { return at_ == other.at_; }
        bool operator!=(const Iterator& other) const { return at_ != other.at_; }

    private:
        // The place counts both planes: an odd one is of the other.
        const float* plane() const { return at_ % 2 == 0 ? sweep_->range : sweep_->range2; }
        void skip() {
            while (at_ < places(*sweep_) && (plane() == nullptr || !sweepd_is_return(plane()[at_ / 2]))) ++at_;
        }

        const sweepd_sweep* sweep_ = nullptr;
        std::size_t at_ = 0;
    };

    explicit Returns(const sweepd_sweep& sweep) : sweep_(&sweep) {}
    Iterator begin() const { return {sweep_, 0}; }
    Iterator end() const { return {sweep_, places(*sweep_)}; }

private:
    static std::size_t places(const sweepd_sweep& sweep) { return std::size_t{2} * sweep.columns_len * sweep.rows; }

    const sweepd_sweep* sweep_;
};

inline Return Returns::Iterator::operator*() const {
    const std::size_t pixel = at_ / 2;
    const bool is_other = at_ % 2 != 0;
    const auto row = static_cast<std::uint32_t>(pixel % sweep_->rows);
    const auto column = static_cast<std::uint32_t>(pixel / sweep_->rows);
    const float range_m = plane()[pixel];
    double xyz[3];
    sweepd_point_m(sweep_, row, column, range_m, xyz);
    return {row,
            column,
            is_other,
            sweepd_kind(sweep_, row, column, is_other),
            (is_other ? sweep_->label2 : sweep_->label)[pixel],
            (is_other ? sweep_->reflectivity2 : sweep_->reflectivity)[pixel],
            range_m,
            sweepd_time_ns(sweep_, row, column),
            xyz[0],
            xyz[1],
            xyz[2]};
}

namespace detail {

struct Release {
    void operator()(sweepd_sample* sample) const { sweepd_sample_release(sample); }
};
struct Close {
    void operator()(sweepd_client* client) const { sweepd_client_close(client); }
};
using Sample = std::unique_ptr<sweepd_sample, Release>;
using Handle = std::unique_ptr<sweepd_client, Close>;

inline Handle opened(sweepd_client* client) {
    if (client == nullptr) throw Error(sweepd_error());
    return Handle(client);
}

/// A text that a function writes as snprintf does; none where it has none.
template <class Write>
std::optional<std::string> text(Write write) {
    std::size_t length = write(nullptr, 0);
    for (;;) {
        if (length == SIZE_MAX) return std::nullopt;
        std::string text(length + 1, '\0');
        length = write(&text[0], text.size());
        // It may have grown in between.
        if (length < text.size()) {
            text.resize(length);
            return text;
        }
    }
}

/// A sample and the view of its bytes. Moved from, it has neither.
template <class View>
class Held {
public:
    Held(Sample sample, sweepd_status (*open)(const void*, std::size_t, View*), std::uint32_t reads) : sample_(std::move(sample)) {
        std::size_t len = 0;
        const void* bytes = sweepd_sample_bytes(sample_.get(), &len);
        // The library has checked the same bytes just before.
        const sweepd_status status = open(bytes, len, &view_);
        if (status == SWEEPD_OTHER_VERSION)
            throw Error("libsweepd gives version " + std::to_string(view_.header.version) +
                        " of the layout, and this program reads version " + std::to_string(reads) +
                        ": build it with the sweepd.h of the library");
        if (status != SWEEPD_OK) throw Invalid("the publisher has changed what it had sent, which is not valid any more");
        bytes_ = {static_cast<const std::uint8_t*>(bytes), len};
    }
    Held(Held&& other) noexcept
        : sample_(std::move(other.sample_)), view_(std::exchange(other.view_, View{})), bytes_(std::exchange(other.bytes_, {})) {}
    Held& operator=(Held&& other) noexcept {
        sample_ = std::move(other.sample_);
        view_ = std::exchange(other.view_, View{});
        bytes_ = std::exchange(other.bytes_, {});
        return *this;
    }
    const View& view() const { return view_; }
    Span<std::uint8_t> bytes() const { return bytes_; }

private:
    Sample sample_;
    View view_{};
    Span<std::uint8_t> bytes_;
};

} // namespace detail

/// A sweep in shared memory. It can be moved, and kept longer than its client. What leads into its memory cannot be had of a
/// temporary, with which the memory is given back.
class Sweep {
public:
    explicit Sweep(detail::Sample sample) : held_(std::move(sample), sweepd_open, SWEEPD_LAYOUT_VERSION) {}

    /// For the functions of sweepd.h.
    const sweepd_sweep& view() const& { return held_.view(); }
    /// A copy of the header, the one that was checked.
    const sweepd_header& header() const& { return view().header; }
    std::uint32_t rows() const { return held_.view().rows; }
    std::uint32_t columns() const { return held_.view().columns_len; }
    Span<std::uint8_t> bytes() const& { return held_.bytes(); }

    // Planes: a value a pixel, column after column, from the top of each; sweepd_pixel is the index. Those with a 2 are empty
    // where the sensor sends one return a shot.
    Span<float> range() const& { return plane(view().range); }
    Span<std::uint8_t> reflectivity() const& { return plane(view().reflectivity); }
    Span<std::uint32_t> label() const& { return plane(view().label); }
    Span<float> range2() const& { return plane(view().range2); }
    Span<std::uint8_t> reflectivity2() const& { return plane(view().reflectivity2); }
    Span<std::uint32_t> label2() const& { return plane(view().label2); }
    Span<std::uint8_t> kind() const& { return plane(view().kind); }

    Span<sweepd_column> firings() const& { return {view().columns, view().columns_len}; }
    Span<sweepd_beam> beams() const& { return {view().beams, view().rows}; }
    Span<sweepd_segment> segments() const& { return {view().segments, view().segments_len}; }
    Returns returns() const& { return Returns(view()); }

    /// The nearest obstacle in a zone, as sweepd_find_obstacle says. Throws Error for a zone that is no box.
    std::optional<sweepd_obstacle> obstacle(const sweepd_zone& zone, const sweepd_least& least = {3, 4}) const {
        sweepd_obstacle found{};
        const std::int32_t is_found = sweepd_find_obstacle(held_.bytes().data(), held_.bytes().size(), &zone, &least, &found);
        if (is_found < 0) throw Error(sweepd_error());
        return is_found == 0 ? std::nullopt : std::optional(found);
    }

    void view() const&& = delete;
    void header() const&& = delete;
    void bytes() const&& = delete;
    void range() const&& = delete;
    void reflectivity() const&& = delete;
    void label() const&& = delete;
    void range2() const&& = delete;
    void reflectivity2() const&& = delete;
    void label2() const&& = delete;
    void kind() const&& = delete;
    void firings() const&& = delete;
    void beams() const&& = delete;
    void segments() const&& = delete;
    void returns() const&& = delete;

private:
    template <class T>
    Span<T> plane(const T* data) const {
        return {data, std::size_t{columns()} * rows()};
    }

    detail::Held<sweepd_sweep> held_;
};

/// Objects that became known together, in shared memory. As of a Sweep, nothing that leads into it can be had of a temporary.
class Objects {
public:
    explicit Objects(detail::Sample sample) : held_(std::move(sample), sweepd_objects_open, SWEEPD_OBJECTS_VERSION) {}

    const sweepd_objects& view() const& { return held_.view(); }
    const sweepd_objects_header& header() const& { return view().header; }
    Span<sweepd_object> objects() const& { return {view().objects, view().objects_len}; }
    /// Of the objects of the sweep, from that with the ordinal header().first_label on.
    Span<std::uint32_t> labels() const& { return {view().labels, view().labels_len}; }

    void view() const&& = delete;
    void header() const&& = delete;
    void objects() const&& = delete;
    void labels() const&& = delete;

private:
    detail::Held<sweepd_objects> held_;
};

/// What next() gives: a std::optional whose -> cannot be had of a temporary, either.
template <class T>
class Maybe : public std::optional<T> {
public:
    using std::optional<T>::optional;
    const T* operator->() const& { return &**this; }
    void operator->() const&& = delete;
};

/// Follows the sweeps (Client) or the objects (ObjectsClient) of one sensor. In a loop it gives one after the other, and waits for
/// them: the loop ends where the program leaves it, or with an Error. A program that is to end while nothing comes calls next() with
/// a limit.
template <class T>
class Following {
public:
    struct End {};
    /// For a loop alone: what it gives is moved and not copied, and held by it until the next.
    class Iterator {
    public:
        explicit Iterator(Following& of) : of_(&of) { ++*this; }
        const T& operator*() const { return *what_; }
        const T* operator->() const { return &*what_; }
        Iterator& operator++() {
            // Given back first: it is not held while waiting.
            what_.reset();
            // Each signal ends a wait, and so does SIGCONT after Ctrl-Z.
            while (!what_) what_ = of_->next();
            return *this;
        }
        /// Only where next() has thrown.
        bool operator==(End) const { return !what_; }
        bool operator!=(End) const { return what_.has_value(); }

    private:
        Following* of_;
        Maybe<T> what_;
    };

    /// Waits for the next, and for the daemon if there is none, at most `limit`. If nothing comes, `how` says why. Throws Error.
    Maybe<T> next(std::chrono::nanoseconds limit, Next* how = nullptr) { return wait(limit.count() < 0 ? 0 : limit.count(), how); }
    /// The same without a limit: nothing comes only where the program has handled a signal, or was stopped and goes on.
    Maybe<T> next() { return wait(-1, nullptr); }

    Iterator begin() { return Iterator(*this); }
    End end() { return {}; }

    /// Whether next() would give one at once.
    bool has_next() const { return sweepd_client_has_next(handle_.get()) != 0; }
    bool is_connected() const { return sweepd_client_is_connected(handle_.get()) != 0; }
    bool is_published() const { return sweepd_client_is_published(handle_.get()) != 0; }
    std::uint64_t reopened() const { return sweepd_client_reopened(handle_.get()); }
    /// "model", "address" or "schema" of the service, once it is found.
    std::optional<std::string> attribute(const std::string& key) const {
        return detail::text([&](char* text, std::size_t capacity) {
            return sweepd_client_attribute(handle_.get(), key.c_str(), text, capacity);
        });
    }

protected:
    explicit Following(detail::Handle handle) : handle_(std::move(handle)) {}
    sweepd_client* handle() const { return handle_.get(); }

private:
    Maybe<T> wait(std::int64_t limit_ns, Next* how) {
        sweepd_sample* sample = nullptr;
        const std::int32_t reason = sweepd_client_next(handle_.get(), limit_ns, &sample);
        if (reason == SWEEPD_NEXT_INVALID) throw Invalid(sweepd_error());
        if (reason == SWEEPD_NEXT_FAILED) throw Error(sweepd_error());
        if (how != nullptr) *how = static_cast<Next>(reason);
        if (sample == nullptr) return std::nullopt;
        return Maybe<T>(std::in_place, detail::Sample(sample));
    }

    detail::Handle handle_;
};

/// The objects of a sensor while its head turns.
class ObjectsClient : public Following<Objects> {
    friend class Client;
    using Following::Following;
};

/// The sweeps of a sensor.
class Client : public Following<Sweep> {
public:
    /// `root`: the daemon's folder; empty is the default one. Throws Error.
    explicit Client(const std::string& sensor, const std::string& root = {})
        : Following(detail::opened(sweepd_client_open(sensor.c_str(), root.c_str()))) {}

    /// Another client. Throws Error.
    ObjectsClient objects() const { return ObjectsClient(detail::opened(sweepd_client_objects(handle()))); }

    /// Sweeps that were published and did not come.
    std::uint64_t missed() const { return sweepd_client_missed(handle()); }
};

/// Names of the sensors that are published on this host. Throws Error.
inline std::vector<std::string> sensors(const std::string& root = {}) {
    const auto lines = detail::text(
        [&](char* names, std::size_t capacity) { return sweepd_sensors(root.c_str(), names, capacity); });
    if (!lines) throw Error(sweepd_error());
    std::vector<std::string> names;
    for (std::size_t begin = 0; begin < lines->size();) {
        const std::size_t end = std::min(lines->find('\n', begin), lines->size());
        names.push_back(lines->substr(begin, end - begin));
        begin = end + 1;
    }
    return names;
}

} // namespace sweepd

#endif
