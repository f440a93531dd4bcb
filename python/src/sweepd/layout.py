"""The layout of a sweep and of objects: fields, numbers and the check of a header, by the names of docs/layout.md."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# The two-point correction of an HDL-64E ends at the first; its offsets for x and y were measured at the others, metres.
FAR_M, NEAR_X_M, NEAR_Y_M = 25.04, 2.40, 1.93

# Written from the Rust types by SWEEPD_WRITE_PAGES=1 cargo test -p sweepd-sweep --test fields.
# begin fields: all
# What all sweeps have in common.
MAGIC = b"sweepd\r\n"
LAYOUT_VERSION = 3
ALIGN = 64

# Labels of a pixel; segments count from the last one on.
LABEL_NONE = 0
LABEL_GROUND = 1
LABEL_FIRST_SEGMENT = 2

# Properties of a sweep, as bits of flags.
PARTIAL = 1
CIRCULAR = 2
REVERSED = 4
BLANKED = 8
RATE_UNSTABLE = 16
STOPPED = 32
HEIGHT_ESTIMATED = 64
LOSS_ESTIMATED = 128
BLIND = 256
COVERED = 512
FROZEN = 1024
FADED = 2048
DARK_BELOW = 4096
HEIGHT_IN_DOUBT = 8192
NOT_SEEING = 0x1F00

# Properties of a segment, as bits of flags.
SEGMENT_WIDE = 1

# Which clock time_ns is in.
TIME_HOST = 0
TIME_GPS = 1

# Which of two returns is segmented.
CHOICE_NEAREST = 0
CHOICE_STRONGEST = 1
CHOICE_LAST = 2

# The parts of a sweep behind its header.
PART_RANGE = 0
PART_REFLECTIVITY = 1
PART_LABEL = 2
PART_RANGE2 = 3
PART_REFLECTIVITY2 = 4
PART_LABEL2 = 5
PART_KIND = 6
PART_COLUMNS = 7
PART_BEAMS = 8
PART_SEGMENTS = 9

# Which of a pair of dual returns a plane holds.
KIND_STRONGEST = 1
KIND_LAST = 2
KIND_SECOND_BLOCKS = 4

# The status: what a column holds.
COLUMN_MEASURED = 1
COLUMN_MISSING = 2
COLUMN_UNFIRED = 3

# A supported sensor model.
MODEL_VLP16 = 1
MODEL_PUCK_LITE = 2
MODEL_PUCK_HIRES = 3
MODEL_HDL32E = 4
MODEL_HDL64E_S2 = 5
MODEL_HDL64E_S3 = 6
MODEL_VLP32C = 7
MODEL_VLS128 = 8

# The return mode.
MODE_STRONGEST = 0x37
MODE_LAST = 0x38
MODE_DUAL = 0x39

# What all messages of objects have in common.
OBJECTS_VERSION = 1
OBJECTS_MAGIC = b"objects\n"

# Why an object is emitted.
WHY_COMPLETE = 1
WHY_SWEEP = 2
WHY_WIDE = 3
WHY_SEAM = 4

# Properties of a message of objects, as bits of flags.
OBJECTS_LAST = 1
OBJECTS_NO_HEIGHT = 2
OBJECTS_PARTIAL = 4

HEADER = np.dtype([
    ("magic", "V8"), ("version", "<u4"), ("header_bytes", "<u4"), ("total_bytes", "<u8"), ("offsets", "<u8", (10,)),
    ("rows", "<u4"), ("columns", "<u4"), ("columns_capacity", "<u4"), ("segments", "<u4"),
    ("segments_capacity", "<u4"), ("model", "<u4"), ("return_mode", "<u4"), ("return_choice", "<u4"), ("flags", "<u4"),
    ("time_source", "<u4"), ("sequence", "<u8"), ("time_ns", "<i8"), ("duration_ns", "<u8"), ("sensor_time_ns", "<i8"),
    ("arrival_ns", "<i8"), ("rpm", "<f4"), ("cut_azimuth_rad", "<f4"), ("height_m", "<f4"), ("pitch_rad", "<f4"),
    ("roll_rad", "<f4"), ("missing_columns", "<u4"), ("lost_packets", "<u4"), ("packets", "<u4"), ("returns", "<u4"),
    ("ground", "<u4"), ("decode_ns", "<u4"), ("ground_ns", "<u4"), ("label_ns", "<u4"), ("margin_columns", "<u4"),
    ("unfired_columns", "<u4"), ("dropped_datagrams", "<u4"), ("yaw_rad", "<f4"), ("height_doubt", "<u4"),
    ("position_m", "<f4", (3,)), ("reserved_268", "V4"), ("completed_ns", "<i8"), ("completed_monotonic_ns", "<i8"),
    ("run_ns", "<i8"), ("sensor", "S64"), ("name", "S64"), ("reserved_424", "V24"),
])  # fmt: skip
COLUMN = np.dtype([
    ("packet", "<u8"), ("azimuth_rad", "<f4"), ("azimuth_rate_rad_s", "<f4"), ("time_ns", "<u4"), ("block", "u1"),
    ("status", "u1"), ("reserved_22", "V2"),
])  # fmt: skip
BEAM = np.dtype([
    ("channel", "<u4"), ("elevation_rad", "<f4"), ("rotation_rad", "<f4"), ("time_offset_ns", "<u4"),
    ("vertical_offset_m", "<f4"), ("horizontal_offset_m", "<f4"), ("shift", "<i4"), ("distance_offset_m", "<f4"),
    ("distance_offset_x_m", "<f4"), ("distance_offset_y_m", "<f4"), ("reserved_40", "V8"),
])  # fmt: skip
SEGMENT = np.dtype([
    ("label", "<u4"), ("points", "<u4"), ("min_m", "<f4", (3,)), ("max_m", "<f4", (3,)), ("centroid_m", "<f4", (3,)),
    ("nearest_m", "<f4"), ("row_first", "<u2"), ("row_last", "<u2"), ("column_first", "<u4"), ("column_last", "<u4"),
    ("flags", "<u2"), ("reserved_62", "V2"),
])  # fmt: skip
OBJECT = np.dtype([
    ("segment", SEGMENT), ("first_pixel", "<u4"), ("ordinal", "<u4"), ("why", "<u4"), ("azimuth_first_rad", "<f4"),
    ("azimuth_last_rad", "<f4"), ("first_ns", "<i4"), ("last_ns", "<i4"), ("reserved_92", "V4"),
])  # fmt: skip
OBJECTS_HEADER = np.dtype([
    ("magic", "V8"), ("version", "<u4"), ("header_bytes", "<u4"), ("sequence", "<u8"), ("run_ns", "<i8"),
    ("time_ns", "<i8"), ("sent_ns", "<i8"), ("sent_monotonic_ns", "<i8"), ("time_source", "<u4"), ("flags", "<u4"),
    ("objects", "<u4"), ("first_ordinal", "<u4"), ("labels", "<u4"), ("first_label", "<u4"),
    ("position_m", "<f4", (3,)), ("yaw_rad", "<f4"), ("pitch_rad", "<f4"), ("roll_rad", "<f4"), ("height_m", "<f4"),
    ("reserved_108", "V20"), ("name", "S64"),
])  # fmt: skip
# end fields

LABEL = np.dtype("<u4")


class SweepdError(Exception):
    """No sweeps can be had, and that does not pass by waiting."""


class LayoutError(SweepdError):
    """Bytes that are not a sweep of this layout, or not objects of it."""


def other_version(what: str, reads: int = LAYOUT_VERSION) -> str:
    """Say that `what` has another layout than this package reads, and the cure."""
    return (
        f"{what}, and this program reads version {reads}: install the Python package of the sweepd that runs "
        "on this host, or run the sweepd that this one came with"
    )


def checked_header(data: NDArray[np.uint8]) -> Any:
    """Copy the header of a sweep's bytes, a record of `HEADER`, when everything in it can be true of them.

    Nothing that the copy tells lies outside of the bytes, whatever a publisher writes into its own afterwards. Raises
    `LayoutError` for all else.
    """
    if len(data) < HEADER.itemsize or data.ctypes.data % 8 != 0:
        raise LayoutError(f"{len(data)} bytes cannot hold a sweep, or are not aligned to 8 bytes")
    header = data[: HEADER.itemsize].copy().view(HEADER)[0]
    if bytes(header["magic"]) != MAGIC:
        raise LayoutError("not a sweep of sweepd: the magic bytes at its beginning are missing")
    if header["version"] != LAYOUT_VERSION:
        raise LayoutError(other_version(f"a sweep of layout version {header['version']}"))
    counts = ("rows", "columns", "columns_capacity", "segments", "segments_capacity", "margin_columns")
    rows, columns, capacity, segments, room, margin = (int(header[key]) for key in counts)
    pixels = rows * capacity
    other = pixels if header["offsets"][PART_RANGE2] != 0 else 0
    tables = [COLUMN.itemsize * capacity, BEAM.itemsize * rows, SEGMENT.itemsize * room]
    offsets, end = [], HEADER.itemsize
    for size in [4 * pixels, pixels, 4 * pixels, 4 * other, other, 4 * other, other, *tables]:
        offsets.append(end if size else 0)
        end = -(-(end + size) // ALIGN) * ALIGN if size else end
    is_bounded = rows <= 256 and capacity <= 1 << 20 and room <= 1 << 28
    if not is_bounded or margin + columns > capacity or segments > room:
        raise LayoutError("the header's counts contradict each other")
    if offsets != header["offsets"].tolist() or end != header["total_bytes"]:
        raise LayoutError("the header's offsets contradict its counts")
    if end > len(data):
        raise LayoutError(f"{len(data)} bytes cannot hold a sweep of {end}")
    return header


def checked_objects_header(data: NDArray[np.uint8]) -> Any:
    """Copy the header of a message of objects, a record of `OBJECTS_HEADER`, when all that it counts is in the bytes.

    Raises `LayoutError` for all else.
    """
    if len(data) < OBJECTS_HEADER.itemsize:
        raise LayoutError(f"{len(data)} bytes cannot hold objects")
    header = data[: OBJECTS_HEADER.itemsize].copy().view(OBJECTS_HEADER)[0]
    if bytes(header["magic"]) != OBJECTS_MAGIC:
        raise LayoutError("not objects of sweepd: the magic bytes at their beginning are missing")
    if header["version"] != OBJECTS_VERSION:
        raise LayoutError(other_version(f"objects of version {header['version']}", OBJECTS_VERSION))
    objects, labels = int(header["objects"]), int(header["labels"])
    if OBJECTS_HEADER.itemsize + objects * OBJECT.itemsize + labels * LABEL.itemsize > len(data):
        raise LayoutError(f"{len(data)} bytes cannot hold {objects} objects and {labels} labels")
    return header
