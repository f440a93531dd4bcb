"""A sweep: views of its bytes, and what follows from them."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Union

import numpy as np
from numpy.typing import NDArray

from . import _library, _show, layout
from ._header import Floats, Frame, Headed
from .layout import BEAM, COLUMN, SEGMENT, SEGMENT_WIDE, SweepdError

if TYPE_CHECKING:
    from collections.abc import Sequence

XYZ = tuple[Floats, Floats, Floats]
PoseAt = Union[Floats, Callable[[NDArray[np.int64]], Floats]]

# Bits of `header["flags"]`, but CIRCULAR, which each whole turn has.
FLAGS = (
    "PARTIAL", "REVERSED", "BLANKED", "RATE_UNSTABLE", "STOPPED", "BLIND", "COVERED", "FROZEN", "FADED", "DARK_BELOW",
)  # fmt: skip
ALL = slice(None)
# `sweepd_obstacle` of sweepd.h.
FOUND = np.dtype([("distance_m", "<f8"), ("returns", "<u4"), ("label", "<u4")])
# What is computed at once: 64 KiB an array of f64.
BLOCK_PIXELS = 1 << 13


class Obstacle(NamedTuple):
    """The nearest obstacle in a zone."""

    # From the robot's origin to its nearest return, along the floor, metres.
    distance_m: float
    # Those of its label in the zone; without label, those in groups that are large enough.
    returns: int
    # Of its nearest return: 0, or of a segment.
    label: int


class Sweep(Headed):
    """One sweep: views of its bytes, trimmed to the columns and segments that there are.

    A view keeps the memory of its sweep. In a `Client` that memory is the daemon's: it is read-only and never changes, and
    it gives at most two sweeps at a time: `copy` makes one that may stay. What `replay` and `copy` give may be written to.
    """

    header: Any
    range: NDArray[np.float32]
    reflectivity: NDArray[np.uint8]
    label: NDArray[np.uint32]
    range2: NDArray[np.float32] | None
    reflectivity2: NDArray[np.uint8] | None
    label2: NDArray[np.uint32] | None
    kind: NDArray[np.uint8] | None
    columns: NDArray[np.void]
    beams: NDArray[np.void]
    segments: NDArray[np.void]

    # So that help() has them.
    __slots__ = {  # noqa: RUF023
        "_data": "The bytes.",
        "header": "A copy of the header: a record of `layout.HEADER`, as in `sweep.header['rpm']`.",
        "range": "(columns, rows) f32, metres along the beam, the highest beam first; 0 = no return.",
        "reflectivity": "(columns, rows) u8, calibrated.",
        "label": "(columns, rows) u32: 0 none, 1 ground, from 2 on the segment `segments[label - 2]`.",
        "range2": "As `range`, of the other return of a sensor that sends two; else `None`, as the next three.",
        "reflectivity2": "As `reflectivity`, of the other return.",
        "label2": "As `label`, of the other return.",
        "kind": "(columns, rows) u8, which of two returns is in `range`: bits `layout.KIND_STRONGEST` and so on.",
        "columns": "(columns,) records of `layout.COLUMN`, the firings: radians, nanoseconds since the header's time.",
        "beams": "(rows,) records of `layout.BEAM`, the highest beam first: radians, nanoseconds, metres.",
        "segments": "(segments,) records of `layout.SEGMENT`: points, box, mean and nearest return, metres in the frame"
        " of the sensor (`boxes` gives others), and rows and columns.",
    }

    def __init__(self, data: Any) -> None:
        """Check `data`, the bytes of a sweep: an array of u8, or what NumPy takes for one, such as a file's content.

        Raises `LayoutError` for what is no sweep.
        """
        if not isinstance(data, np.ndarray):
            data = np.frombuffer(data, np.uint8)
        self._data: NDArray[np.uint8] = data
        self.header = layout.checked_header(data)
        self.range = self._plane(layout.PART_RANGE, "<f4")
        self.reflectivity = self._plane(layout.PART_REFLECTIVITY, "u1")
        self.label = self._plane(layout.PART_LABEL, "<u4")
        is_dual = self.header["offsets"][layout.PART_RANGE2] != 0
        self.range2 = self._plane(layout.PART_RANGE2, "<f4") if is_dual else None
        self.reflectivity2 = self._plane(layout.PART_REFLECTIVITY2, "u1") if is_dual else None
        self.label2 = self._plane(layout.PART_LABEL2, "<u4") if is_dual else None
        self.kind = self._plane(layout.PART_KIND, "u1") if is_dual else None
        columns, margin = int(self.header["columns"]), int(self.header["margin_columns"])
        self.columns = self._part(layout.PART_COLUMNS, COLUMN, margin, columns)
        self.beams = self._part(layout.PART_BEAMS, BEAM, 0, int(self.header["rows"]))
        self.segments = self._part(layout.PART_SEGMENTS, SEGMENT, 0, int(self.header["segments"]))

    def _part(self, part: int, dtype: Any, first: int, count: int) -> Any:
        size = np.dtype(dtype).itemsize
        at = int(self.header["offsets"][part]) + first * size
        return self._data[at : at + count * size].view(dtype)

    def _plane(self, part: int, dtype: str) -> Any:
        rows, columns, margin = (int(self.header[key]) for key in ("rows", "columns", "margin_columns"))
        return self._part(part, dtype, margin * rows, columns * rows).reshape(columns, rows)

    def __repr__(self) -> str:
        """Say which sweep it is and what is in it."""
        return f"<sweepd.Sweep {_show.one_line(self._told())}>"

    def _repr_html_(self) -> str:
        """Give a table and a picture of the ranges, near ones bright, for notebooks."""
        return _show.table("Sweep", self._told()) + _show.picture(self.range)

    def _told(self) -> dict[str, str]:
        """What is said of it."""
        header, flags = self.header, [name for name in FLAGS if self.has(getattr(layout, name))]
        return {
            "sensor": self.name or self.sensor,
            "sequence": str(self.sequence),
            "time": _show.time(header["time_ns"]),
            "columns x rows": " x ".join(map(str, self.range.shape)),
            "returns": f"{header['returns']} ({header['ground']} ground)",
            "segments": str(len(self.segments)),
            "flags": ", ".join(flags) or "none",
        }

    def copy(self) -> Sweep:
        """Copy the sweep: the copy may stay for as long as you like."""
        data = self._data.copy()
        # The one that was checked, whatever a publisher has written since.
        data[: layout.HEADER.itemsize] = np.frombuffer(self.header.tobytes(), np.uint8)
        return Sweep(data)

    @property
    def sensor(self) -> str:
        """Source of the sensor's packets: IP:PORT, or the topic of a bag."""
        return str(self.header["sensor"].decode(errors="replace"))

    def _fired(self, field: str, dtype: Any, block: slice = ALL) -> Any:
        """A field of the firing that each pixel of some columns belongs to: (columns, rows); (columns, 1) if unshifted."""
        values = self.columns[field].astype(dtype)
        shift = self.beams["shift"].astype(np.int64)
        count = len(values)
        if count == 0 or not shift.any():
            return values[block, np.newaxis]
        is_circular = self.has(layout.CIRCULAR)
        at = np.arange(count)[block, np.newaxis] + (shift % count if is_circular else shift)
        return values.take(at, mode="wrap" if is_circular else "clip")

    def _turned(self, block: slice = ALL) -> Floats:
        """The azimuth of each pixel's beam, radians, perhaps outside of a turn."""
        turned: Floats = self._fired("azimuth_rate_rad_s", float, block) * self.beams["time_offset_ns"] * 1e-9
        turned += self._fired("azimuth_rad", float, block)
        turned -= self.beams["rotation_rad"]
        return turned

    def azimuth(self) -> Floats:
        """Azimuth of each pixel's beam when it fired: (columns, rows), radians, 0..2 pi, clockwise from +y."""
        azimuth = np.mod(self._turned(), 2 * np.pi)
        return np.where(azimuth < 2 * np.pi, azimuth, 0.0)

    def when(self, pixels: Any = ...) -> NDArray[np.int64]:
        """Give the time of each pixel's own shot, nanoseconds since 1970 in the clock of `header["time_source"]`.

        `pixels` selects some of (columns, rows), as an index of `range` does: a mask, or a pair of a column and a row.
        """
        after = self._fired("time_ns", np.int64) + self.beams["time_offset_ns"].astype(np.int64)
        times: NDArray[np.int64] = (after + self.header["time_ns"])[pixels]
        return times

    def points(self, frame: Frame = "sensor", *, other: bool = False) -> Floats:
        """Give the point of each pixel: (columns, rows, 3), metres; NaN where there is no return.

        `frame`: "sensor", its own axes and origin: x right, y forward, z up; "robot", the same axes from the origin of
        the robot, by the configured mount; "ros", that with the axes of ROS: x forward, y left, z up. `other`: of the
        plane `range2`.
        """
        pose = self._pose_of(frame)
        return self._moved(self._stored(other=other), [] if pose is None else [pose])

    def points_in(self, pose_at: PoseAt, frame: Frame = "sensor", *, other: bool = False) -> Floats:
        """Give the points in another frame, as `points` does: each is transformed by the pose at its own shot.

        `pose_at` gets the times of all pixels as one array, (columns, rows), nanoseconds as of `when`, and gives the
        poses of the frame at these times: (columns, rows, 4, 4), or what broadcasts to that, such as one pose of (4, 4);
        a constant pose may be given instead of the function. With the poses of a moving sensor, this deskews the sweep.

        `frame` says whose pose it is, with the axes that `points` has: that of the sensor, or that of the robot.
        """
        pose = np.asarray(pose_at(self.when()) if callable(pose_at) else pose_at, dtype=float)
        if pose.shape[-2:] != (4, 4):
            raise ValueError(f"a pose has the shape (..., 4, 4), and not {pose.shape}")
        of_sensor = self._pose_of(frame)
        poses = [pose] if of_sensor is None else [of_sensor, pose]
        return self._moved(self._stored(other=other), poses)

    def boxes(self, frame: Frame = "sensor") -> Floats:
        """Give the box of each segment: (segments, 2, 3), metres: least x, y, z and greatest.

        `frame` as in `points`. In another frame than the sensor's it is the box around the box.
        """
        return self._boxes(self.segments, frame)

    def obstacle(
        self, least_m: Sequence[float] | Floats, most_m: Sequence[float] | Floats, *, labelled: int = 3, unlabelled: int = 4
    ) -> Obstacle | None:
        """Give the nearest obstacle in a zone, or `None`.

        The zone is a box in the frame of the robot that stands on the floor: least x, y, z and greatest, metres: x right,
        y ahead, z up from the floor (`floor_m`). Where the floor is not known, all that is over and under it counts.

        An obstacle has `labelled` returns of segments, of whichever, together, or `unlabelled` returns without label, at
        most 16, that are neighbours in the image and in range, two of a pixel once. `None` does not mean that nothing is
        there: a low or thin thing may have no return, and a sensor that does not see has `layout.NOT_SEEING`. Returns that
        a mask or the limits of range keep out of segments have no label, and so can be an obstacle. The other return of a
        pixel is without label only where the segmented one is, too.

        It needs libsweepd, as `Client` does: the one in the wheel, or that which SWEEPD_LIBRARY names. Raises `SweepdError`
        where that is missing, and for a zone that is no box.
        """
        zone = np.array([least_m, most_m], dtype=float)
        counts = operator.index(labelled), operator.index(unlabelled)
        if zone.shape != (2, 3) or not all(0 <= count < 2**32 for count in counts):
            raise ValueError("a zone is two triples of numbers, and a count of returns is 0 to 4294967295")
        least, found = np.array(counts, np.uint32), np.zeros((), FOUND)
        data = np.require(self._data, requirements=["C", "ALIGNED"])
        is_found = _library.library().sweepd_find_obstacle(
            data.ctypes.data, data.nbytes, zone.ctypes.data, least.ctypes.data, found.ctypes.data
        )
        if is_found < 0:
            raise SweepdError(_library.error())
        return Obstacle(*found.item()) if is_found else None

    def _moved(self, stored: NDArray[np.float32], poses: list[Floats]) -> Floats:
        """The points of a plane, moved by one pose after another: (columns, rows, 3)."""
        columns, rows = stored.shape
        points = np.empty((columns, rows, 3))
        poses = [np.broadcast_to(pose, (columns, rows, 4, 4)) for pose in poses]
        # A few columns at a time, which stay in the cache.
        step = max(1, BLOCK_PIXELS // max(1, rows))
        for first in range(0, columns, step):
            block = slice(first, first + step)
            xyz = self._xyz(stored[block], block)
            for pose in poses:
                xyz = _apply(pose[block], xyz)
            for axis in range(3):
                points[block, :, axis] = xyz[axis]
        return points

    def _xyz(self, stored: NDArray[np.float32], block: slice) -> XYZ:
        """x, y, z of some columns in the frame of the sensor, NaN where there is no return: each (columns, rows)."""
        azimuth = self._turned(block)
        sin, cos = np.sin(azimuth), np.cos(azimuth)
        distance = np.where(stored > 0, stored, np.float32(np.nan)).astype(float)
        elevation = self.beams["elevation_rad"].astype(float)
        along = np.cos(elevation) * sin, np.cos(elevation) * cos, np.sin(elevation)
        x, y, z = along[0] * distance, along[1] * distance, along[2] * distance
        far_m, x_m, y_m = (
            self.beams[key].astype(float) for key in ("distance_offset_m", "distance_offset_x_m", "distance_offset_y_m")
        )
        slopes = (x_m - far_m) / (layout.FAR_M - layout.NEAR_X_M), (y_m - far_m) / (layout.FAR_M - layout.NEAR_Y_M)
        # The mark of a near range, of a beam with a two-point correction.
        bent = (stored.view("<u4") & 1).astype(bool) & ((slopes[0] != 0) | (slopes[1] != 0))
        if bent.any():
            _bend((x, y, z), along, slopes, distance, bent)
        sideways = self.beams["horizontal_offset_m"].astype(float)
        if sideways.any():
            x -= sideways * cos
            y += sideways * sin
        z += self.beams["vertical_offset_m"]
        return x, y, z

    def _stored(self, *, other: bool) -> NDArray[np.float32]:
        if not other:
            return self.range
        if self.range2 is None:
            raise ValueError("the sensor sends one return a shot, and there is no other")
        return self.range2

    def to_pandas(self, points: Floats | None = None, *, other: bool = False) -> Any:
        """Make a pandas `DataFrame` of the returns, a line each; of the plane `range2` with `other`.

        Columns: column, row, range_m, reflectivity, label, time_ns, and x_m, y_m, z_m of `points`, (columns, rows, 3),
        by default those of the sensor's frame.
        """
        import pandas as pd

        values = self._returns(points, other=other)
        xyz = dict(zip(("x_m", "y_m", "z_m"), values.pop("points").T))
        return pd.DataFrame({**values, **xyz})

    def segments_to_pandas(self, frame: Frame = "sensor") -> Any:
        """Make a pandas `DataFrame` of the segments, a line each, by the names of `sweepd replay --segments`.

        `frame` as in `points`: of the mean and the box.
        """
        import pandas as pd

        pose, boxes = self._pose_of(frame), self.boxes(frame)
        lengths = {"centroid_m": self.segments["centroid_m"].astype(float), "min_m": boxes[:, 0], "max_m": boxes[:, 1]}
        if pose is not None:
            lengths["centroid_m"] = lengths["centroid_m"] @ pose[:3, :3].T + pose[:3, 3]

        names = [name for name in SEGMENT.names or () if not name.startswith("reserved") and name != "flags"]
        table: dict[str, Any] = {"sensor": self.name or self.sensor, "seq": self.sequence}
        table["time_ns"] = self.header["time_ns"]
        for name in names:
            values = lengths.get(name, self.segments[name])
            if values.ndim == 1:
                table[name] = values
            else:
                table.update({f"{name[:-2]}_{axis}_m": values[:, at] for at, axis in enumerate("xyz")})
        table["wide"] = (self.segments["flags"] & SEGMENT_WIDE) != 0
        return pd.DataFrame(table, index=np.arange(len(self.segments)))

    def to_open3d(self, points: Floats | None = None, *, other: bool = False) -> Any:
        """Make a cloud of Open3D, an `open3d.t.geometry.PointCloud`, of the returns.

        `points`, (columns, rows, 3), are by default those of the sensor's frame. It has the attributes positions (f32,
        metres), intensity (f32, the reflectivity) and label (i32). `other`: of the plane `range2`.
        """
        import open3d as o3d

        values = self._returns(points, other=other)
        cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(values["points"].astype(np.float32)))
        cloud.point["intensity"] = o3d.core.Tensor(values["reflectivity"].astype(np.float32)[:, np.newaxis])
        cloud.point["label"] = o3d.core.Tensor(values["label"].astype(np.int32)[:, np.newaxis])
        return cloud

    def _returns(self, points: Floats | None, *, other: bool) -> dict[str, Any]:
        """What there is of each return, by name."""
        points = self.points(other=other) if points is None else points
        range_m = self._stored(other=other)
        there = range_m > 0
        column, row = np.nonzero(there)
        reflectivity: Any = self.reflectivity2 if other else self.reflectivity
        label: Any = self.label2 if other else self.label
        return {
            "column": column, "row": row, "range_m": range_m[there], "reflectivity": reflectivity[there],
            "label": label[there], "time_ns": self.when(there), "points": points[there],
        }  # fmt: skip


def _apply(pose: Floats, xyz: XYZ) -> XYZ:
    """Points, each moved by its pose."""
    x, y, z = xyz
    rows = (pose[..., axis, :] for axis in range(3))
    moved = [row[..., 0] * x + row[..., 1] * y + row[..., 2] * z + row[..., 3] for row in rows]
    return moved[0], moved[1], moved[2]


def _bend(
    xyz: XYZ,
    along: XYZ,
    slopes: tuple[Floats, Floats],
    distance: Floats,
    bent: NDArray[np.bool_],
) -> None:
    """Move some points onto the bent beams of an HDL-64E near by: docs/layout.md has the formula."""
    fx, fy = (1 - slope * np.abs(axis) for slope, axis in zip(slopes, along))
    gx, gy = (layout.FAR_M * slope for slope in slopes)
    px, py, pz = along[0] * fx, along[1] * fy, along[2] * ((fx + fy) / 2)
    qx, qy, qz = along[0] * gx, along[1] * gy, along[2] * ((gx + gy) / 2)
    pp = px * px + py * py + pz * pz
    pq = px * qx + py * qy + pz * qz
    qq = qx * qx + qy * qy + qz * qz
    root = pq * pq - pp * (qq - distance * distance)
    is_solved = bent & (root >= 0) & (pp > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        d = (np.sqrt(root) - pq) / pp
    for axis, p, q in zip(xyz, (px, py, pz), (qx, qy, qz)):
        np.copyto(axis, p * d + q, where=is_solved)
