"""Compares what `sweepd replay --csv` makes of a capture of a VLP-32C or a VLS-128 with a reference decoder of them, a
script beside the captures that was written from manuals and measurements alone.

usage: compare_velodyne_reference.py CAPTURE MODEL CSV_DIR FOLDER_OF_REFERENCE

MODEL is vlp32c or vls128. Prints one line with counts and worst differences; says what is wrong and fails otherwise.

Every return stands at the same place of the wire, with the same row, range and reflectivity, and on a VLP-32C it is of
the same kind. (Of a VLS-128 the reference calls two returns first and second.) Its elevation, height, azimuth and time
may differ a little:

* azimuth: the reference takes the turning rate of each packet from its first azimuth and that of the packet behind it,
  which may be one step of an encoder. Encoders of `sweepd simulate` are noisy: 45 us after the azimuth that is up to
  0.014 degrees with one return, and 0.035 with two returns of a VLS-128. Its rate is known, and is replaced by the
  median that it gives for the whole capture.
* time, stamp: it takes the stamp for the first shot, sweepd that of a VLS-128 for the fourth group's.
* time, rest: a VLS-128 rests after each firing. The reference spreads what is left between two stamps over the firings
  of the packet, sweepd knows the mean. Stamps are whole microseconds: in the third firing that differs by up to 2 us.
* numbers: calib/ rounds the height of a beam's origin to 0.01 mm, the CSV lengths to 0.1 mm.
* confidence (byte 1204 is 0x3B): the reference tells such packets from others when it decodes, but its detection of the
  model does not know them, and is not asked. It names their blocks as they stand on the wire, sweepd as if the
  confidence were not there.
"""

import os
import sys

import numpy as np

from compare_velodyne_decoder import MODELS, Theirs, differences_in_time, ours, turned

CONFIDENCE = 0x3B
AZIMUTH_DEG = {"vlp32c": 0.006, "vls128": 0.01}
# Less than the 2.67 us to the next shot of a VLS-128.
TIME_NS = {"vlp32c": 1_000, "vls128": 2_500}
ELEVATION_DEG, LENGTH_M = 6e-5, 0.0001


def compare(capture, model, folder, folder_of_reference):
    """Prints a line, and gives a list of what is wrong."""
    sys.path.insert(0, folder_of_reference)
    import velodyne_reference as reference

    stream = reference.load(capture)
    has_confidence = stream.mode[0] == CONFIDENCE
    expected = {"vlp32c": reference.VLP32C, "vls128": reference.VLS128}[model]
    if not has_confidence and reference.detect(stream) is not expected:
        return ["the reference takes it for another model"]
    found, info = reference.decode(stream, expected)
    lines = ours(folder)
    lines = lines[np.lexsort((lines["channel"], lines["block"], lines["packet"]))]
    if len(lines) != len(found["raw"]):
        return [f"{len(lines)} returns, {len(found['raw'])} by the reference"]
    block = found["block"] // 3 * 2 + found["block"] % 3 if has_confidence else found["block"]
    equal = {"packet": found["packet"], "block": block, "channel": found["laser"], "row": found["row"]}
    equal["range"], equal["reflectivity"] = np.round(found["raw"] * reference.UNIT_M, 4), found["reflectivity"]
    if found["kind"][0] not in ("first", "second"):
        equal["kind"] = np.where(found["kind"] == "last", 2, 1)
    others = {key: np.sum(lines[key] != of) for key, of in equal.items()}
    wrong = [f"{count} returns with another {key}" for key, count in others.items() if count]

    shot_us = expected.shot_us(info["slot_us"])
    azimuth = found["azimuth"] + (info["usual_rate"] - info["rate"][found["packet"]]) / 100 * shot_us[found["laser"]]
    time_us = stream.first_stamp_us + found["time_us"] - (3 * info["slot_us"] if model == "vls128" else 0)
    is_dual = stream.mode[0] in (0x39, CONFIDENCE)
    hour_us = 3_600_000_000
    arrival_us = np.array([arrival for arrival, payload in reference.datagrams(capture) if len(payload) == 1206])
    begins_us = int(arrival_us[0]) // hour_us * hour_us
    lag_us = arrival_us - begins_us - stream.first_stamp_us - stream.time_us
    time_ns = begins_us * 1000 + np.round(time_us * 1000).astype(np.int64)
    decoded = Theirs(None, time_ns, np.round(lag_us * 1000).astype(np.int64), is_dual)
    time_off, clock, wrong_clock = differences_in_time(lines, decoded, MODELS[model], TIME_NS[model])
    wrong += wrong_clock
    compared = [
        ("elevation", "deg", np.abs(lines["elevation"] - found["elevation"]), ELEVATION_DEG),
        ("height", "m", np.abs(lines["z"] - found["z"]), LENGTH_M),
        ("azimuth", "deg", np.abs(turned(lines["azimuth"] - azimuth)), AZIMUTH_DEG[model]),
        ("time", "ns", time_off, TIME_NS[model]),
    ]
    for what, unit, off, limit in compared:
        if off.max() > limit:
            where = ", ".join(f"{name} {lines[name][np.argmax(off)]}" for name in ("packet", "block", "channel"))
            count, most = np.sum(off > limit), off.max()
            wrong.append(f"{what} of {count} returns too far off, by up to {most:.6g} {unit} ({where})")
    worst = ", ".join(f"{what} {off.max():.4g} {unit}" for what, unit, off, _ in compared)
    print(f"{os.path.basename(capture)}: {len(lines)} returns; {worst}; clock: {clock}")
    return wrong


if __name__ == "__main__":
    # Text is printed and is a failure; no text is neither.
    sys.exit("\n".join(f"{os.path.basename(sys.argv[1])}: {one}" for one in compare(*sys.argv[1:])) or None)
