"""Prints the nearest obstacle in a box ahead of the robot (x right, y ahead, z up): nearest.py SENSOR.

The box stands on the floor. In the robot's frame the sensor is `z_m` of `[sensor.mount]` over the origin, and over the
floor its height, configured as `height_m` or estimated: the floor is where these say, but never above the origin.
No output does not mean that the way is free. What lies nearer than the lowest beam, or than the box, is not seen any
more. What one row alone strikes can be ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and
steps down are no objects. `cargo run --release --example obstacles` prints what is seen by sensor, height and distance.
"""

import os
import sys

import numpy as np
import sweepd

# The box: least and greatest x, y and z, metres.
BOX_M = np.array([[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]])

client = sweepd.Client(sys.argv[1])
try:
    while True:
        sweep = client.next(timeout=1.0)
        if sweep is None:
            print(f"nothing is heard of {sys.argv[1]}", file=sys.stderr, flush=True)
            continue
        height_m = float(sweep.header["height_m"])
        if height_m == 0:
            print(f"the height of {sweep.name} is not known yet", file=sys.stderr, flush=True)
            continue
        floor_m = min(0.0, float(sweep.header["position_m"][2]) - height_m)
        points = sweep.points("robot") - [0, 0, floor_m]
        is_within = ((points > BOX_M[0]) & (points < BOX_M[1])).all(axis=-1)
        obstacles = points[is_within & (sweep.label >= 2)]
        if len(obstacles) > 0:
            x, y, z = obstacles[np.linalg.norm(obstacles, axis=1).argmin()]
            print(f"{sweep.sequence}: {x:.2f} m right, {y:.2f} m ahead, {z:.2f} m up", flush=True)
except KeyboardInterrupt:
    pass
except BrokenPipeError:
    # The reader had enough. At its end, Python would write what is left once more.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
