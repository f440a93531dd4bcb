"""Says "stop" while an object reaches into a box ahead of the robot, and how old its newest return is.

    stop.py SENSOR [MODEL]

It also says so while sweeps stay away for 0.3 s, while the sensor does not see what it should, and of a sweep of
another model: a number of docs/layout.md, by default that of the first sweep.

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
from sweepd.layout import NOT_SEEING, OBJECTS_NO_HEIGHT

# The box, least and greatest x (right), y (ahead) and z (up from the floor), metres.
STOP_M = np.array([[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]])
# A sensor that is well gives a sweep at least this often, seconds: it turns five times a second or faster.
SILENCE_S = 0.3

if len(sys.argv) < 2:
    sys.exit(__doc__)
name = sys.argv[1]
model = int(sys.argv[2]) if len(sys.argv) > 2 else None
client = sweepd.Client(name)
objects = client.objects()
heard_s = 0.0
try:
    while True:
        message = objects.next(timeout=SILENCE_S)
        while (sweep := client.next(timeout=0)) is not None:
            heard_s = time.monotonic()
            model = model or int(sweep.header["model"])
            if sweep.header["model"] != model:
                print(f"stop: {name} is of model {sweep.header['model']}, not {model}", flush=True)
            if sweep.has(NOT_SEEING):
                print(f"stop: {name} does not see what it should, its flags are {sweep.header['flags']:#x}", flush=True)
        if message is None or time.monotonic() - heard_s > SILENCE_S:
            print(f"stop: nothing is heard of {name}", flush=True)
        if message is None:
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
except KeyboardInterrupt:
    pass
