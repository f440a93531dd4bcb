"""Prints the nearest obstacle in the frame of the robot (x right, y forward, z up): nearest.py SENSOR."""

import sys

import numpy as np
import sweepd

for sweep in sweepd.Client(sys.argv[1]):
    obstacles = sweep.points("robot")[sweep.label >= 2]
    if len(obstacles) > 0:
        x, y, z = obstacles[np.linalg.norm(obstacles, axis=1).argmin()]
        print(f"{sweep.sequence}: {x:.2f} m right, {y:.2f} m ahead, {z:.2f} m up", flush=True)
