// A loop over the sweeps of `roof`, as any program in C++ has it: a line for each sweep, and for each that is invalid.
//
//     loop ROOT

#undef NDEBUG
#include <cassert>
#include <cstdio>
#include <type_traits>

#include "sweepd.hpp"

namespace {

template <class T>
using ReturnsOf = decltype(std::declval<T>().returns());
template <class T>
using ArrowOf = decltype(std::declval<T>().operator->());

template <template <class> class Of, class T, class = void>
struct Has : std::false_type {};
template <template <class> class Of, class T>
struct Has<Of, T, std::void_t<Of<T>>> : std::true_type {};

// Of a temporary they would lead to memory that is given back.
static_assert(Has<ReturnsOf, const sweepd::Sweep&>::value && !Has<ReturnsOf, sweepd::Sweep>::value);
using Next = sweepd::Maybe<sweepd::Sweep>;
static_assert(Has<ArrowOf, const Next&>::value && !Has<ArrowOf, Next>::value);

using Iterator = sweepd::Returns::Iterator;
static_assert(std::is_same_v<std::iterator_traits<Iterator>::iterator_category, std::input_iterator_tag>);
static_assert(std::is_same_v<sweepd::Span<float>::value_type, float>);

void check(sweepd::Sweep& sweep) {
    const auto returns = sweep.returns();
    Iterator at;
    at = returns.begin();
    if (at != returns.end()) {
        const float range_m = at->range_m;
        assert((*at++).range_m == range_m && std::distance(returns.begin(), at) == 1);
    }
    sweepd::Sweep other = std::move(sweep);
    assert(other.rows() > 0 && sweep.rows() == 0 && sweep.bytes().empty() && sweep.range().empty());
    assert(sweep.returns().begin() == sweep.returns().end());
}

} // namespace

int main(int, char** argv) {
    sweepd::Client client("roof", argv[1]);
    while (!client.is_connected()) client.next(std::chrono::milliseconds(20));
    std::puts("there");
    for (;;) {
        std::fflush(stdout);
        try {
            if (auto sweep = client.next(); sweep) {
                std::puts("taken");
                check(*sweep);
            }
            std::fflush(stdout);
            for (const sweepd::Sweep& sweep : client) {
                std::puts(sweep.rows() > 0 ? "taken" : "empty");
                std::fflush(stdout);
            }
            std::puts("the loop ended");
        } catch (const sweepd::Invalid& error) {
            std::puts(error.what());
        }
    }
}
