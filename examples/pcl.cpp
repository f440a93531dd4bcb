// Each sweep as a cloud of PCL, organised as the image is, with the axes of ROS (x forward, y left, z up) in the frame of the robot:
//
//     build/pcl roof

#include "sweepd.hpp"

#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <cmath>
#include <iostream>
#include <limits>

namespace {

/// A point a pixel, NaN where there is no return; row by row, as PCL has them.
pcl::PointCloud<pcl::PointXYZI> cloud_of(const sweepd::Sweep& sweep) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    pcl::PointXYZI nothing;
    nothing.x = nothing.y = nothing.z = nan;
    nothing.intensity = 0.0f;
    pcl::PointCloud<pcl::PointXYZI> cloud(sweep.columns(), sweep.rows(), nothing);
    cloud.header.frame_id = "base_link";
    // Microseconds.
    cloud.header.stamp = static_cast<std::uint64_t>(sweep.header().time_ns) / 1000;
    cloud.is_dense = false;
    const sweepd_pose ros = sweepd_ros(), mount = sweepd_mount(&sweep.header());
    const sweepd_pose pose = sweepd_chain(&ros, &mount);
    for (const sweepd::Return& one : sweep.returns()) {
        // Of two returns the one that was segmented.
        if (one.is_other) continue;
        const double from_sensor[3] = {one.x, one.y, one.z};
        double xyz[3];
        sweepd_apply(&pose, from_sensor, xyz);
        pcl::PointXYZI& point = cloud.at(static_cast<int>(one.column), static_cast<int>(one.row));
        point.x = static_cast<float>(xyz[0]);
        point.y = static_cast<float>(xyz[1]);
        point.z = static_cast<float>(xyz[2]);
        point.intensity = one.reflectivity;
    }
    return cloud;
}

} // namespace

int main(int argc, char** argv) try {
    if (argc < 2 || argc > 3) {
        std::cerr << "usage: pcl NAME [ROOT]\n";
        return 2;
    }
    sweepd::Client client(argv[1], argc == 3 ? argv[2] : "");
    for (const sweepd::Sweep& sweep : client) {
        const auto cloud = cloud_of(sweep);
        std::size_t points = 0;
        float least_m = std::numeric_limits<float>::infinity();
        pcl::PointXYZI nearest;
        for (const pcl::PointXYZI& point : cloud.points) {
            const float distance_m = std::hypot(point.x, point.y, point.z);
            if (std::isnan(distance_m)) continue;
            ++points;
            if (distance_m < least_m) {
                least_m = distance_m;
                nearest = point;
            }
        }
        std::cout << sweep.header().sequence << ": " << cloud.width << " x " << cloud.height << ", " << points << " points";
        if (points > 0) std::cout << ", nearest at " << nearest.x << " " << nearest.y << " " << nearest.z;
        std::cout << std::endl;
    }
} catch (const sweepd::Error& error) {
    std::cerr << "pcl: " << error.what() << "\n";
    return 1;
}
