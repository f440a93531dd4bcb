"""Prints the nearest obstacle in a box ahead of the robot, in its frame (x right, y ahead, z up): nearest.py SENSOR.

The box stands on the floor: the robot's origin lies there, so `z_m` of `[sensor.mount]` is the sensor's height over it.
No output does not mean that the way is free. What lies nearer than the lowest beam, or than the box, is not seen any
more. What one row alone strikes can be ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and
steps down are no objects. `cargo run --release --example obstacles` prints what is seen by sensor, height and distance.
"""

import sys

import numpy as np
import sweepd

# The box: least and greatest x, y and z, metres.
BOX_M = np.array([[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]])

client = sweepd.Client(sys.argv[1])
while True:
    sweep = client.next(timeout=1.0)
    if sweep is None:
        print(f"nothing is heard of {sys.argv[1]}", file=sys.stderr, flush=True)
        continue
    if sweep.header["height_m"] == 0:
        print(f"the height of {sweep.name} is not known yet", file=sys.stderr, flush=True)
        continue
    if sweep.header["position_m"][2] <= 0:
        print(f"{sweep.name} has no z_m in [sensor.mount]: where is the floor?", file=sys.stderr, flush=True)
        continue
    points = sweep.points("robot")
    is_within = ((points > BOX_M[0]) & (points < BOX_M[1])).all(axis=-1)
    obstacles = points[is_within & (sweep.label >= 2)]
    if len(obstacles) > 0:
        x, y, z = obstacles[np.linalg.norm(obstacles, axis=1).argmin()]
        print(f"{sweep.sequence}: {x:.2f} m right, {y:.2f} m ahead, {z:.2f} m up", flush=True)
