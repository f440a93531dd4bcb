"""Tells when something comes into a zone, a box in the robot's frame, and when it is gone: zones.py SENSOR.

Silence does not mean that a zone is free: docs/segmentation.md says which things are seen.
"""

import sys

import numpy as np
import sweepd

# Least and greatest x (right), y (ahead) and z (up), metres. They reach below the ground, which is no thing.
ZONES_M = {"ahead": ([-1, 0.5, -5], [1, 5, 2]), "left": ([-3, -1, -5], [-1, 1, 2])}
# Fewest returns of a thing, and sweeps without them after which it is gone.
RETURNS, GONE = 3, 3

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
            print(f"there are no objects before the height of {sensor} is known", file=sys.stderr, flush=True)
        labels = [sweep.label] if sweep.label2 is None else [sweep.label, sweep.label2]
        things = np.concatenate([sweep.points("robot", other=i > 0)[label >= 2] for i, label in enumerate(labels)])
        for zone, (least_m, most_m) in ZONES_M.items():
            is_occupied = ((things > least_m) & (things < most_m)).all(axis=1).sum() >= RETURNS
            if is_occupied and empty[zone] >= GONE:
                print(f"{zone}: occupied", flush=True)
            empty[zone] = 0 if is_occupied else empty[zone] + 1
            if empty[zone] == GONE:
                print(f"{zone}: empty", flush=True)
except KeyboardInterrupt:
    pass
