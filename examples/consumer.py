#!/usr/bin/env python3
"""The sweeps of a running sweepd in Python: NumPy arrays in the memory that the daemon wrote, without a copy.

    pip install iceoryx2==0.10.0 numpy
    python3 examples/consumer.py roof            # one line a sweep; Ctrl-C ends it
    python3 examples/consumer.py roof --json

Or in a program of your own, with this file beside it:

    from consumer import Sensor

    for sweep in Sensor("roof"):
        obstacles = sweep.points()[sweep.label >= 2]          # x right, y forward, z up, metres
        nearest = sweep.segments["nearest_m"].min(initial=float("inf"))

What there is to know:

* It may be started before the daemon, and goes on when that was restarted.
* It must run as the daemon's user. Another one is refused here with both names; iceoryx2 would open the service for root
  and deliver nothing.
* The arrays are read-only: they are the daemon's memory, where a write would be a segmentation fault.
* Every array keeps its sweep alive, so what you hold never changes. But no consumer may hold more than two sweeps: copy
  (`sweep.range.copy()`) what is to last, and drop the rest.
* A consumer that is slow gets the newest two; `Sensor.latest` skips to the newest one.
* A `Sensor` and its sweeps belong to one thread.

docs/layout.md says what each byte means; numbers and names here are those of that page.
"""

import argparse
import collections
import ctypes
import json
import os
import pwd
import re
import stat
import sys
import time

import iceoryx2 as iox2
import numpy as np

MAGIC = b"sweepd\r\n"
LAYOUT_VERSION = 3
ALIGN = 64

# Bits of header["flags"].
(PARTIAL, CIRCULAR, REVERSED, BLANKED, RATE_UNSTABLE, STOPPED, HEIGHT_ESTIMATED,
 LOSS_ESTIMATED) = (1 << bit for bit in range(8))
# Labels; segments count from the last one on.
LABEL_NONE, LABEL_GROUND, LABEL_FIRST_SEGMENT = 0, 1, 2
# header["time_source"]
TIME_HOST, TIME_GPS = 0, 1
# header["return_mode"]
MODE_STRONGEST, MODE_LAST, MODE_DUAL = 0x37, 0x38, 0x39
# columns["status"]
COLUMN_MEASURED, COLUMN_MISSING, COLUMN_UNFIRED = 1, 2, 3
# A byte of `kind`: one of the first two, and perhaps the bit.
KIND_STRONGEST, KIND_LAST, KIND_SECOND_BLOCKS = 1, 2, 4

(PART_RANGE, PART_REFLECTIVITY, PART_LABEL, PART_RANGE2, PART_REFLECTIVITY2, PART_LABEL2, PART_KIND, PART_COLUMNS,
 PART_BEAMS, PART_SEGMENTS) = range(10)

HEADER = np.dtype([
    ("magic", "V8"), ("version", "<u4"), ("header_bytes", "<u4"), ("total_bytes", "<u8"), ("offsets", "<u8", 10),
    ("rows", "<u4"), ("columns", "<u4"), ("columns_capacity", "<u4"), ("segments", "<u4"), ("segments_capacity", "<u4"),
    ("model", "<u4"), ("return_mode", "<u4"), ("return_choice", "<u4"), ("flags", "<u4"), ("time_source", "<u4"),
    ("sequence", "<u8"), ("time_ns", "<i8"), ("duration_ns", "<u8"), ("sensor_time_ns", "<i8"), ("arrival_ns", "<i8"),
    ("rpm", "<f4"), ("cut_azimuth_rad", "<f4"), ("height_m", "<f4"), ("pitch_rad", "<f4"), ("roll_rad", "<f4"),
    ("missing_columns", "<u4"), ("lost_packets", "<u4"), ("packets", "<u4"), ("returns", "<u4"), ("ground", "<u4"),
    ("decode_ns", "<u4"), ("ground_ns", "<u4"), ("label_ns", "<u4"), ("margin_columns", "<u4"),
    ("unfired_columns", "<u4"), ("dropped_datagrams", "<u4"), ("yaw_rad", "<f4"), ("reserved_252", "<u4"),
    ("position_m", "<f4", 3), ("reserved_268", "<u4"), ("completed_ns", "<i8"), ("completed_monotonic_ns", "<i8"),
    ("run_ns", "<i8"), ("sensor", "S64"), ("name", "S64"), ("reserved_424", "V24"),
])
COLUMN = np.dtype([
    ("packet", "<u8"), ("azimuth_rad", "<f4"), ("azimuth_rate_rad_s", "<f4"), ("time_ns", "<u4"), ("block", "u1"),
    ("status", "u1"), ("reserved_22", "V2"),
])
BEAM = np.dtype([
    ("channel", "<u4"), ("elevation_rad", "<f4"), ("rotation_rad", "<f4"), ("time_offset_ns", "<u4"),
    ("vertical_offset_m", "<f4"), ("horizontal_offset_m", "<f4"), ("shift", "<i4"), ("distance_offset_m", "<f4"),
    ("distance_offset_x_m", "<f4"), ("distance_offset_y_m", "<f4"), ("reserved_40", "V8"),
])
SEGMENT = np.dtype([
    ("label", "<u4"), ("points", "<u4"), ("min_m", "<f4", 3), ("max_m", "<f4", 3), ("centroid_m", "<f4", 3),
    ("nearest_m", "<f4"), ("row_first", "<u2"), ("row_last", "<u2"), ("column_first", "<u4"), ("column_last", "<u4"),
    ("reserved_60", "V4"),
])
assert (HEADER.itemsize, COLUMN.itemsize, BEAM.itemsize, SEGMENT.itemsize) == (448, 24, 48, 64)

# Seconds: how long is slept at once before it is looked whether everything is still there, and how often it is looked for
# a service that is not there.
LOOK_EVERY_S = 0.2
SEEK_EVERY_S = 0.1
# A file that is unfinished for so long has no maker any more.
ABANDONED_AFTER_S = 1.0
# How long places of consumers that died are waited for.
FULL_FOR_S = 2.0
SHARED_MEMORY = "/dev/shm"
# What iceoryx2 needs there for a consumer, with room to spare.
OVERHEAD_BYTES = 256 * 1024
# The shortest that is slept: less than a microsecond would be for ever, since the socket is told whole ones.
LEAST_S = 0.0001
# Sweeps that a consumer may hold.
BORROWED = 2


class SweepdError(Exception):
    """No sweeps can be had, and waiting longer does not mend it."""


class LayoutError(SweepdError):
    """Bytes that are not a sweep of this layout."""


class Preamble(ctypes.Structure):
    """What stands in front of the bytes of a sweep: iceoryx2's user header."""

    _fields_ = [
        ("layout_version", ctypes.c_uint32),
        ("reserved_4", ctypes.c_uint32),
        ("sweep_bytes", ctypes.c_uint64),
        ("reserved_16", ctypes.c_uint8 * 48),
    ]

    @staticmethod
    def type_name():
        """The name by which iceoryx2 tells types apart."""
        return "sweepd.Preamble"


def default_root():
    """The folder by which daemon and consumers find each other where none is named."""
    named = os.environ.get("SWEEPD_ROOT")
    return named or ("/run/sweepd/iox2" if os.path.isdir("/run/sweepd") else "/tmp/sweepd/iox2")


def absolute(root):
    """The path from the top; links are not followed, as the daemon does not."""
    path = os.path.join(os.getcwd(), root)
    parts = [part for part in path.split("/") if part not in ("", ".")]
    return "/" + "/".join(parts)


def prefix(root):
    """What the names of all files of a folder begin with, there and in /dev/shm."""
    if root in ("/run/sweepd/iox2", "/tmp/sweepd/iox2"):
        return "sweepd_"
    fnv_1a = 0xCBF29CE484222325
    for byte in os.fsencode(root):
        fnv_1a = (fnv_1a ^ byte) * 0x100000001B3 % (1 << 64)
    return f"sweepd_{fnv_1a:016x}_"


def check_owner(root):
    """Whether the folder is there; one of another user is an error, since that would silently deliver nothing."""
    try:
        # A link of another user is not followed.
        owner = os.lstat(root).st_uid
        if owner == os.geteuid():
            owner = os.stat(root).st_uid
    except FileNotFoundError:
        return False
    except OSError as error:
        raise SweepdError(f"cannot use {root} for shared memory: {error}") from error

    def name(uid):
        try:
            return pwd.getpwuid(uid).pw_name
        except KeyError:
            return f"number {uid}"

    own = os.geteuid()
    if owner != own:
        raise SweepdError(
            f"{root} belongs to user {name(owner)}, this program runs as {name(own)}: sweeps are shared within one user "
            f"alone. Run it as {name(owner)} (`sudo -u {name(owner)} ...`, or `User={name(owner)}` in its systemd unit)")
    return True


def is_shared_memory_ready(root):
    """Whether iceoryx2 can be called now. It would wait for ever for a file that a process left empty when it died, and a
    page that is missing would end this program without a word. The daemon removes such files within a second or two."""
    free = os.statvfs(SHARED_MEMORY)
    free = free.f_bavail * free.f_frsize
    if free < OVERHEAD_BYTES:
        raise SweepdError(
            f"{SHARED_MEMORY} has {free} bytes free and {OVERHEAD_BYTES} are needed, {OVERHEAD_BYTES - free} more: make it "
            f"larger (`mount -o remount,size=1G {SHARED_MEMORY}`, or --shm-size for a container) or free some")
    is_ready = True
    # The prefix of the usual folders is the beginning of all others.
    name_of_root = re.compile(prefix(root) + "[0-9a-f]{40}_")
    for entry in os.scandir(SHARED_MEMORY):
        if not name_of_root.match(entry.name):
            continue
        try:
            status = entry.stat(follow_symlinks=False)
        except FileNotFoundError:
            continue
        if status.st_uid != os.geteuid():
            if entry.name.endswith(".global_mgmt"):
                raise SweepdError(
                    f"{entry.path} belongs to user number {status.st_uid} and stands where a file of this user must be: "
                    f"have it removed (`sudo rm {entry.path}`)")
            continue
        is_unfinished = status.st_size == 0 or not status.st_mode & stat.S_IRUSR
        if is_unfinished and time.time() - status.st_ctime >= ABANDONED_AFTER_S:
            os.unlink(entry.path)
        elif is_unfinished:
            is_ready = False
    return is_ready


class _Memory:
    """The bytes of a sample. NumPy keeps this object, and so the sample, for as long as any array looks at it."""

    def __init__(self, sample, subscriber):
        # With the subscriber, iceoryx2 would give back what its samples still look at.
        self.sample, self.subscriber = sample, subscriber
        payload, preamble = sample.payload(), sample.user_header().contents
        version, length, there = preamble.layout_version, preamble.sweep_bytes, payload.len()
        if version != LAYOUT_VERSION:
            raise LayoutError(_other_version(f"a sweep of layout version {version}"))
        if length > there:
            raise LayoutError(f"torn: {length} bytes are named and {there} are there")
        read_only = True
        self.__array_interface__ = {
            "version": 3, "typestr": "|u1", "shape": (length,), "data": (payload.as_ptr(), read_only)
        }


class Sweep:
    """One sweep: views of its bytes, trimmed to the columns and segments that there are.

    header                              a record, by the names of docs/layout.md: sweep.header["rpm"]
    range, reflectivity, label          arrays of (columns, rows): metres (0 = no return), 0..255, 0 none 1 ground 2.. segment
    range2, reflectivity2, label2, kind the same of the other return of a dual sensor, else None
    columns, beams, segments            the tables, as structured arrays
    """

    def __init__(self, data):
        """Checks `data`, the bytes of a sweep: an array of u8, or what NumPy takes for one, as a file's content."""
        data = data if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)
        self.header = header = _checked(data)
        rows, columns, margin = (int(header[key]) for key in ("rows", "columns", "margin_columns"))

        def part(index, dtype, first, count):
            at = int(header["offsets"][index]) + first * np.dtype(dtype).itemsize
            return data[at:at + count * np.dtype(dtype).itemsize].view(dtype)

        def plane(index, dtype):
            is_there = header["offsets"][index] != 0 or index < PART_RANGE2
            return part(index, dtype, margin * rows, columns * rows).reshape(columns, rows) if is_there else None

        self.range = plane(PART_RANGE, "<f4")
        self.reflectivity = plane(PART_REFLECTIVITY, "u1")
        self.label = plane(PART_LABEL, "<u4")
        self.range2 = plane(PART_RANGE2, "<f4")
        self.reflectivity2 = plane(PART_REFLECTIVITY2, "u1")
        self.label2 = plane(PART_LABEL2, "<u4")
        self.kind = plane(PART_KIND, "u1")
        self.columns = part(PART_COLUMNS, COLUMN, margin, columns)
        self.beams = part(PART_BEAMS, BEAM, 0, rows)
        self.segments = part(PART_SEGMENTS, SEGMENT, 0, int(header["segments"]))

    @property
    def sequence(self):
        """Sweeps of this sensor before this one."""
        return int(self.header["sequence"])

    @property
    def name(self):
        """Name of the sensor."""
        return self.header["name"].decode(errors="replace")

    def has(self, flag):
        """Whether a bit of the flags is set: sweep.has(CIRCULAR)."""
        return bool(self.header["flags"] & flag)

    def firing(self):
        """The firing that each pixel belongs to: `columns` once a pixel, (columns, rows). Where rows are not shifted, as
        on all but the HDL-64E, it is (columns, 1)."""
        shift = self.beams["shift"].astype(np.int64)
        if not shift.any():
            return self.columns[:, np.newaxis]
        count = len(self.columns)
        at = np.arange(count)[:, np.newaxis] + shift
        return self.columns[at % count if self.has(CIRCULAR) else at.clip(0, count - 1)]

    def azimuth(self):
        """Azimuth of each pixel's beam when it fired, radians, 0..2 pi, clockwise from +y: (columns, rows)."""
        firing = self.firing()
        turned = firing["azimuth_rate_rad_s"].astype(float) * self.beams["time_offset_ns"] * 1e-9
        azimuth = np.mod(firing["azimuth_rad"] + turned - self.beams["rotation_rad"], 2 * np.pi)
        return np.where(azimuth < 2 * np.pi, azimuth, 0.0)

    def times(self):
        """When each pixel's beam fired, nanoseconds since 1970 in the clock of header["time_source"]: (columns, rows)."""
        after = self.firing()["time_ns"].astype(np.int64) + self.beams["time_offset_ns"]
        return self.header["time_ns"] + after

    def points(self, other=False):
        """x right, y forward, z up of each pixel, metres from the sensor's origin: (columns, rows, 3). NaN where there is
        no return. `other`: those of the plane `range2`."""
        stored = self.range2 if other else self.range
        azimuth = self.azimuth()
        distance = np.where(stored > 0, stored, np.nan).astype(float)
        sin, cos = np.sin(azimuth), np.cos(azimuth)
        elevation = self.beams["elevation_rad"].astype(float)
        along = np.stack([np.cos(elevation) * sin, np.cos(elevation) * cos, np.sin(elevation) + 0 * sin], axis=-1)
        point = along * distance[..., np.newaxis]
        bent = (stored.view("<u4") & 1 == 1) & self._is_corrected()
        if bent.any():
            point[bent] = self._bent(along, distance)[bent]
        sideways = self.beams["horizontal_offset_m"].astype(float)
        up = self.beams["vertical_offset_m"].astype(float)
        return point + np.stack([-sideways * cos, sideways * sin, up + 0 * cos], axis=-1)

    def _is_corrected(self):
        """Which rows have a two-point correction."""
        far = self.beams["distance_offset_m"]
        return (self.beams["distance_offset_x_m"] != far) | (self.beams["distance_offset_y_m"] != far)

    def _bent(self, along, distance):
        """Points along the beams of an HDL-64E near by: each axis is a multiple of d and a constant, and d is the one at
        which the length is the stored range."""
        far_m, x_m, y_m = 25.04, 2.40, 1.93
        offset = [self.beams[key].astype(float) for key in
                  ("distance_offset_m", "distance_offset_x_m", "distance_offset_y_m")]
        slope = [(offset[1] - offset[0]) / (far_m - x_m), (offset[2] - offset[0]) / (far_m - y_m)]
        times_d = [1 - slope[axis] * np.abs(along[..., axis]) for axis in (0, 1)]
        base = [slope[axis] * far_m + 0 * times_d[axis] for axis in (0, 1)]
        times_d = along * np.stack([*times_d, (times_d[0] + times_d[1]) / 2], axis=-1)
        base = along * np.stack([*base, (base[0] + base[1]) / 2], axis=-1)
        square, linear = (times_d * times_d).sum(-1), (times_d * base).sum(-1)
        root = linear**2 - square * ((base * base).sum(-1) - distance**2)
        with np.errstate(invalid="ignore", divide="ignore"):
            d = (np.sqrt(root) - linear) / square
        solved = ((root >= 0) & (square > 0))[..., np.newaxis]
        return np.where(solved, times_d * d[..., np.newaxis] + base, along * distance[..., np.newaxis])


def _checked(data):
    """A copy of the header, when everything in it can be true of these bytes: nothing that it tells lies outside of them,
    whatever a publisher should write into its own afterwards."""
    if len(data) < HEADER.itemsize or data.ctypes.data % 8 != 0:
        raise LayoutError(f"{len(data)} bytes cannot hold a sweep, or are not aligned to 8 bytes")
    header = data[:HEADER.itemsize].copy().view(HEADER)[0]
    if bytes(header["magic"]) != MAGIC:
        raise LayoutError("no sweep of sweepd: it does not begin with its mark")
    if header["version"] != LAYOUT_VERSION:
        raise LayoutError(_other_version(f"a sweep of layout version {header['version']}"))
    rows, columns, capacity, segments, room, margin = (
        int(header[key]) for key in
        ("rows", "columns", "columns_capacity", "segments", "segments_capacity", "margin_columns"))
    pixels = rows * capacity
    other = pixels if header["offsets"][PART_RANGE2] != 0 else 0
    sizes = [4 * pixels, pixels, 4 * pixels, 4 * other, other, 4 * other, other,
             COLUMN.itemsize * capacity, BEAM.itemsize * rows, SEGMENT.itemsize * room]
    offsets, end = [], HEADER.itemsize
    for size in sizes:
        offsets.append(end if size else 0)
        end = -(-(end + size) // ALIGN) * ALIGN if size else end
    bounded = rows <= 256 and capacity <= 1 << 20 and room <= 1 << 28
    if not bounded or margin + columns > capacity or segments > room:
        raise LayoutError("the header's counts contradict each other")
    if offsets != header["offsets"].tolist() or end != header["total_bytes"]:
        raise LayoutError("the header's offsets contradict its counts")
    if end > len(data):
        raise LayoutError(f"{len(data)} bytes cannot hold a sweep of {end}")
    return header


def _other_version(what):
    return (f"{what}, and this program reads version {LAYOUT_VERSION}: take the consumer.py of the sweepd that runs on this "
            "host, or run the sweepd that this one came with")


class Sensor:
    """The sweeps of one sensor, one after the other; also an iterator over them that never ends."""

    def __init__(self, name, root=None):
        """The sensor of this name; the daemon need not run yet. `root`: the daemon's folder, if not the default one."""
        self.name = name
        self.root = absolute(root or default_root())
        self.reopened = 0
        self._service_name = iox2.ServiceName.new(f"sweepd/{name}/sweep")
        self._open = None
        self._file = None
        self._looked = time.monotonic()
        self._full_since = None
        # What fails is an exception here; iceoryx2 would write it to standard error as well.
        iox2.set_log_level(iox2.LogLevel.Fatal)

    def __iter__(self):
        return self

    def __next__(self):
        return self.next()

    @property
    def is_connected(self):
        """Whether the service was found; the daemon may be gone for all that."""
        return self._open is not None

    @property
    def is_published(self):
        """Whether a daemon publishes at the moment."""
        return self._open is not None and self._open.service.dynamic_config.number_of_publishers > 0

    def attribute(self, key):
        """An attribute of the service, once it was found: "schema", "model" or "address"."""
        if self._open is None:
            return None
        values = self._open.service.attributes.key_values(iox2.AttributeKey.new(key))
        return values[0].to_string() if values else None

    def latest(self, timeout=None):
        """As `next`, but of several sweeps that wait the newest."""
        sweep = self.next(timeout)
        while sweep is not None and self._open is not None and self._open.subscriber.has_samples():
            # Given back first: no more than two may be held.
            sweep = None
            sweep = self.next(timeout)
        return sweep

    def next(self, timeout=None):
        """The next sweep. Waits for it, and for the daemon if there is none, but at most `timeout` seconds; None when none
        came. Raises SweepdError for what waiting longer does not mend."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            if self._open is None:
                self._open = self._find()
            rest = LOOK_EVERY_S if deadline is None else max(0.0, deadline - time.monotonic())
            if self._open is None:
                if rest == 0.0:
                    return None
                time.sleep(min(rest, SEEK_EVERY_S))
                continue
            sample = self._receive()
            if sample is not None:
                return Sweep(np.asarray(_Memory(sample, self._open.subscriber)))
            if time.monotonic() - self._looked >= LOOK_EVERY_S:
                self._looked = time.monotonic()
                if not self._open.is_current():
                    # Its files are gone or another's: nobody tells, and nothing would come any more.
                    self._open = None
                    self.reopened += 1
                    continue
            if rest == 0.0:
                return None
            try:
                self._open.listener.timed_wait(iox2.Duration.from_secs_f64(max(LEAST_S, min(rest, LOOK_EVERY_S))))
            except iox2.ListenerWaitError:
                # A signal; Ctrl-C comes as KeyboardInterrupt.
                time.sleep(0.001)

    def _receive(self):
        try:
            return self._open.subscriber.receive()
        except iox2.ReceiveError as error:
            if "ExceedsMaxBorrows" in repr(error):
                raise SweepdError(
                    f"this program holds {BORROWED} sweeps of `{self.name}` already, and no consumer may hold more; drop "
                    "one first, with all arrays that look at it, or copy them") from error
            # The memory of a daemon that is going away: the next look tells.
            return None

    def _find(self):
        """Looks for the service: None when it is not there, or not yet whole."""
        if not check_owner(self.root) or not is_shared_memory_ready(self.root):
            return None
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(self.root)
        config.global_cfg.prefix = iox2.FileName.new(prefix(self.root))
        # The daemon does that, on a thread that may wait.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        try:
            builder = iox2.NodeBuilder.new().config(config).signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            node = builder.create(iox2.ServiceType.Ipc)
            if self._file is None:
                self._file = _service_file(self.root, config, self._samples(node))
            # Read first: a service that is made anew after this has another file.
            content = _content(self._file)
            service = self._samples(node)
            event = node.service_builder(self._service_name).event().open()
            subscriber = service.subscriber_builder().create()
            self._full_since = None
            return _Open(node, service, event.listener_builder().create(), subscriber, self._file, content)
        except (iox2.PublishSubscribeOpenError, iox2.SubscriberCreateError, iox2.EventOpenError) as error:
            self._explain(repr(error), error, config)
            return None

    def _samples(self, node):
        schema = iox2.AttributeVerifier.new().require(
            iox2.AttributeKey.new("schema"), iox2.AttributeValue.new(str(LAYOUT_VERSION)))
        builder = node.service_builder(self._service_name).publish_subscribe(iox2.Slice[ctypes.c_uint8])
        return builder.user_header(Preamble).open_with_attributes(schema)

    def _published_version(self, config):
        """The version of the layout that the service names; None when it names none."""
        pattern = iox2.MessagingPattern.PublishSubscribe
        try:
            details = iox2.Service.details(self._service_name, config, pattern, iox2.ServiceType.Ipc)
        except iox2.ServiceDetailsError:
            details = None
        values = [] if details is None else details.attributes().key_values(iox2.AttributeKey.new("schema"))
        return values[0].to_string() if values else None

    def _explain(self, said, error, config):
        """Raises what waiting does not mend."""
        if any(f"Incompatible{what}" in said for what in ("Attributes", "Types", "MessagingPattern")):
            found = self._published_version(config)
            if found is None or found == str(LAYOUT_VERSION):
                raise SweepdError(
                    f"`{self.name}` is published by a program that is not sweepd: stop that one, or give sweepd and its "
                    "consumers a folder of their own (--root, or the variable SWEEPD_ROOT)") from error
            raise SweepdError(_other_version(f"the sweeps of `{self.name}` have layout version {found}")) from error
        if "VersionMismatch" in said:
            raise SweepdError(
                f"`{self.name}` is published through another version of iceoryx2 than this program's: install the one that "
                "docs/layout.md of the sweepd on this host names") from error
        if any(word in said for word in ("ExceedsMaxNumberOfNodes", "ExceedsMaxSupportedSubscribers")):
            # Consumers that died hold their places until the daemon has cleaned up, which it does each second.
            self._full_since = self._full_since or time.monotonic()
            if time.monotonic() - self._full_since < FULL_FOR_S:
                return
            raise SweepdError(
                f"`{self.name}` has as many consumers as it has room for; raise max_consumers of the sensor, or stop one"
            ) from error


class _Open:
    """A service that was found."""

    def __init__(self, node, service, listener, subscriber, file, content):
        self.node, self.service, self.listener, self.subscriber = node, service, listener, subscriber
        self.file, self.content = file, content

    def is_current(self):
        """Whether the service that was opened is the one that others find. Its file names its own number, so that one that
        was made anew is another even under the same name."""
        return self.content is not None and _content(self.file) == self.content


def _service_file(root, config, service):
    """The file by which a service is found."""
    of_services = config.global_cfg.service
    file = f"{prefix(root)}{service.service_hash.as_str}{of_services.static_config_storage_suffix.to_string()}"
    return os.path.join(root, of_services.directory.to_string(), file)


def _content(file):
    try:
        with open(file, "rb") as opened:
            return opened.read()
    except OSError:
        return None


def main():
    """Prints a line a sweep."""
    parser = argparse.ArgumentParser(description="Prints a line for each sweep of a sensor that sweepd publishes.")
    parser.add_argument("name", help="name of the sensor")
    parser.add_argument("--root", help="the daemon's folder, if not the default one")
    parser.add_argument("--json", action="store_true", help="a JSON object a line")
    parser.add_argument("--count", type=int, help="end after so many sweeps")
    args = parser.parse_args()
    sensor = Sensor(args.name, args.root)
    received = collections.deque(maxlen=11)
    before = None
    while args.count is None or args.count > 0:
        sweep = sensor.next(1.0)
        if sweep is None:
            state = "is silent" if sensor.is_published else "is not published"
            print(f"{args.name} {state}", file=sys.stderr)
            continue
        now_ns, sequence, segments = time.time_ns(), sweep.sequence, sweep.segments
        received.append(time.monotonic())
        rate_hz = (len(received) - 1) / max(received[-1] - received[0], 1e-9)
        latency_ms = (now_ns - int(sweep.header["arrival_ns"])) / 1e6
        nearest_m = float(segments["nearest_m"].min()) if len(segments) else None
        missed = 0 if before is None else max(0, sequence - before - 1)
        if args.json:
            print(json.dumps({
                "sensor": args.name, "seq": sequence, "missed": missed, "rate_hz": round(rate_hz, 2),
                "latency_ms": round(latency_ms, 3), "columns": len(sweep.columns), "rows": len(sweep.beams),
                "returns": int(sweep.header["returns"]), "segments": len(segments), "nearest_m": nearest_m,
            }), flush=True)
        else:
            nearest = "none" if nearest_m is None else f"{nearest_m:.2f} m"
            print(f"{args.name} {sequence}: {rate_hz:.1f} Hz, {latency_ms:.1f} ms, {len(segments)} segments, nearest {nearest}",
                  flush=True)
        before = sequence
        # Not held while waiting for the next.
        del sweep, segments
        args.count = None if args.count is None else args.count - 1


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
    except SweepdError as problem:
        sys.exit(f"consumer.py: {problem}")
