"""Runs KISS-ICP on the clouds of FILE, read by its own reader: with the times of their points, without, and deskewed by us.

usage: odometry.py FILE DESKEWED METRES_PER_SECOND DEGREES_PER_SECOND

The sensor went straight on at that speed while it turned clockwise, seen from above, at that rate. DESKEWED has the points of each
cloud of FILE where they were at its stamp: their number, uint32, and x, y, z, float32. Says by how many degrees the yaw and by
how many metres the place is off at the end, with the times, without, and deskewed, and of how many clouds.
"""

import sys
from pathlib import Path

import numpy as np
from kiss_icp.config import load_config
from kiss_icp.datasets.rosbag import RosbagDataset
from kiss_icp.kiss_icp import KissICP

# When drives of `sweepd simulate` begin.
BEGUN_S = 1_777_889_843
# The first clouds have no speed yet by which they could be corrected.
SKIPPED = 2


def off(clouds, stamps_s, speed_m_s, turn_deg_s):
    config = load_config(None)
    # One thread adds up in one order: the same in each run.
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses = []
    for points, times in clouds:
        odometry.register_frame(points, times)
        poses.append(odometry.last_pose.copy())
    moved = np.linalg.inv(poses[SKIPPED]) @ poses[-1]
    seconds = stamps_s[-1] - stamps_s[SKIPPED]
    yaw_deg = np.degrees(np.arctan2(moved[1, 0], moved[0, 0]))
    yaw_off_deg = abs((yaw_deg + turn_deg_s * seconds + 180) % 360 - 180)
    # Straight on in the scene, seen from the sensor as it was turned at the beginning: to the left by what it had turned. Poses
    # may be of any moment of a cloud: the best counts.
    offs_m = []
    for moment_s in (0.0, 0.05, 0.1):
        turned = np.radians(turn_deg_s * (stamps_s[SKIPPED] + moment_s - BEGUN_S))
        expected_m = speed_m_s * seconds * np.array([np.cos(turned), np.sin(turned)])
        offs_m.append(np.linalg.norm(moved[:2, 3] - expected_m))
    return yaw_off_deg, min(offs_m)


def deskewed(path, clouds):
    data, at = path.read_bytes(), 0
    for _ in clouds:
        count = int(np.frombuffer(data, "<u4", 1, at)[0])
        points = np.frombuffer(data, "<f4", 3 * count, at + 4).reshape(count, 3)
        at += 4 + 12 * count
        yield points.astype(np.float64), np.array([])
    assert at == len(data), "as many clouds as in the file"


dataset = RosbagDataset(Path(sys.argv[1]), "")
clouds = [dataset[index] for index in range(len(dataset))]
stamps_s = dataset.get_frames_timestamps()
speed_m_s, turn_deg_s = map(float, sys.argv[3:])
# What the reader gives for a cloud without the field.
none = [(points, np.array([])) for points, _ in clouds]
for each in (clouds, none, list(deskewed(Path(sys.argv[2]), clouds))):
    print(*off(each, stamps_s, speed_m_s, turn_deg_s), end=" ")
print(len(clouds))
# It closes its file, for which Python must still be there.
del dataset
