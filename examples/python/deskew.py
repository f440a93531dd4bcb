"""Writes the points of a capture, of a sensor that moved evenly, where they are: deskew.py CAPTURE X Y TURN OUT.ply.

X, Y: to the right and ahead, metres a second. TURN: clockwise, degrees a second. `sweep.to_open3d(points)` is for Open3D.
"""

import sys

import numpy as np
import sweepd

if len(sys.argv) != 6:
    sys.exit(__doc__)
capture, x, y, turn, out = sys.argv[1], *map(float, sys.argv[2:5]), sys.argv[5]
sweeps = list(sweepd.replay(capture, partial=True))


def pose_at(time_ns):
    """The odometry: poses of the sensor at these times."""
    seconds = (time_ns - sweeps[0].header["time_ns"]) * 1e-9
    sin, cos = np.sin(np.radians(turn) * seconds), np.cos(np.radians(turn) * seconds)
    rows = np.broadcast_arrays(cos, sin, 0, x * seconds, -sin, cos, 0, y * seconds, 0, 0, 1, 0, 0, 0, 0, 1)
    return np.stack(rows, axis=-1).reshape(*seconds.shape, 4, 4)


cloud = np.concatenate([sweep.points_in(pose_at)[sweep.range > 0] for sweep in sweeps])
fields = "".join(f"property float {axis}\n" for axis in "xyz")
head = f"ply\nformat ascii 1.0\nelement vertex {len(cloud)}\n{fields}end_header"
np.savetxt(out, cloud, fmt="%.3f", header=head, comments="")
