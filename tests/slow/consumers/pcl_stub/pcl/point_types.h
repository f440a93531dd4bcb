// As much of PCL's interface as examples/pcl.cpp uses, by the documentation of PCL 1.13.
#pragma once

namespace pcl {

struct PointXYZI {
    float x = 0.0f, y = 0.0f, z = 0.0f, intensity = 0.0f;
};

} // namespace pcl
