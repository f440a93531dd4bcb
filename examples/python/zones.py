"""Tells when an obstacle comes into a zone, a box on the floor in the robot's frame, and when it is gone: zones.py SENSOR.

Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.
"""

import sys

import sweepd

# Least and greatest x (right), y (ahead) and z (up from the floor), metres.
ZONES_M = {"ahead": ([-1, 0.5, 0.05], [1, 5, 2]), "left": ([-3, -1, 0.05], [-1, 1, 2])}
# Sweeps without an obstacle after which it is gone.
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
            print(f"the height of {sensor} is not known yet, nor is what is ground", file=sys.stderr, flush=True)
            continue
        for zone, (least_m, most_m) in ZONES_M.items():
            is_occupied = sweep.obstacle(least_m, most_m) is not None
            if is_occupied and empty[zone] >= GONE:
                print(f"{zone}: occupied", flush=True)
            empty[zone] = 0 if is_occupied else empty[zone] + 1
            if empty[zone] == GONE:
                print(f"{zone}: empty", flush=True)
except KeyboardInterrupt:
    pass
