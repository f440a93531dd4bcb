// Receives sweeps, and objects while the head turns, in C++17: sweepd.h with owners, spans and loops. Link to libsweepd.so.
//
//     sweepd::Client client("roof");
//     for (const sweepd::Sweep& sweep : client) {
//         for (const sweepd::Return& one : sweep.returns()) {
//             if (one.label >= SWEEPD_LABEL_FIRST_SEGMENT) use(one.x, one.y, one.z);
//         }
//     }
//
// Nothing is copied: planes and tables are spans of the memory that the daemon wrote, which does not change as long as the
// Sweep is there. Two sweeps of a client can be held at a time. What fails is an exception, sweepd::Error.

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

/// What waiting does not mend: what is wrong, and the cure.
class Error : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// How a wait ended that did not fail.
enum class Next {
    received = SWEEPD_NEXT_RECEIVED,
    timeout = SWEEPD_NEXT_TIMEOUT,
    /// Nothing came, and nobody publishes it at present: see sensors().
    unpublished = SWEEPD_NEXT_UNPUBLISHED,
    /// The program handled a signal.
    interrupted = SWEEPD_NEXT_INTERRUPTED,
};

/// Values beside each other that belong to something else, as std::span of C++20.
template <class T>
class Span {
public:
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
    public:
        using iterator_category = std::input_iterator_tag;
        using value_type = Return;
        using difference_type = std::ptrdiff_t;
        using pointer = const Return*;
        using reference = Return;

        Iterator(const sweepd_sweep* sweep, std::size_t at) : sweep_(sweep), at_(at) { skip(); }
        Return operator*() const;
        Iterator& operator++() {
            ++at_;
            skip();
            return *this;
        }
        bool operator==(const Iterator& other) const { return at_ == other.at_; }
        bool operator!=(const Iterator& other) const { return at_ != other.at_; }

    private:
        // The place counts both planes: an odd one is of the other.
        const float* plane() const { return at_ % 2 == 0 ? sweep_->range : sweep_->range2; }
        std::size_t end() const { return std::size_t{2} * sweep_->columns_len * sweep_->rows; }
        void skip() {
            while (at_ < end() && (plane() == nullptr || !sweepd_is_return(plane()[at_ / 2]))) ++at_;
        }

        const sweepd_sweep* sweep_;
        std::size_t at_;
    };

    explicit Returns(const sweepd_sweep& sweep) : sweep_(&sweep) {}
    Iterator begin() const { return {sweep_, 0}; }
    Iterator end() const { return {sweep_, std::size_t{2} * sweep_->columns_len * sweep_->rows}; }

private:
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

/// The library has checked the same bytes just before.
inline void check(sweepd_status status) {
    if (status == SWEEPD_OTHER_VERSION)
        throw Error("libsweepd reads another version of the layout than this program, which reads version " +
                    std::to_string(SWEEPD_LAYOUT_VERSION) + ": build it with the sweepd.h of the library");
    if (status != SWEEPD_OK) throw Error("the publisher has changed what it had sent, which is not valid any more");
}

} // namespace detail

/// A sweep in shared memory. It can be moved, and kept longer than its client.
class Sweep {
public:
    explicit Sweep(detail::Sample sample) : sample_(std::move(sample)) {
        std::size_t len = 0;
        const void* bytes = sweepd_sample_bytes(sample_.get(), &len);
        detail::check(sweepd_open(bytes, len, &view_));
        bytes_ = {static_cast<const std::uint8_t*>(bytes), len};
    }

    /// For the functions of sweepd.h.
    const sweepd_sweep& view() const { return view_; }
    /// A copy of the header, the one that was checked.
    const sweepd_header& header() const { return view_.header; }
    std::uint32_t rows() const { return view_.rows; }
    std::uint32_t columns() const { return view_.columns_len; }
    Span<std::uint8_t> bytes() const { return bytes_; }

    // Planes: a value a pixel, column after column, from the top of each; sweepd_pixel is the index. Those with a 2 are empty
    // where the sensor sends one return a shot.
    Span<float> range() const { return plane(view_.range); }
    Span<std::uint8_t> reflectivity() const { return plane(view_.reflectivity); }
    Span<std::uint32_t> label() const { return plane(view_.label); }
    Span<float> range2() const { return plane(view_.range2); }
    Span<std::uint8_t> reflectivity2() const { return plane(view_.reflectivity2); }
    Span<std::uint32_t> label2() const { return plane(view_.label2); }
    Span<std::uint8_t> kind() const { return plane(view_.kind); }

    Span<sweepd_column> firings() const { return {view_.columns, view_.columns_len}; }
    Span<sweepd_beam> beams() const { return {view_.beams, view_.rows}; }
    Span<sweepd_segment> segments() const { return {view_.segments, view_.segments_len}; }
    Returns returns() const { return Returns(view_); }

private:
    template <class T>
    Span<T> plane(const T* data) const {
        return {data, std::size_t{view_.columns_len} * view_.rows};
    }

    detail::Sample sample_;
    sweepd_sweep view_{};
    Span<std::uint8_t> bytes_;
};

/// Objects that became known together, in shared memory.
class Objects {
public:
    explicit Objects(detail::Sample sample) : sample_(std::move(sample)) {
        std::size_t len = 0;
        const void* bytes = sweepd_sample_bytes(sample_.get(), &len);
        detail::check(sweepd_objects_open(bytes, len, &view_));
    }

    const sweepd_objects& view() const { return view_; }
    const sweepd_objects_header& header() const { return view_.header; }
    Span<sweepd_object> objects() const { return {view_.objects, view_.objects_len}; }
    /// Of the objects of the sweep, from that with the ordinal header().first_label on.
    Span<std::uint32_t> labels() const { return {view_.labels, view_.labels_len}; }

private:
    detail::Sample sample_;
    sweepd_objects view_{};
};

/// Follows the sweeps (Client) or the objects (ObjectsClient) of one sensor. In a loop it gives one after the other; the loop
/// ends when the program has handled a signal.
template <class T>
class Following {
public:
    class Iterator {
    public:
        using iterator_category = std::input_iterator_tag;
        using value_type = T;
        using difference_type = std::ptrdiff_t;
        using pointer = const T*;
        using reference = const T&;

        explicit Iterator(Following* of) : of_(of) {
            if (of_ != nullptr) ++*this;
        }
        const T& operator*() const { return *what_; }
        const T* operator->() const { return &*what_; }
        Iterator& operator++() {
            // Given back first: it is not held while waiting.
            what_.reset();
            what_ = of_->next();
            if (!what_) of_ = nullptr;
            return *this;
        }
        bool operator==(const Iterator& other) const { return of_ == other.of_; }
        bool operator!=(const Iterator& other) const { return of_ != other.of_; }

    private:
        Following* of_;
        std::optional<T> what_;
    };

    /// Waits for the next, and for the daemon if there is none, at most so long. If nothing comes, `how` says why. Throws Error.
    std::optional<T> next(std::chrono::nanoseconds limit, Next* how = nullptr) {
        return wait(limit.count() < 0 ? 0 : limit.count(), how);
    }
    /// The same without a limit: nothing comes only where the program has handled a signal.
    std::optional<T> next() { return wait(-1, nullptr); }

    Iterator begin() { return Iterator(this); }
    Iterator end() { return Iterator(nullptr); }

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
    std::optional<T> wait(std::int64_t limit_ns, Next* how) {
        sweepd_sample* sample = nullptr;
        const std::int32_t reason = sweepd_client_next(handle_.get(), limit_ns, &sample);
        if (reason == SWEEPD_NEXT_INVALID || reason == SWEEPD_NEXT_FAILED) throw Error(sweepd_error());
        if (how != nullptr) *how = static_cast<Next>(reason);
        if (sample == nullptr) return std::nullopt;
        return T(detail::Sample(sample));
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
