// As much of PCL's interface as examples/pcl.cpp uses, by the documentation of PCL 1.13.
#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

namespace pcl {

struct PCLHeader {
    std::uint32_t seq = 0;
    /// Microseconds.
    std::uint64_t stamp = 0;
    std::string frame_id;
};

template <class PointT>
class PointCloud {
public:
    PointCloud(std::uint32_t width_, std::uint32_t height_, const PointT& value = PointT())
        : points(std::size_t{width_} * height_, value), width(width_), height(height_) {}

    PointT& at(int column, int row) {
        if (height <= 1) throw std::runtime_error("not organised");
        return points.at(static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column));
    }

    PCLHeader header;
    std::vector<PointT> points;
    std::uint32_t width = 0, height = 0;
    bool is_dense = true;
};

} // namespace pcl
