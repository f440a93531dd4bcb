"""Says "stop" while an obstacle is in the way: in a box ahead of the robot that stands on the floor.

    stop.py SENSOR [WIDTH [LENGTH [MODEL]]]

The way is WIDTH wide and LENGTH long, metres, from the robot's origin; it begins 0.5 m ahead and goes from 5 cm to 2 m
over the floor. "stop" is also said while whole turns stay away for 0.3 s, while the sensor does not see what it should or
its height is not known, and of a sweep of another model: a number of docs/layout.md, 0 (the default) for that of the first.

"stop" takes sweeps. "object ahead, not confirmed" comes earlier, while the head turns: the box of an object reaches
into the way. So does that of a wall beside it: slow down, do not stop.

No output does not mean that the way is free. What lies nearer than the lowest beam, or than the way, is not seen any
more. What one row alone strikes can be ground, and so can a low thing that is deeper than 1 m, or a pallet. Holes and
steps down are no obstacles. `cargo run --release --example obstacles` prints what is seen by sensor, height and distance.
"""

import contextlib
import sys
import time

import sweepd
from sweepd.layout import NOT_SEEING, PARTIAL, SEGMENT_WIDE, STOPPED

# Where the way begins, and from where to where it goes over the floor, metres.
AHEAD_M, LOW_M, HIGH_M = 0.5, 0.05, 2.0
# A sensor that is well gives a sweep at least this often, seconds: it turns five times a second or faster.
SILENCE_S = 0.3
USAGE = "SENSOR [WIDTH [LENGTH [MODEL]]]: WIDTH is at least 0 and LENGTH 0.5, metres; MODEL is a number of docs/layout.md"


def sweep_says(name, sweep, way, model):
    """Why the robot must stop by a sweep."""
    if sweep.header["model"] != model:
        yield f"{name} is of model {sweep.header['model']}, not {model}"
    if sweep.has(NOT_SEEING):
        yield f"{name} does not see what it should, its flags are {sweep.header['flags']:#x}"
    if sweep.header["height_m"] == 0:
        yield f"the height of {name} is not known: set `height_m` in `[sensor.mount]`"
    elif found := sweep.obstacle(*way):
        yield f"an obstacle at {found.distance_m:.2f} m, sweep {sweep.sequence}"


def objects_say(message, way):
    """Which objects may be in the way."""
    # Nobody can tell how high something is over a floor that is not known.
    axes = 2 if message.floor_m is None else 3
    boxes = (message.boxes("robot") - [0, 0, message.floor_m or 0.0])[:, :, :axes]
    # What is wide was there in parts before, whose boxes say more.
    is_wide = message.objects["segment"]["flags"] & SEGMENT_WIDE != 0
    is_ahead = ((boxes[:, 0] <= way[1][:axes]) & (boxes[:, 1] >= way[0][:axes])).all(axis=1) & ~is_wide
    for segment, at_ns in zip(message.objects["segment"][is_ahead], message.when()[is_ahead]):
        age_ms = (time.time_ns() - int(at_ns)) / 1e6
        yield f"{segment['nearest_m']:.2f} m from the sensor, seen {age_ms:.0f} ms ago"


def main(name, *args):
    """Follow the sensor for ever."""
    try:
        width_m, length_m, code = (*args, *["2", "5", "0"][len(args) :])
        width_m, length_m, model = float(width_m), float(length_m), int(code)
        is_way = width_m >= 0 and length_m >= AHEAD_M and 0 <= model < 2**32
    except ValueError:
        is_way = False
    if not is_way:
        sys.exit(f"stop.py: {USAGE}")
    way = (-width_m / 2, AHEAD_M, LOW_M), (width_m / 2, length_m, HIGH_M)
    client = sweepd.Client(name)
    objects, heard_s = client.objects(), time.monotonic()
    while True:
        # Not longer, as a sweep may come meanwhile.
        message = objects.next(timeout=0.01)
        for said in objects_say(message, way) if message else ():
            print(f"object ahead, not confirmed: {said}", flush=True)
        while (sweep := client.next(timeout=0)) is not None:
            model = model or int(sweep.header["model"])
            # Only a whole turn has looked everywhere.
            heard_s = heard_s if sweep.has(PARTIAL | STOPPED) else time.monotonic()
            for said in sweep_says(name, sweep, way, model):
                print(f"stop: {said}", flush=True)
        if time.monotonic() - heard_s > SILENCE_S:
            heard_s = time.monotonic()
            print(f"stop: no whole turn of {name} came for 0.3 s", flush=True)


if len(sys.argv) < 2:
    sys.exit(__doc__)
with contextlib.suppress(KeyboardInterrupt):
    main(*sys.argv[1:])
