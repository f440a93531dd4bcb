"""Records for 10 s when an obstacle comes into a box ahead of the robot: record_event.py SENSOR [SECONDS].

The daemon writes event_TIME.pcap into this folder, if it may (docs/install.md), with what comes from then on.
"""

import subprocess
import sys
import time

import sweepd

# Least and greatest x (right), y (ahead) and z (up from the floor), metres.
LEAST_M, MOST_M = [-1, 0.5, 0.05], [1, 5, 2]

if len(sys.argv) < 2:
    sys.exit(__doc__)
sensor, *given = sys.argv[1:]
try:
    if len(given) > 1 or not all(0.1 <= float(seconds) <= 1e9 for seconds in given):
        raise ValueError
except ValueError:
    sys.exit("record_event.py: SENSOR [SECONDS]: SECONDS is 0.1 to 1e9")
client = sweepd.Client(sensor)
try:
    while True:
        sweep = client.next(timeout=1.0)
        if sweep is None:
            print(f"nothing is heard of {sensor}", file=sys.stderr, flush=True)
            continue
        if sweep.header["height_m"] == 0:
            print(f"the height of {sensor} is not known: set `height_m` in `[sensor.mount]`", file=sys.stderr, flush=True)
        if sweep.obstacle(LEAST_M, MOST_M) is not None:
            file = f"event_{time.time_ns() // 1_000_000}.pcap"
            print(f"recording {file}", flush=True)
            command = ["sweepd", "record", "--from", sensor, "-o", file, "--seconds", *(given or ["10"])]
            # It says what goes wrong.
            if subprocess.run(command).returncode != 0:
                sys.exit(1)
except KeyboardInterrupt:
    pass
