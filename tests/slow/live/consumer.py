"""Writes what the Python package receives to standard output: first an empty record, as soon as it has found the daemon;
then for each sweep i64 sensor time, u64 length, and all that must be the same in a replay, in the order of equal.rs."""

import struct
import sys

from sweepd import Client
from sweepd.layout import TIME_HOST

OF_THE_HOST = ("sequence", "run_ns", "arrival_ns", "completed_ns", "completed_monotonic_ns", "dropped_datagrams",
               "decode_ns", "ground_ns", "label_ns")


def same(sweep):
    """The bytes of a sweep but for what the layout names as the host's."""
    header = sweep.header.copy()
    for key in OF_THE_HOST:
        header[key] = 0
    header["sensor"] = header["name"] = b""
    if header["time_source"] == TIME_HOST:
        header["time_ns"] = 0
    columns = sweep.columns.copy()
    columns["packet"] = 0
    parts = (header, columns, sweep.beams, sweep.segments, sweep.range, sweep.label, sweep.range2, sweep.label2,
             sweep.reflectivity, sweep.reflectivity2, sweep.kind)
    return b"".join(part.tobytes() for part in parts if part is not None)


def write(sensor_time_ns, data):
    """A record."""
    sys.stdout.buffer.write(struct.pack("<qQ", sensor_time_ns, len(data)) + data)
    sys.stdout.buffer.flush()


roof = Client("roof", sys.argv[1])
while not roof.is_connected:
    roof.next(0.0)
write(0, b"")
for sweep in roof:
    write(int(sweep.header["sensor_time_ns"]), same(sweep))
    del sweep
