// The points of each sweep as a matrix of Eigen, in the frame of the robot: how many belong to obstacles, and where the nearest of
// these is.
//
//     build/eigen roof

#include "sweepd.hpp"

#include <Eigen/Geometry>
#include <iostream>

namespace {

/// Where the sensor is in the frame of the robot: x right, y forward, z up.
Eigen::Isometry3d mount_of(const sweepd::Sweep& sweep) {
    const sweepd_pose pose = sweepd_mount(&sweep.header());
    Eigen::Isometry3d mount;
    mount.linear() = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(&pose.rotation[0][0]);
    mount.translation() = Eigen::Map<const Eigen::Vector3d>(pose.position_m);
    mount.makeAffine();
    return mount;
}

/// The returns of obstacles, a column each, metres.
Eigen::Matrix3Xd obstacles_of(const sweepd::Sweep& sweep) {
    Eigen::Matrix3Xd points(3, sweep.header().returns);
    Eigen::Index count = 0;
    for (const sweepd::Return& one : sweep.returns()) {
        if (one.label >= SWEEPD_LABEL_FIRST_SEGMENT && count < points.cols()) points.col(count++) << one.x, one.y, one.z;
    }
    return points.leftCols(count);
}

} // namespace

int main(int argc, char** argv) try {
    if (argc < 2 || argc > 3) {
        std::cerr << "usage: eigen NAME [ROOT]\n";
        return 2;
    }
    sweepd::Client client(argv[1], argc == 3 ? argv[2] : "");
    for (const sweepd::Sweep& sweep : client) {
        // The plane itself, without a copy: a row of the image is a row of the array.
        const Eigen::Map<const Eigen::ArrayXXf> range(sweep.range().data(), sweep.rows(), sweep.columns());
        const Eigen::Matrix3Xd points = mount_of(sweep) * obstacles_of(sweep);
        std::cout << sweep.header().sequence << ": " << (range > 0.0f).count() << " pixels, " << points.cols() << " of obstacles";
        Eigen::Index nearest = 0;
        if (points.cols() > 0) {
            points.colwise().squaredNorm().minCoeff(&nearest);
            std::cout << ", nearest at " << points.col(nearest).transpose();
        }
        std::cout << std::endl;
    }
} catch (const sweepd::Error& error) {
    std::cerr << "eigen: " << error.what() << "\n";
    return 1;
}
