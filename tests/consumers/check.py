"""Follows a sensor with examples/consumer.py and says what it finds; tests/consumers/python.rs compares it with Rust.

    check.py layout                     fields, numbers and prefixes, as JSON
    check.py follow NAME ROOT FOLDER    a JSON line a sweep; its points, azimuths and times as files
    check.py refuse NAME ROOT           for a line `next`: waits for a sweep, or says why not; `look`: the same without
                                        waiting; `use`: asks all that can be asked of it
    check.py hold NAME ROOT             holds sweeps and arrays, and says what became of them
"""

import gc
import hashlib
import json
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "../../examples"))
import numpy as np

import consumer


def say(**what):
    print(json.dumps(what), flush=True)


def layout():
    def fields(dtype):
        found = {}
        for name, (kind, offset, *_) in dtype.fields.items():
            element, count = (kind.subdtype[0], kind.shape[0]) if kind.subdtype else (kind, 1)
            found[name] = [offset, kind.itemsize, element.kind + str(8 * element.itemsize)]
        return found

    structs = {"Header": consumer.HEADER, "Column": consumer.COLUMN, "BeamRow": consumer.BEAM, "Segment": consumer.SEGMENT}
    names = [name for name in dir(consumer) if name.isupper() and isinstance(getattr(consumer, name), int)]
    preamble = {name: [getattr(consumer.Preamble, name).offset, getattr(consumer.Preamble, name).size]
                for name, _ in consumer.Preamble._fields_}
    roots = sys.argv[2:]
    say(structs={name: fields(dtype) for name, dtype in structs.items()}, preamble=preamble,
        numbers={name: getattr(consumer, name) for name in names},
        prefixes=[consumer.prefix(consumer.absolute(root)) for root in roots])


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
    sensor = consumer.Sensor(name, root)
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
                      "times": np.broadcast_to(sweep.times(), sweep.range.shape)}
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


def refuse(name, root):
    sensor = consumer.Sensor(name, root)
    for line in sys.stdin:
        if line.strip() == "use":
            with np.errstate(all="ignore"):
                shapes = [sweep.points().shape, sweep.azimuth().shape, sweep.times().shape, sweep.firing().shape]
                _ = sweep.name, sweep.sequence, sweep.has(consumer.CIRCULAR)
            say(rows=int(sweep.header["rows"]), segments=len(sweep.segments), points=shapes[0])
            sweep = None
            continue
        try:
            sweep = sensor.next(0.0 if line.strip() == "look" else 5.0)
            say(sweep=None if sweep is None else sweep.sequence)
        except consumer.SweepdError as error:
            say(refused=str(error), layout=isinstance(error, consumer.LayoutError))


def hold(name, root):
    sensor = consumer.Sensor(name, root)
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
    except consumer.SweepdError as error:
        greedy = str(error)
    same = kept.tobytes() == content
    del second
    newest = sensor.latest(0.0).sequence
    del kept
    say(greedy=greedy, same=same, newest=newest, then=sensor.next(0.0) is None)


try:
    {"layout": layout, "follow": lambda: follow(*sys.argv[2:]), "refuse": lambda: refuse(*sys.argv[2:]),
     "hold": lambda: hold(*sys.argv[2:])}[sys.argv[1]]()
except consumer.SweepdError as error:
    say(error=str(error))
