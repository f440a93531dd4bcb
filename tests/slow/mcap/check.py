"""Reads what `sweepd replay --partial --frame ros --csv DIR --segments SEGMENTS --mcap FILE` wrote.

usage: check.py FILE DIR SEGMENTS ROWS

FILE is read by rosbags and by mcap with mcap-ros2-support: the same messages, of the same bytes, as many as the index
says. Each point is compared with its line of the CSV, each box with its line of SEGMENTS. Says how many there were.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

POINT = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("time", "f4"), ("label", "u4")])
FLOAT32, UINT32, UINT16 = 7, 6, 4
FIELDS = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("intensity", 12, FLOAT32), ("ring", 16, UINT16),
          ("time", 18, FLOAT32), ("label", 22, UINT32)]
# The CSV has tenths of a millimetre, a point single precision.
LENGTH_M = 0.5e-4 + 1e-5


def stamp_ns(header):
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def read_rosbags(path):
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
        durability = {one.topic: one.ext.offered_qos_profiles[0].durability.name for one in reader.connections}
        read = [(one.topic, time, bytes(raw), reader.deserialize(raw, one.msgtype)) for one, time, raw in reader.messages()]
    assert set(durability.values()) == {"VOLATILE"}
    return counts, read


def read_mcap(path):
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.chunk_indexes, "no index"
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            assert channel.metadata["topic_type_hash"] == store.hash_rihs01(schema.name), schema.name
        counts = {
            summary.channels[id].topic: count for id, count in summary.statistics.channel_message_counts.items()
        }
        read = [(channel.topic, message.log_time, message.data, decoded)
                for _, channel, message, decoded in reader.iter_decoded_messages()]
    return counts, read


def check_points(cloud, lines, rows):
    assert [(one.name, one.offset, one.datatype) for one in cloud.fields] == FIELDS
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, len(lines), 26, 26 * len(lines))
    assert cloud.is_dense and not cloud.is_bigendian
    points = np.frombuffer(bytes(cloud.data), POINT)
    # As they were measured; of those at once, the higher row first.
    lines = sorted(lines, key=lambda line: (int(line["time_ns"]), int(line["row"])))
    assert (np.diff(points["time"]) >= 0).all()
    table = {name: np.array([line[name] for line in lines]) for name in ("x_m", "y_m", "z_m", "reflectivity", "row", "label", "time_ns")}
    for axis in "xyz":
        off = np.abs(points[axis] - table[f"{axis}_m"].astype(float))
        assert off.max(initial=0) <= LENGTH_M, (axis, off.max())
    assert (points["intensity"] == table["reflectivity"].astype(int)).all()
    assert (points["ring"] == rows - 1 - table["row"].astype(int)).all()
    assert (points["label"] == table["label"].astype(int)).all()
    after_s = (table["time_ns"].astype(np.int64) - stamp_ns(cloud.header)) * 1e-9
    assert (points["time"] == after_s.astype(np.float32)).all() and after_s.min(initial=0) >= 0


def check_boxes(markers, lines, cloud):
    first, *boxes = markers
    lines = [line for line in lines if line["wide"] == "false"]
    assert first.action == 3 and len(boxes) == len(lines), (len(boxes), len(lines))
    for box, line in zip(boxes, lines):
        assert (box.action, box.type, box.ns, box.id) == (0, 1, "segments", int(line["label"]))
        assert stamp_ns(box.header) == stamp_ns(cloud.header) == int(line["time_ns"])
        assert box.header.frame_id == cloud.header.frame_id
        for axis in "xyz":
            least, greatest = float(line[f"min_{axis}_m"]), float(line[f"max_{axis}_m"])
            center, size = getattr(box.pose.position, axis), getattr(box.scale, axis)
            assert abs(center - (least + greatest) / 2) < 1.1e-4, (axis, line)
            assert abs(size - max(greatest - least, 0.01)) < 1.1e-4, (axis, line)


def main():
    path, folder, segments, rows = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], int(sys.argv[4])
    counts, messages = read_rosbags(path)
    other_counts, others = read_mcap(path)
    assert counts == other_counts, (counts, other_counts)
    assert sum(counts.values()) == len(messages) == len(others)
    key = lambda one: (one[1], one[0])
    messages, others = sorted(messages, key=key), sorted(others, key=key)
    assert [one[:3] for one in messages] == [one[:3] for one in others]
    clouds = [(one[3], other[3]) for one, other in zip(messages, others) if one[0].endswith("/points")]
    boxes = [(one[3], other[3]) for one, other in zip(messages, others) if one[0].endswith("/markers")]
    files = sorted(folder.glob("sweep_*.csv"))
    assert len(files) == len(clouds) == len(boxes) > 0, (len(files), len(clouds), len(boxes))
    with open(segments) as file:
        segments = list(csv.DictReader(file))
    points = 0
    for number, file in enumerate(files):
        with open(file) as text:
            lines = list(csv.DictReader(text))
        own = [line for line in segments if int(line["seq"]) == int(file.stem.removeprefix("sweep_"))]
        for cloud, markers in zip(clouds[number], boxes[number]):
            check_points(cloud, lines, rows)
            check_boxes(markers.markers, own, cloud)
        points += len(lines)
    # Nobody has said where the sensor sits.
    assert all(one[0] != "/tf_static" for one in messages)
    print(f"{len(files)} sweeps, {points} points, {len(segments)} boxes")


main()
