"""Compares the CSV of `sweepd replay --partial` with velodyne-decoder 3.1.0, return by return.

usage: compare_velodyne_decoder.py CAPTURE MODEL CSV_DIR [CALIBRATION]

MODEL is a key of MODELS. With CALIBRATION, a ROS YAML, velodyne-decoder decodes with it, as sweepd did; without, it
uses the table of the model that it brings along, which is compared with calib/MODEL.yaml that way. Prints one line
with counts and worst differences; says what is wrong and fails otherwise.

Of each return are compared the point, range, azimuth and elevation as seen from the origin of its beam, reflectivity,
row, kind and time. The limits follow from these differences, which are meant:

* scans: velodyne-decoder cuts scans between packets, sweepd between firings: whole captures are compared.
* product byte: it refuses a VLP-16 with the HDL-32E's byte (early firmware): all packets of models that have such a
  byte are given to it with the byte of the model.
* least and greatest range: it leaves out ranges under 0.1 m and over 200 m unless told otherwise; it is told so.
* rings and axes: its axes are those of ROS (x forward, y left); it numbers rings from the lowest, sweepd rows from
  the highest.
* equal pairs: of two equal returns of a shot it gives one point, of kind "both": of each such pair one line is left
  out.
* last of an HDL-64E: its last return is that of the third and fourth block of a firing. No manual says so, and sweepd
  calls the farther one the last. `sweepd simulate` sends the farther one there: the kinds must be equal.
* last of a VLS-128: it calls the first of two blocks the last. Sources contradict each other, and sweepd calls the
  farther one the last. `sweepd simulate` sends the strongest first: the kinds must be the other ones.
* azimuth, rounding: it rounds azimuths to hundredths of a degree, CENTIDEGREE.
* azimuth, turning rate: it takes the rate of the head from the first and the last azimuth of the packet, each of
  which is rounded and carries the encoder's noise, together ENDS_DEG; sweepd from many packets. Shots a while after
  their block's azimuth differ by that share of it.
* azimuth, beams that look aside: on a VLP-32C and a VLS-128 shots come up to 45 us after their azimuth, and its rate
  is wrong for more reasons. On a VLP-32C a sector that was left out inside the packet counts as turned: up to 10
  degrees. On a VLS-128 it is that since the packet before, as if that had lasted 20 slots a firing: 3.6 % too high
  where the lasers rest; and 0 in the first packet. What it computes is known: its rate is replaced by the mean of the
  capture, which is less than STEADY_DEG off.
* times, left out: on a VLP-32C it takes no notice of that sector: firings behind it are 49.7 ms early. The lasers keep
  their beat, and the silent firings are added.
* times, VLS-128: it takes 20 slots for a firing, 1.94 us less than with the rest. It takes the stamp for 7 us after the
  first shot, which it scales to 6.46 us, and sweepd for the fourth group's shot, 8 us. Its slots are 2.89 us in the
  first packet, and in all where the second comes 167 us after it or more. The differences are added.
* azimuth and times, period: it knows 57.6 us from firing to firing on an S3, whatever the packets' own period. At 288
  us a packet its times are not compared, and its azimuths need only be within OTHER_PERIOD_DEG at 600 turns a minute.
* times, clock: its times are the sensor's microseconds, with the hour of the arrival. sweepd's are these where GPS is
  locked; until it has heard so it moves them to the host's clock by the least delay that it has seen when the first
  sweep ends: a constant.
* times, stamp: it takes the stamp of a packet for the time of the first shot. On an HDL-64E it is that of the output,
  by the manual, and sweepd subtracts: sweepd's times are earlier by the packet's period, a constant.
* numbers: its points are of single precision, the CSV has tenths of a millimetre: LENGTH_M. On an HDL-64E all three
  axes count, and through the two-point correction differences in azimuth change ranges by up to 0.1 mm: BENT_M. The
  VLP-16's manual and calib/ round the height of a beam's origin to 0.1 mm, velodyne-decoder's table does not:
  HEIGHT_M.
* elevation: of the Puck Hi-Res its table has three decimals of two thirds of a degree, calib/ the manual's two.
* reflectivity: it does not round what it computes with an HDL-64E's focal distance and slope, REFLECTIVITY.
"""

import glob
import os
import struct
import sys
from typing import NamedTuple

import numpy as np
import velodyne_decoder as vd
import yaml


class Sensor(NamedTuple):
    """Times in nanoseconds, by the manual, of packets with one return."""

    model: vd.Model
    product: int | None  # what to write into byte 1205
    packet_ns: int
    azimuth_ns: int  # from one azimuth to the next
    last_shot_ns: int  # after its azimuth
    table_deg: float = 1e-4  # how far elevations may be off velodyne-decoder's own table
    knows_period: bool = True
    at_once: int | None = None  # how many beams of one that look aside fire at once
    slot_ns: float = 0  # from these to the next

    @property
    def is_hdl64e(self):
        return self.product is None

    @property
    def is_vls128(self):
        return self.at_once == 8

    def period_ns(self, is_dual):
        """From one packet to the next."""
        return self.packet_ns // ((3 if self.is_vls128 else 2) if is_dual else 1)

    def blocks_of_azimuth(self, is_dual):
        return (4 if self.is_vls128 else 2 if self.is_hdl64e else 1) * (2 if is_dual else 1)

    def slots(self, channel):
        """Slots from the first shot of a firing to that of a channel: two are for maintenance after the eighth."""
        slot = channel // self.at_once
        return slot + 2 * (slot // 8) if self.is_vls128 else slot


MODELS = {
    "vlp16": Sensor(vd.Model.VLP16, 0x22, 1_327_104, 110_592, 89_856),
    "puck-hires": Sensor(vd.Model.PuckHiRes, 0x24, 1_327_104, 110_592, 89_856, table_deg=0.0035),
    "hdl32e": Sensor(vd.Model.HDL32E, 0x21, 552_960, 46_080, 35_712),
    "vlp32c": Sensor(vd.Model.VLP32C, 0x28, 663_552, 55_296, 34_560, at_once=2, slot_ns=2_304),
    "vls128": Sensor(vd.Model.VLS128, 0xA1, 165_820, 55_273, 45_333, at_once=8, slot_ns=8_000 / 3),
    "hdl64e-s2": Sensor(vd.Model.HDL64E_S2, None, 288_000, 48_000, 45_660),
    "hdl64e-s3": Sensor(vd.Model.HDL64E_S3, None, 345_600, 57_600, 54_100),
    "hdl64e-s3-288us": Sensor(vd.Model.HDL64E_S3, None, 288_000, 48_000, 45_660, knows_period=False),
}

CSV = [
    ("packet", "i8"), ("block", "i8"), ("row", "i8"), ("column", "i8"), ("channel", "i8"), ("kind", "i8"),
    ("azimuth", "f8"), ("elevation", "f8"), ("range", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8"),
    ("reflectivity", "i8"), ("time_ns", "i8"), ("label", "i8"),
]

CENTIDEGREE = 0.005
# Two azimuths, each off by the encoder's 0.02 degrees and by rounding to 0.01.
ENDS_DEG = 0.05
OTHER_PERIOD_DEG = 0.05
STEADY_DEG = 0.002
# A step from azimuth to azimuth that is no motion of the head.
JUMP_CDEG = 200
# Half of the last decimal of an angle in the CSV, and a little for single precision.
DECIMALS_DEG = 6e-5
LENGTH_M, BENT_M = 0.0001, 0.0002
HEIGHT_M = 0.00005
REFLECTIVITY = 0.501
TIME_NS = 1_000
# How fast the least delay may grow in sweepd, for clocks that drift.
DRIFT = 100e-6
# Kinds are numbered as by velodyne-decoder: 1 strongest, 2 last, and for two equal ones:
BOTH = 3
# Where the origin of a beam is, by the calibration: aside, up.
ORIGIN = ["horiz_offset_correction", "vert_offset_correction"]


def ours(folder):
    """The lines of all sweeps, in no order."""
    sweeps = []
    for path in sorted(glob.glob(os.path.join(folder, "sweep_*.csv"))):
        with open(path) as file:
            lines = (line.replace("strongest", "1").replace("last", "2") for line in file)
            sweeps.append(np.loadtxt(lines, delimiter=",", dtype=CSV, skiprows=1, ndmin=1))
    return np.concatenate(sweeps)


def in_the_order_of_points(lines, sensor, is_dual):
    """As velodyne-decoder has them: azimuth by azimuth, shot by shot, of two returns the last before the strongest."""
    azimuth = lines["block"] // sensor.blocks_of_azimuth(is_dual)
    # Two firings of a VLP-16 share an azimuth, and the later has the same channels; beams of others fire together.
    shot = lines["channel"] if sensor.is_hdl64e or sensor.at_once else lines["time_ns"]
    comes_second = lines["block"] % 4 < 2 if sensor.is_hdl64e else lines["block"] % 2 == 1
    return lines[np.lexsort((comes_second, shot, azimuth, lines["packet"]))]


def with_equal_pairs_as_one(lines):
    """The lines without the second of two equal returns of a shot, and of what kind each then is."""
    same = ["packet", "time_ns", "channel", "range", "reflectivity"]
    is_first = np.logical_and.reduce([lines[name][1:] == lines[name][:-1] for name in same])
    is_first, is_second = np.append(is_first, False), np.append(False, is_first)
    return lines[~is_second], np.where(is_first, BOTH, lines["kind"])[~is_second]


class Theirs(NamedTuple):
    points: np.ndarray  # in the order of the wire: rows of right, forward, up, intensity, ring, kind
    time_ns: np.ndarray  # of each by the sensor's clock, since 1970
    lag_ns: np.ndarray  # of each packet from its stamp to its arrival, by the two clocks
    is_dual: bool
    stamp_ns: np.ndarray | None = None  # of each packet, of the hour
    azimuth_cdeg: np.ndarray | None = None  # of each packet and block


def theirs(capture, sensor, calibration):
    """What velodyne-decoder makes of a capture, with a calibration file or without."""
    calibration = vd.Calibration.read(calibration) if calibration else None
    decoder = vd.StreamDecoder(vd.Config(model=sensor.model, min_range=0, max_range=300, calibration=calibration))
    scans, arrivals, azimuths = [], [], []
    for arrival, data in vd.util.iter_pcap(capture):
        if len(data) == vd.PACKET_SIZE:
            arrival = float(arrival)
            arrivals.append((round(arrival * 1e6) * 1000, struct.unpack("<L", data[1200:1204])[0] * 1000))
            azimuths.append(np.frombuffer(data[:1200], "<u2").reshape(12, 50)[:, 1].astype(int))
            is_dual = data[2:4] == data[202:204] if sensor.is_hdl64e else data[1204] == 0x39
            known = data if sensor.is_hdl64e else data[:1205] + bytes([sensor.product])
            scans.append(decoder.decode(arrival, known))
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
    forward, left, *rest = points[:, [0, 1, 2, 3, 6, 7]].astype(float).T
    stamp_ns = np.array([of_hour for _, of_hour in arrivals])
    return Theirs(np.stack([-left, forward, *rest]), time_ns, lag_ns, is_dual, stamp_ns, np.stack(azimuths))


def turned(degrees):
    return (degrees + 180) % 360 - 180


def corrected(lines, decoded, sensor):
    """What it would say without its known errors of beams that look aside."""
    blocks = sensor.blocks_of_azimuth(decoded.is_dual)
    firings = 12 // blocks
    azimuth = decoded.azimuth_cdeg[:, : firings * blocks : blocks]
    steps = turned(np.diff(azimuth.ravel()) / 100)
    is_jump = np.abs(steps) > JUMP_CDEG / 100
    step = steps[~is_jump].mean()
    packet, firing, slots = lines["packet"], lines["block"] // blocks, sensor.slots(lines["channel"])
    if sensor.is_vls128:
        cycles = 20 * firings
        their_turn = np.append(0, np.diff(azimuth[:, 0]) % 36000 / 100 / cycles)[packet] * slots
        interval_ns = np.diff(decoded.stamp_ns[:2]) * (3 if decoded.is_dual else 1)
        their_slot = np.where((packet == 0) | (interval_ns >= 167_000), 2_890, sensor.slot_ns)
        their_shot = -7_000 * their_slot / 2_890 + (20 * firing + slots) * their_slot
        shot = -3 * sensor.slot_ns + firing * sensor.azimuth_ns + slots * sensor.slot_ns
    else:
        width = (firings - 1) * sensor.azimuth_ns
        their_turn = ((azimuth[:, -1] - azimuth[:, 0]) % 36000 / 100 / width)[packet] * slots * sensor.slot_ns
        silent = np.append(0, np.where(is_jump, np.round(steps % 360 / step) - 1, 0)).reshape(azimuth.shape)
        # One between two packets is no error: the stamp of the later one has it.
        silent[:, 0] = 0
        their_shot, shot = 0, silent.cumsum(axis=1)[packet, firing] * sensor.azimuth_ns
    more = np.radians(step / sensor.azimuth_ns * slots * sensor.slot_ns - their_turn)
    right, forward, *rest = decoded.points
    turned_on = [right * np.cos(more) + forward * np.sin(more), forward * np.cos(more) - right * np.sin(more)]
    time_ns = decoded.time_ns + np.round(shot - their_shot).astype(np.int64)
    return decoded._replace(points=np.stack([*turned_on, *rest]), time_ns=time_ns)


def differences(lines, decoded, sensor, beams, own_table):
    """What is compared of where a return is, and its unit; how far each return is off; and how far it may be."""
    key_of_beams = [[beams[channel].get(key, 0) for channel in range(len(beams))] for key in ORIGIN]
    aside_m, vertical_m = np.array(key_of_beams)[:, lines["channel"]]
    azimuth, elevation = np.radians(lines["azimuth"]), np.radians(lines["elevation"])
    level = lines["range"] * np.cos(elevation)
    along = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), lines["range"] * np.sin(elevation)])
    point = np.stack([lines["x"], lines["y"], lines["z"]])
    # Aside of the axis an origin turns with the beam, which bends away from there: sweepd's columns tell where it is.
    origin = point - along
    seen_from = origin if sensor.is_hdl64e else np.stack([aside_m, aside_m, vertical_m])
    right, forward, up = decoded.points[:3] - seen_from
    level = np.hypot(right, forward)

    if sensor.at_once:
        azimuth_deg = CENTIDEGREE + STEADY_DEG
    elif sensor.knows_period:
        ends_share = sensor.last_shot_ns / (sensor.period_ns(decoded.is_dual) - sensor.azimuth_ns)
        azimuth_deg = CENTIDEGREE + ENDS_DEG * ends_share
    else:
        azimuth_deg = OTHER_PERIOD_DEG
    table_deg, table_m = (sensor.table_deg, HEIGHT_M) if own_table else (0, 0)
    length_m = BENT_M if sensor.is_hdl64e else LENGTH_M
    decimals_m = length_m + np.radians(DECIMALS_DEG) * lines["range"]
    decimals_deg = np.degrees(decimals_m / level) if sensor.is_hdl64e else DECIMALS_DEG
    point_m = decimals_m + table_m + np.radians(azimuth_deg + table_deg) * level
    azimuth_off = np.abs(turned(np.degrees(np.arctan2(right, forward)) - lines["azimuth"]))
    elevation_off = np.abs(np.degrees(np.arctan2(up, level)) - lines["elevation"])
    intensity_off = np.abs(decoded.points[3] - lines["reflectivity"])
    return [
        ("point", "m", np.linalg.norm(decoded.points[:3] - point, axis=0), point_m),
        ("range", "m", np.abs(np.hypot(level, up) - lines["range"]), length_m),
        ("azimuth", "deg", np.maximum(azimuth_off - decimals_deg, 0), azimuth_deg),
        ("elevation", "deg", np.maximum(elevation_off - decimals_deg - np.degrees(table_m / level), 0), table_deg),
        ("origin aside", "m", np.abs(np.hypot(origin[0], origin[1]) - np.abs(aside_m)), decimals_m),
        ("origin in height", "m", np.abs(origin[2] - vertical_m), decimals_m),
        ("reflectivity", "", intensity_off, REFLECTIVITY if sensor.is_hdl64e else 0),
    ]


def differences_in_time(lines, decoded, sensor, limit_ns=TIME_NS):
    """How far each time is off, ns; on which clock sweepd's times are, in words; and what is wrong with that."""
    packet_ns = sensor.period_ns(decoded.is_dual)
    moved = lines["time_ns"] - decoded.time_ns + (packet_ns if sensor.is_hdl64e else 0)
    on_host = np.abs(moved) > limit_ns
    if not on_host.any():
        return np.abs(moved), "UTC", []
    constant = (moved[on_host].min() + moved[on_host].max()) // 2
    off = np.abs(moved - np.where(on_host, constant, 0))
    wrong = []
    if not on_host.all() and lines["packet"][on_host].max() > lines["packet"][~on_host].min():
        wrong.append("times on the host's clock after times on that of GPS")
    # A packet is sent when it is full: no delay is less than the least, and the first counts until that is far off.
    delays = decoded.lag_ns - (0 if sensor.is_hdl64e else packet_ns)
    slack = limit_ns + DRIFT * np.ptp(decoded.time_ns)
    if not delays.min() - limit_ns <= constant <= delays[0] + slack:
        wrong.append(f"times moved by {constant} ns, the delays are {delays.min()} to {delays[0]}")
    return off, f"host for {np.mean(on_host):.2%}, sensor + {constant / 1000:.1f} us", wrong


def compare(capture, model, folder, calibration):
    """Prints a line, and gives a list of what is wrong."""
    sensor = MODELS[model]
    with open(calibration or os.path.join(os.path.dirname(__file__), "..", "calib", f"{model}.yaml")) as file:
        beams = {beam["laser_id"]: beam for beam in yaml.safe_load(file)["lasers"]}
    decoded = theirs(capture, sensor, calibration)
    returns = in_the_order_of_points(ours(folder), sensor, decoded.is_dual)
    lines, kinds = with_equal_pairs_as_one(returns)
    pairs = [len(returns) - len(lines), int(np.sum(decoded.points[5] == BOTH))]
    # Both in the same order, with the same ring at every place: each return has its point, and the reverse.
    if len(lines) != len(decoded.time_ns) or pairs[0] != pairs[1]:
        return [f"{len(lines)} returns, {len(decoded.time_ns)} by velodyne-decoder; {pairs} of them are equal pairs"]
    wrong = []
    their_kinds = decoded.points[5]
    if sensor.is_vls128 and decoded.is_dual:
        their_kinds = np.where(their_kinds == BOTH, BOTH, 3 - their_kinds)
    for what, found, expected in [
        ("rings", len(beams) - 1 - lines["row"], decoded.points[4]),
        ("kinds of returns", kinds, their_kinds),
    ]:
        if not np.array_equal(found, expected):
            wrong.append(f"{np.sum(found != expected)} other {what}")

    if sensor.at_once:
        decoded = corrected(lines, decoded, sensor)
    compared = differences(lines, decoded, sensor, beams, own_table=not calibration)
    clock = "times not compared"
    if sensor.knows_period:
        time_off, clock, wrong_clock = differences_in_time(lines, decoded, sensor)
        compared.append(("time", "ns", time_off, TIME_NS))
        wrong += wrong_clock
    for what, unit, off, limit in compared:
        limit = np.broadcast_to(limit, off.shape)
        worst = np.argmax(off - limit)
        if off[worst] > limit[worst]:
            where = ", ".join(f"{name} {lines[name][worst]}" for name in ("packet", "block", "channel"))
            wrong.append(
                f"{what} of {np.sum(off > limit)} returns too far off, worst of all by {off[worst]:.6g} {unit} where "
                f"{limit[worst]:.6g} are allowed ({where})"
            )
    worst = ", ".join(f"{what} {off.max():.4g} {unit}".rstrip() for what, unit, off, _ in compared)
    print(f"{os.path.basename(capture)}: {len(lines)} points, {pairs[0]} equal pairs; {worst}; clock: {clock}")
    return wrong


if __name__ == "__main__":
    found = compare(*sys.argv[1:4], sys.argv[4] if len(sys.argv) > 4 else None)
    # Text is printed and is a failure; no text is neither.
    sys.exit("\n".join(f"{os.path.basename(sys.argv[1])}: {one}" for one in found) or None)
