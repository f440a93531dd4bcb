"""Follows a sensor with the Python package and says what it finds; tests/slow/consumers/python.rs compares it with Rust.

    check.py follow NAME ROOT FOLDER    a JSON line a sweep; its points, azimuths and times as files
    check.py objects NAME ROOT          a JSON line a message of objects; all of them are held
    check.py refuse NAME ROOT [objects] for a line `next`: waits for a sweep, or says why not; `look`: the same without
                                        waiting; `use`: asks all that can be asked of it; or of a message of objects
    check.py points_in FILE START_NS X Y W   the points of a sweep in a file, of a robot that moves so since then: metres a
                                        second, radians a second clockwise
    check.py obstacle FILE              the nearest obstacle of the sweep in a file, for each line with a zone and two counts
    check.py hold NAME ROOT             holds sweeps and arrays, and says what became of them
"""

import gc
import hashlib
import json
import os
import sys

import numpy as np
import sweepd
from sweepd import layout


def say(**what):
    print(json.dumps(what), flush=True)


def mapping(array):
    """The file that is mapped where an array is, where in it that is, and how it may be used."""
    at = array.ctypes.data
    with open("/proc/self/maps", encoding="utf-8") as maps:
        for line in maps:
            fields = line.split()
            first, last = (int(end, 16) for end in fields[0].split("-"))
            if first <= at and at + array.nbytes <= last:
                return {"file": fields[5] if len(fields) > 5 else "", "offset": int(fields[2], 16) + at - first,
                        "access": fields[1]}
    return None


def refused(change):
    try:
        change()
    except ValueError:
        return True
    return False


def write(array):
    array[(0,) * array.ndim] = 0


def make_writeable(array):
    array.flags.writeable = True


def follow(name, root, folder):
    sensor = sweepd.Client(name, root)
    say(ready=sensor.next(0.0) is None and sensor.is_connected)
    for line in sys.stdin:
        sweep = sensor.next(float(line))
        if sweep is None:
            say(sweep=None, reopened=sensor.reopened, published=sensor.is_published)
            continue
        planes = {key: getattr(sweep, key) for key in (
            "range", "reflectivity", "label", "range2", "reflectivity2", "label2", "kind", "columns", "beams", "segments")}
        if folder:
            values = {"points": sweep.points(), "azimuth": np.broadcast_to(sweep.azimuth(), sweep.range.shape),
                      "times": np.broadcast_to(sweep.when(), sweep.range.shape)}
            if sweep.range2 is not None:
                values["points2"] = sweep.points(other=True)
            for key, value in values.items():
                assert value.dtype in (np.float64, np.int64)
                value.tofile(os.path.join(folder, key))
        there = [plane for plane in planes.values() if plane is not None and plane.size]
        say(sweep=sweep.sequence, reopened=sensor.reopened, mapping=mapping(sweep.range), name=sweep.name,
            schema=sensor.attribute("schema"), model=sensor.attribute("model"),
            shape=list(sweep.range.shape), segments=len(sweep.segments),
            sha256={key: hashlib.sha256(plane.tobytes()).hexdigest() for key, plane in planes.items() if plane is not None},
            read_only=all(refused(lambda: write(plane)) and refused(lambda: make_writeable(plane)) for plane in there))
        # Nothing is held while waiting.
        sweep = planes = there = None


def objects(name, root):
    sensor = sweepd.Client(name, root).objects()
    say(ready=sensor.next(0.0) is None and sensor.is_connected)
    held = []
    for line in sys.stdin:
        message = sensor.next(float(line))
        if message is None:
            say(message=None)
            continue
        held.append(message)
        arrays = (message.header, message.objects, message.labels)
        say(message=message.sequence, bytes=b"".join(array.tobytes() for array in arrays).hex(), name=message.name,
            last=message.is_last, rows=message.is_segment.tolist(), when=message.when().tolist(),
            boxes=message.boxes("robot").tolist(), own=message.boxes().tolist(), ros=message.boxes("ros").tolist(),
            read_only=all(refused(lambda: write(array)) and refused(lambda: make_writeable(array))
                          for array in (message.objects, message.labels) if array.size))


def refuse(name, root, *topic):
    sensor = sweepd.Client(name, root)
    sensor = sensor.objects() if topic else sensor
    for line in sys.stdin:
        if line.strip() == "use" and topic:
            with np.errstate(all="ignore"):
                shapes = [sweep.boxes("ros").shape, sweep.when().shape, sweep.is_segment.shape]
                _ = sweep.name, sweep.sequence, sweep.is_last, sweep.mount
            say(objects=len(sweep.objects), labels=len(sweep.labels), boxes=shapes[0])
            continue
        if line.strip() == "use":
            with np.errstate(all="ignore"):
                shapes = [sweep.points("ros").shape, sweep.azimuth().shape, sweep.when().shape]
                _ = sweep.name, sweep.sensor, sweep.sequence, sweep.has(layout.CIRCULAR), sweep.copy()
            say(rows=int(sweep.header["rows"]), segments=len(sweep.segments), points=shapes[0])
            sweep = None
            continue
        try:
            sweep = sensor.next(0.0 if line.strip() == "look" else 5.0)
            say(sweep=None if sweep is None else sweep.sequence)
        except sweepd.SweepdError as error:
            say(refused=str(error), layout=isinstance(error, sweepd.LayoutError))


def hold(name, root):
    sensor = sweepd.Client(name, root)
    say(ready=sensor.next(0.0) is None and sensor.is_connected)
    # Of the first sweep only an array of beams is kept.
    kept = sensor.next(5.0).beams[3:]
    gc.collect()
    content = kept.tobytes()
    second = sensor.next(5.0)
    say(holds=[second.sequence])
    sys.stdin.readline()
    try:
        sensor.next(0.0)
        greedy = None
    except sweepd.SweepdError as error:
        greedy = str(error)
    same = kept.tobytes() == content
    del second
    newest = sensor.latest(0.0).sequence
    del kept
    say(greedy=greedy, same=same, newest=newest, then=sensor.next(0.0) is None)


def points_in(file, start_ns, x, y, turn):
    sweep = sweepd.Sweep(np.fromfile(file, np.uint8))

    def robot(time_ns):
        seconds = (time_ns - int(start_ns)) * 1e-9
        pose = np.zeros((*seconds.shape, 4, 4))
        pose[..., 0, 0] = pose[..., 1, 1] = np.cos(float(turn) * seconds)
        pose[..., 0, 1], pose[..., 1, 0] = np.sin(float(turn) * seconds), -np.sin(float(turn) * seconds)
        pose[..., 0, 3], pose[..., 1, 3] = float(x) * seconds, float(y) * seconds
        pose[..., 2, 2] = pose[..., 3, 3] = 1
        return pose

    points = sweep.points_in(robot, "robot")
    chained = sweep.points_in(lambda time_ns: robot(time_ns) @ sweep.mount)
    assert np.allclose(points, chained, rtol=0, atol=1e-9, equal_nan=True)
    sys.stdout.buffer.write(points.tobytes())


def obstacle(file):
    sweep = sweepd.Sweep(np.fromfile(file, np.uint8))
    for line in sys.stdin:
        *ends, labelled, unlabelled = line.split()
        ends = list(map(float, ends))
        try:
            found = sweep.obstacle(ends[:3], ends[3:], labelled=int(labelled), unlabelled=int(unlabelled))
            say(found=int(found is not None), **(found._asdict() if found else {}))
        except sweepd.SweepdError as error:
            say(error=str(error))


try:
    {"obstacle": lambda: obstacle(*sys.argv[2:]), "objects": lambda: objects(*sys.argv[2:]), "points_in": lambda: points_in(*sys.argv[2:]), "follow": lambda: follow(*sys.argv[2:]), "refuse": lambda: refuse(*sys.argv[2:]),
     "hold": lambda: hold(*sys.argv[2:])}[sys.argv[1]]()
except sweepd.SweepdError as error:
    say(error=str(error))
