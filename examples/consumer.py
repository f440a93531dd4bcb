#!/usr/bin/env python3
"""Prints a line for each sweep of a sensor that sweepd publishes on this host: consumer.py NAME [ROOT]; Ctrl-C ends it.

With --objects before NAME, a line for each object while the head turns. Needs the Python package: pip install sweepd-*.whl
"""

import os
import sys
import time

import sweepd
from sweepd.layout import WHY_WIDE

if len(sys.argv) < 2:
    sys.exit(__doc__)
is_objects = sys.argv[1] == "--objects"
name, *root = sys.argv[1 + is_objects :]
sensor = sweepd.Client(name, *root)

try:
    for message in sensor.objects() if is_objects else ():
        for told, at_ns in zip(message.objects, message.when()):
            age_ms = (time.time_ns() - int(at_ns)) / 1e6
            what, segment = "part" if told["why"] == WHY_WIDE else "object", told["segment"]
            what = f"{what} {told['ordinal']}, {age_ms:.1f} ms"
            size = f"{segment['points']} points, nearest {segment['nearest_m']:.2f} m"
            print(f"{name} {message.sequence}: {what}, {size}", flush=True)

    for sweep in sensor:
        latency_ms = (time.time_ns() - int(sweep.header["arrival_ns"])) / 1e6
        nearest_m = sweep.segments["nearest_m"].min(initial=float("inf"))
        what = f"{latency_ms:.1f} ms, {len(sweep.segments)} segments, nearest {nearest_m:.2f} m"
        print(f"{name} {sweep.sequence}: {what}", flush=True)
        # Not held while waiting for the next.
        del sweep
except KeyboardInterrupt:
    pass
except BrokenPipeError:
    # The reader had enough. At its end, Python would write what is left once more.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
