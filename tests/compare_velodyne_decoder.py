"""Compares the CSV of `sweepd replay --partial` with velodyne-decoder 3.1.0, return by return.

usage: compare_velodyne_decoder.py CAPTURE MODEL CSV_DIR EQUAL_PAIRS

MODEL is vlp16 or hdl32e. Prints one line with counts and worst differences; says what is wrong and fails otherwise.
EQUAL_PAIRS is how many dual returns are equal: velodyne-decoder gives one point for such a pair, so of each of these
pairs one line is left out of the comparison.

Differences between the two that are meant, and taken into account here:

* velodyne-decoder cuts scans between packets, sweepd between firings: whole captures are compared.
* It refuses a VLP-16 with the HDL-32E's product byte (early firmware): all packets are given to it with the byte of
  the model.
* It leaves out ranges under 0.1 m unless told otherwise; it is told so.
* Its z holds the height of the beam's origin, as sweepd's does; that is taken off before angles are compared.
* Its axes are those of ROS (x forward, y left); it numbers rings from the lowest, sweepd rows from the highest.
* It rounds azimuths to hundredths of a degree.
* Its times are the sensor's microseconds, with the hour of the arrival. sweepd's are these where GPS is locked; else it
  moves them to the host's clock by the least delay that it has seen when the first sweep ends: a constant.
"""

import glob
import os
import struct
import sys

import numpy as np
import velodyne_decoder as vd
import yaml

# Model, product byte, period of the packets in nanoseconds by its manual, elevation of the rings from the lowest.
MODELS = {
    "vlp16": (vd.Model.VLP16, 0x22, 1_327_104, np.arange(-15.0, 16.0, 2.0)),
    "hdl32e": (vd.Model.HDL32E, 0x21, 552_960, np.round(-92 / 3 + np.arange(32) * 4 / 3, 2)),
}

CSV = [
    ("packet", "i8"), ("block", "i8"), ("row", "i8"), ("column", "i8"), ("channel", "i8"), ("last", "i8"),
    ("azimuth", "f8"), ("elevation", "f8"), ("range", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8"),
    ("reflectivity", "i8"), ("time_ns", "i8"), ("label", "i8"),
]

RANGE_M = 0.0001
AZIMUTH_DEG, AZIMUTH_NEARLY_ALL_DEG, NEARLY_ALL = 0.03, 0.02, 0.998
ELEVATION_DEG = 0.005
# The VLP-16's manual and calib/ round the height of a beam's origin to 0.1 mm, velodyne-decoder does not.
HEIGHT_M = 0.00005
TIME_NS = 1_000
# How fast the least delay may grow in sweepd, for clocks that drift.
DRIFT = 100e-6


def ours(folder):
    """The lines of all sweeps in the order of the wire, and the sweep of each."""
    sweeps = []
    for path in sorted(glob.glob(os.path.join(folder, "sweep_*.csv"))):
        with open(path) as file:
            lines = (line.replace("strongest", "0").replace("last", "1") for line in file)
            sweeps.append(np.loadtxt(lines, delimiter=",", dtype=CSV, skiprows=1, ndmin=1))
    sweep = np.repeat(np.arange(len(sweeps)), [len(lines) for lines in sweeps])
    lines = np.concatenate(sweeps)
    # A packet can be in two sweeps, and in each its columns are in the order of time. Last comes before strongest.
    order = np.lexsort((-lines["last"], lines["channel"], lines["column"], sweep, lines["packet"]))
    return lines[order], sweep[order]


def without_equal_pairs(lines, sweep):
    """The same without the second of two equal returns of a pixel, and how many these were."""
    same = ["packet", "column", "channel", "range", "reflectivity"]
    second = np.logical_and.reduce([lines[name][1:] == lines[name][:-1] for name in same])
    second = np.append(False, second & (sweep[1:] == sweep[:-1]) & (lines["last"][1:] < lines["last"][:-1]))
    return lines[~second], sweep[~second], int(second.sum())


def theirs(capture, model, product):
    """Points in the order of the wire: x, y, z, intensity, ring, return type; the sensor's time of each, ns since 1970;
    and of each packet from its first shot to its arrival, ns, by the two clocks."""
    decoder = vd.StreamDecoder(vd.Config(model=model, min_range=0))
    scans, arrivals = [], []
    for arrival, data in vd.util.iter_pcap(capture):
        if len(data) == vd.PACKET_SIZE:
            arrivals.append((round(arrival * 1e6) * 1000, struct.unpack("<L", data[1200:1204])[0] * 1000))
            scans.append(decoder.decode(arrival, data[:1205] + bytes([product])))
    scans.append(decoder.finish())
    scans = [scan for scan in scans if scan is not None]
    points = np.concatenate([points for _, points in scans])
    # The stamp is that of the scan's last packet, in seconds: exact to the microsecond that it counts. The times of the
    # points are relative to it, and as single precision exact to 15 ns.
    stamps = [round(stamp.device * 1e6) * 1000 for stamp, _ in scans]
    stamp = np.repeat(np.array(stamps), [len(points) for _, points in scans])
    time_ns = stamp + np.round(points[:, 4].astype(float) * 1e9).astype(np.int64)
    hour = 3_600_000_000_000
    hour_begins = stamps[0] - stamps[0] % hour
    lag_ns = np.array([arrival - hour_begins - of_hour for arrival, of_hour in arrivals])
    return points[:, [0, 1, 2, 3, 6, 7]].astype(float), time_ns, lag_ns


def turned(degrees):
    return (degrees + 180) % 360 - 180


def compare(capture, model, folder, equal_pairs):
    with open(os.path.join(os.path.dirname(__file__), "..", "calib", f"{model}.yaml")) as file:
        beams = sorted(yaml.safe_load(file)["lasers"], key=lambda beam: beam["vert_correction"])
    heights = np.array([beam["vert_offset_correction"] for beam in beams])
    model, product, period_ns, elevations = MODELS[model]
    lines, sweep = ours(folder)
    lines, sweep, merged = without_equal_pairs(lines, sweep)
    points, time_ns, lag_ns = theirs(capture, model, product)
    name = os.path.basename(capture)
    failures = []

    def require(condition, what):
        if not condition:
            failures.append(f"{name}: {what}")

    require(merged == equal_pairs, f"{merged} equal pairs of dual returns, expected {equal_pairs}")
    require(len(lines) == len(points), f"{len(lines)} returns, velodyne-decoder has {len(points)}")
    if failures:
        return failures
    x, y, z, intensity, ring, kind = points.T
    ring = ring.astype(int)
    z = z - heights[ring]
    ranges = np.sqrt(x * x + y * y + z * z)
    azimuths = np.degrees(np.arctan2(-y, x))
    range_off = np.abs(ranges - lines["range"])
    azimuth_off = np.abs(turned(azimuths - lines["azimuth"]))
    elevation_off = np.abs(np.degrees(np.arcsin(z / ranges)) - lines["elevation"])
    elevation_off = np.maximum(elevation_off - np.degrees(HEIGHT_M / ranges), 0)

    # Both in the order of the wire, with the same ring at every place: each return has its point, and the reverse.
    require(np.array_equal(len(elevations) - 1 - lines["row"], ring), "other rings")
    require(np.allclose(lines["elevation"], elevations[ring], atol=5e-5, rtol=0), "other elevations than the manual's")
    require(np.array_equal(lines["reflectivity"], intensity), "other intensities")
    # 1 strongest, 2 last, 3 both.
    if equal_pairs:
        require(np.all((kind == 3) | (kind == lines["last"] + 1)), "strongest and last exchanged")
    require(np.sum(kind == 3) == equal_pairs, "other equal pairs of dual returns")
    require(range_off.max() < RANGE_M, f"ranges up to {range_off.max()} m off")
    require(azimuth_off.max() < AZIMUTH_DEG, f"azimuths up to {azimuth_off.max()} degrees off")
    nearly_all = np.mean(azimuth_off < AZIMUTH_NEARLY_ALL_DEG)
    require(nearly_all >= NEARLY_ALL, f"only {nearly_all} of the azimuths within {AZIMUTH_NEARLY_ALL_DEG} degrees")
    require(elevation_off.max() < ELEVATION_DEG, f"elevations up to {elevation_off.max()} degrees off")

    # One constant a capture: sweepd's clock less theirs.
    moved = lines["time_ns"] - time_ns
    constant = (moved.min() + moved.max()) // 2
    time_off = np.abs(moved - constant).max()
    require(time_off <= TIME_NS, f"times up to {time_off} ns off the constant {constant} ns")
    if abs(constant) <= TIME_NS:
        clock = "UTC"
    else:
        # A packet is sent when it is full: no delay is less than the least, and the first counts until that is far off.
        clock = f"host, sensor + {constant / 1000:.1f} us"
        delays = lag_ns - (period_ns // 2 if equal_pairs else period_ns)
        slack = TIME_NS + DRIFT * np.ptp(time_ns)
        bounded = delays.min() - TIME_NS <= constant <= delays[0] + slack
        require(bounded, f"times moved by {constant}, the delays are {delays.min()} to {delays[0]}")
    print(
        f"{name}: {len(points)} points, {merged} merged pairs; range {range_off.max() * 1e3:.4f} mm, azimuth "
        f"{azimuth_off.max():.4f} deg, elevation {elevation_off.max():.4f} deg, time {time_off} ns off; clock {clock}"
    )
    return failures


if __name__ == "__main__":
    found = compare(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]))
    # Text is printed and is a failure; no text is neither.
    sys.exit("\n".join(found) or None)
