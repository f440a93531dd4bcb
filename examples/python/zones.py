"""Tells when an obstacle comes into a zone, a box on the floor in the robot's frame, and when it is gone: zones.py SENSOR.

Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.
"""

import sys

import sweepd
from sweepd.layout import PARTIAL, STOPPED

# Least and greatest x (right), y (ahead) and z (up from the floor), metres.
ZONES_M = {"ahead": ([-1, 0.5, 0.05], [1, 5, 2]), "left": ([-3, -1, 0.05], [-1, 1, 2])}
# Whole turns without an obstacle after which it is gone.
GONE = 3

if len(sys.argv) < 2:
    sys.exit(__doc__)
sensor = sys.argv[1]
client = sweepd.Client(sensor)
empty = dict.fromkeys(ZONES_M, GONE)
try:
    while True:
        sweep = client.next(timeout=1.0)
        if sweep is None:
            print(f"nothing is heard of {sensor}", file=sys.stderr, flush=True)
            continue
        if sweep.header["height_m"] == 0:
            print(f"the height of {sensor} is not known: set `height_m` in `[sensor.mount]`", file=sys.stderr, flush=True)
        is_whole = not sweep.has(PARTIAL | STOPPED)
        for zone, (least_m, most_m) in ZONES_M.items():
            is_occupied = sweep.obstacle(least_m, most_m) is not None
            # Only a whole turn has looked everywhere.
            before, empty[zone] = empty[zone], 0 if is_occupied else empty[zone] + is_whole
            if is_occupied and before >= GONE:
                print(f"{zone}: occupied", flush=True)
            if before < GONE == empty[zone]:
                print(f"{zone}: empty", flush=True)
except KeyboardInterrupt:
    pass
