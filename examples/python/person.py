"""Tells a person who walks in, once, some milliseconds after the last beam on them: person.py SENSOR.

That is an object of a person's size that has gone half a metre since it was first seen. The robot stands still.
"""

import sys
import time

import numpy as np
import sweepd

if len(sys.argv) < 2:
    sys.exit(__doc__)
# How far one goes at least until it is told, and less than that from turn to turn, metres.
WALK_M = 0.5
FORGOTTEN_NS = 1_000_000_000

# Each has its place in the robot's frame, first and last, when it was seen last, and whether it was told.
tracks = []
try:
    for message in sweepd.Client(sys.argv[1]).objects():
        for (least_m, most_m), seen_ns in zip(message.boxes("robot"), message.when()):
            *sides_m, height_m = most_m - least_m
            if not (0.2 < max(sides_m) < 1.2 and 0.8 < height_m < 2.1):
                continue
            place_m = (least_m + most_m)[:2] / 2
            tracks = [track for track in tracks if seen_ns - track["seen_ns"] < FORGOTTEN_NS]
            near = [track for track in tracks if np.linalg.norm(track["place_m"] - place_m) < WALK_M]
            track = near[0] if near else {"first_m": place_m, "is_told": False}
            if not near:
                tracks.append(track)
            track.update(place_m=place_m, seen_ns=seen_ns)
            if not track["is_told"] and np.linalg.norm(track["first_m"] - place_m) > WALK_M:
                track["is_told"] = True
                age_ms = (time.time_ns() - int(seen_ns)) / 1e6
                where = f"{place_m[0]:.2f} m right, {place_m[1]:.2f} m ahead"
                print(f"a person: {where}, seen {age_ms:.0f} ms ago", flush=True)
except KeyboardInterrupt:
    pass
