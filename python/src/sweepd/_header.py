"""What follows from a header alone, of a sweep and of objects: name, number, flags, mount."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Frame = Literal["sensor", "robot", "ros"]
Floats = NDArray[np.float64]

# From x right, y forward, z up to the axes of ROS, x forward, y left, z up: a pose of (4, 4).
ROS: Floats = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)


class Headed:
    """What has a header."""

    header: Any

    @property
    def sequence(self) -> int:
        """Number of the sweep in this run of the sensor (`header["run_ns"]`), from 0, partial ones included."""
        return int(self.header["sequence"])

    @property
    def name(self) -> str:
        """Name of the sensor; empty where it was given none."""
        return str(self.header["name"].decode(errors="replace"))

    def has(self, flag: int) -> bool:
        """Whether a bit of the flags is set: `sweep.has(layout.CIRCULAR)`."""
        return bool(self.header["flags"] & flag)

    @property
    def mount(self) -> Floats:
        """The pose of the sensor in the frame of the robot, as configured: (4, 4); x right, y forward, z up, metres.

        The sensor is rolled about its own y axis, pitched about x, turned about z, then moved.
        """
        angles = np.array([self.header[key] for key in ("roll_rad", "pitch_rad", "yaw_rad")], dtype=float)
        (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
        pose = np.identity(4)
        pose[:3, :3] = [
            [cy * cr - sy * sp * sr, -sy * cp, cy * sr + sy * sp * cr],
            [sy * cr + cy * sp * sr, cy * cp, sy * sr - cy * sp * cr],
            [-cp * sr, sp, cp * cr],
        ]
        pose[:3, 3] = self.header["position_m"]
        return pose

    @property
    def floor_m(self) -> float | None:
        """Height of the floor in the frame of the robot, metres.

        As far below the sensor as its height says, and never above the origin.
        `None` while neither the height nor a `z_m` over 0 is known.
        """
        up_m, height_m = float(self.header["position_m"][2]), float(self.header["height_m"])
        return min(up_m - height_m, 0.0) if up_m > 0 or height_m > 0 else None

    def _boxes(self, segments: NDArray[np.void], frame: Frame) -> Floats:
        """The boxes of segments in a frame: (segments, 2, 3)."""
        ends = np.stack([segments["min_m"], segments["max_m"]], axis=1).astype(float)
        pose = self._pose_of(frame)
        if pose is None:
            return ends
        shares = pose[:3, :3] * ends[:, :, np.newaxis]
        turned = [shares.min(axis=1).sum(axis=-1), shares.max(axis=1).sum(axis=-1)]
        boxes: Floats = np.stack(turned, axis=1) + pose[:3, 3]
        return boxes

    def _pose_of(self, frame: Frame) -> Floats | None:
        """The pose of the sensor in a frame; `None` for its own."""
        if frame == "sensor":
            return None
        poses = {"robot": self.mount, "ros": ROS @ self.mount}
        if frame not in poses:
            raise ValueError(f'no frame {frame!r}: expected "sensor", "robot" or "ros"')
        return poses[frame]
