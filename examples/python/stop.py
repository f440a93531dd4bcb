"""Says "stop" while an object reaches into a box ahead of the robot, and how old its newest return is: stop.py SENSOR.

The box stands on the floor. In the robot's frame the sensor is `z_m` of `[sensor.mount]` over the origin, and over the
floor its height, configured as `height_m` or estimated: the floor is where these say, but never above the origin.
No output does not mean that the way is free. What lies nearer than the lowest beam, or than the box, is not seen any
more. What one row alone strikes can be ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and
steps down are no objects. `cargo run --release --example obstacles` prints what is seen by sensor, height and distance.
"""

import sys
import time

import numpy as np
import sweepd
from sweepd.layout import OBJECTS_NO_HEIGHT

# The box, least and greatest x (right), y (ahead) and z (up from the floor), metres.
STOP_M = np.array([[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]])

name = sys.argv[1]
objects = sweepd.Client(name).objects()
while True:
    message = objects.next(timeout=1.0)
    if message is None:
        print(f"stop: nothing is heard of {name}", flush=True)
        continue
    if message.has(OBJECTS_NO_HEIGHT):
        print(f"stop: the height of {name} is not known yet", flush=True)
    up_m, height_m = float(message.header["position_m"][2]), float(message.header["height_m"])
    if up_m <= 0 and height_m <= 0:
        print(f"stop: {name} has no z_m in [sensor.mount] and no height: where is the floor?", flush=True)
    floor_m = min(0.0, up_m - height_m)
    least_m, most_m = (message.boxes("robot") - [0, 0, floor_m]).transpose(1, 0, 2)
    # Parts too: a wide object is told in parts first.
    reaches = ((least_m < STOP_M[1]) & (most_m > STOP_M[0])).all(axis=1)
    for nearest_m, at_ns in zip(message.objects["segment"]["nearest_m"][reaches], message.when()[reaches]):
        age_ms = (time.time_ns() - int(at_ns)) / 1e6
        print(f"stop: an object at {nearest_m:.2f} m, seen {age_ms:.1f} ms ago", flush=True)
