"""Runs KISS-ICP on the clouds of FILE, read by its own reader: with the times of their points, and without.

usage: odometry.py FILE DEGREES_PER_SECOND

The sensor turned clockwise, seen from above, at that rate. Says by how many degrees the yaw is off at the end, with the
times and without, and of how many clouds.
"""

import sys
from pathlib import Path

import numpy as np
from kiss_icp.config import load_config
from kiss_icp.datasets.rosbag import RosbagDataset
from kiss_icp.kiss_icp import KissICP

# The first clouds have no speed yet by which they could be corrected.
SKIPPED = 2


def yaw_off_deg(clouds, stamps_s, turn_deg_s):
    config = load_config(None)
    # One thread adds up in one order: the same in each run.
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses = []
    for points, times in clouds:
        odometry.register_frame(points, times)
        poses.append(odometry.last_pose.copy())
    turned = np.linalg.inv(poses[SKIPPED]) @ poses[-1]
    yaw_deg = np.degrees(np.arctan2(turned[1, 0], turned[0, 0]))
    expected_deg = -turn_deg_s * (stamps_s[-1] - stamps_s[SKIPPED])
    return abs((yaw_deg - expected_deg + 180) % 360 - 180)


dataset = RosbagDataset(Path(sys.argv[1]), "")
clouds = [dataset[index] for index in range(len(dataset))]
stamps_s = dataset.get_frames_timestamps()
# What the reader gives for a cloud without the field.
none = [(points, np.array([])) for points, _ in clouds]
for each in (clouds, none):
    print(f"{yaw_off_deg(each, stamps_s, float(sys.argv[2])):.4f}", end=" ")
print(len(clouds))
# It closes its file, for which Python must still be there.
del dataset
