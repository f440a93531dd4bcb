"""Starts sweepd-ros2 as a node of a launch file: `ros2 launch examples/ros2/sweepd.launch.py`.

The daemon runs on its own, as a service or by `sweepd run`.
"""

from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription([
        Node(
            # No package: the program is found as any other.
            executable="sweepd-ros2",
            name="sweepd",
            parameters=[{"stamp": "first", "roof.frame_id": "lidar_top"}],
            remappings=[("~/roof/points", "/velodyne_points")],
            # Not respawned: it waits for the daemon itself, and wrong parameters stay wrong.
        ),
    ])
