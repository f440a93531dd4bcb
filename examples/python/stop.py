"""Says "stop" while an object reaches into a box ahead of the robot, and how old its newest return is: stop.py SENSOR."""

import sys
import time

import numpy as np
import sweepd
from sweepd.layout import OBJECTS_NO_HEIGHT

# The box in the frame of the robot, least and greatest x, y and z, metres; an object with more points than this counts.
STOP_M = np.array([[-1.0, 0.5, 0.1], [1.0, 5.0, 2.0]])
POINTS = 20

name = sys.argv[1]
objects = sweepd.Client(name).objects()
while True:
    message = objects.next(timeout=1.0)
    if message is None:
        print(f"stop: nothing is heard of {name}", flush=True)
        continue
    if message.has(OBJECTS_NO_HEIGHT):
        print(f"stop: the height of {name} is not known yet", flush=True)
    least_m, most_m = message.boxes("robot").transpose(1, 0, 2)
    reaches = ((least_m < STOP_M[1]) & (most_m > STOP_M[0])).all(axis=1)
    segments = message.objects["segment"]
    # Parts too: a wide object is told in parts first.
    counts = reaches & (segments["points"] > POINTS)
    for nearest_m, at_ns in zip(segments["nearest_m"][counts], message.when()[counts]):
        age_ms = (time.time_ns() - int(at_ns)) / 1e6
        print(f"stop: an object at {nearest_m:.2f} m, seen {age_ms:.1f} ms ago", flush=True)
