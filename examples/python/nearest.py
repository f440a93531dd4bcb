"""Prints the nearest obstacle in a box ahead of the robot, in its frame (x right, y ahead, z up): nearest.py SENSOR.

The box stands on the floor: the robot's origin lies there, so `z_m` of `[sensor.mount]` is the height of the sensor over it.
sweepd does not see what two rows of beams do not strike, nor all that is low: `cargo run --release --example obstacles`
prints the smallest box by sensor, height and distance. Nor does it see holes and steps down.
"""

import sys

import numpy as np
import sweepd

# The box: least and greatest x, y and z, metres.
BOX_M = np.array([[-1.0, 0.5, 0.05], [1.0, 5.0, 2.0]])

for sweep in sweepd.Client(sys.argv[1]):
    if sweep.header["position_m"][2] <= 0:
        print(f"{sweep.name} has no z_m in [sensor.mount]: where is the floor?", file=sys.stderr)
        continue
    points = sweep.points("robot")
    is_within = ((points > BOX_M[0]) & (points < BOX_M[1])).all(axis=-1)
    obstacles = points[is_within & (sweep.label >= 2)]
    if len(obstacles) > 0:
        x, y, z = obstacles[np.linalg.norm(obstacles, axis=1).argmin()]
        print(f"{sweep.sequence}: {x:.2f} m right, {y:.2f} m ahead, {z:.2f} m up", flush=True)
