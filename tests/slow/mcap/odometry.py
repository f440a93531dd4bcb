"""Runs KISS-ICP on the clouds of FILE, read by its own reader: with the times of their points, without, and deskewed by us.

usage: odometry.py FILE DESKEWED METRES_PER_SECOND DEGREES_PER_SECOND

The sensor went straight on at that speed while it turned clockwise, seen from above, at that rate. DESKEWED has the points of each
cloud of FILE where they were at its last shot: their number, uint32, and x, y, z, float32. Says of each of the three by how many
degrees the yaw is off at the end, by how many degrees and metres (root of the mean square) yaw and place are off over a second,
and by how many metres the place over the whole drive, the two paths laid over each other; and of how many clouds.
"""

import sys
from pathlib import Path

import numpy as np
from kiss_icp.config import load_config
from kiss_icp.datasets.rosbag import RosbagDataset
from kiss_icp.kiss_icp import KissICP
from kiss_icp.metrics import absolute_trajectory_error

# When drives of `sweepd simulate` begin.
BEGUN_S = 1_777_889_843
# The first clouds have no speed yet by which they could be corrected.
SKIPPED = 2


# Clouds of a second.
SECOND = 10


def true_pose(time_s, speed_m_s, turn_deg_s):
    """The sensor's in the frame in which it began: x ahead, y left."""
    seconds = time_s - BEGUN_S
    sin, cos = np.sin(-np.radians(turn_deg_s * seconds)), np.cos(np.radians(turn_deg_s * seconds))
    pose = np.eye(4)
    pose[:2, :2] = [[cos, -sin], [sin, cos]]
    pose[0, 3] = speed_m_s * seconds
    return pose


def off(clouds, true_poses):
    config = load_config(None)
    # One thread adds up in one order: the same in each run.
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    poses = []
    for points, times in clouds:
        odometry.register_frame(points, times)
        poses.append(odometry.last_pose.copy())
    true_poses, poses = np.array(true_poses)[SKIPPED:], np.array(poses)[SKIPPED:]

    def between(begin, end):
        true, found = (np.linalg.inv(each[begin]) @ each[end] for each in (true_poses, poses))
        wrong = np.linalg.inv(true) @ found
        return abs(np.degrees(np.arctan2(wrong[1, 0], wrong[0, 0]))), np.linalg.norm(wrong[:3, 3])

    at_end_deg, _ = between(0, -1)
    seconds = [between(begin, begin + SECOND) for begin in range(len(poses) - SECOND)]
    yaw_deg, place_m = np.sqrt(np.mean(np.square(seconds), axis=0))
    _, whole_m = absolute_trajectory_error(true_poses, poses)
    return at_end_deg, yaw_deg, place_m, whole_m


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
# KISS-ICP brings the points to where the last of them was measured.
motion = tuple(map(float, sys.argv[3:]))
true_poses = [true_pose(stamp + times.max(), *motion) for stamp, (_, times) in zip(stamps_s, clouds)]
# What the reader gives for a cloud without the field.
none = [(points, np.array([])) for points, _ in clouds]
for each in (clouds, none, list(deskewed(Path(sys.argv[2]), clouds))):
    print(*off(each, true_poses), end=" ")
print(len(clouds))
# It closes its file, for which Python must still be there.
del dataset
