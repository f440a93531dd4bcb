"""Reads a bag that `sweepd replay --bag FOLDER` wrote, beside the file that `--mcap FILE` wrote of the same sweeps.

usage: bag.py FOLDER FILE FRAME ROWS

The folder is read by its metadata, which must say what the file holds. Clouds have the frame FRAME, ROWS rows, and the layout
of Autoware.
"""

import sys
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

folder, file, frame, rows = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], int(sys.argv[4])


def read(path):
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        messages = [(one.topic, time, bytes(raw), reader.deserialize(raw, one.msgtype)) for one, time, raw in reader.messages()]
        topics = {one.topic: (one.msgcount, one.msgtype, str(one.ext.offered_qos_profiles)) for one in reader.connections}
    return messages, topics


messages, topics = read(folder)
expected, expected_topics = read(file)
assert [one[:3] for one in messages] == [one[:3] for one in expected] and messages
assert topics == expected_topics, (topics, expected_topics)
with Reader(folder) as reader:
    times = [one[1] for one in messages]
    assert reader.message_count == len(messages)
    assert (reader.start_time, reader.end_time) == (min(times), max(times) + 1), (reader.start_time, reader.end_time, times)
clouds = [one[3] for one in messages if one[0].endswith("/points")]
for cloud in clouds:
    names = [field.name for field in cloud.fields]
    assert (cloud.header.frame_id, cloud.point_step, cloud.is_dense) == (frame, 32, False)
    assert cloud.height == rows and cloud.width > 1 and names[-1] == "time_stamp", (cloud.height, names)
transforms = [one[3] for one in messages if one[0] == "/tf_static"]
(transform,) = transforms[-1].transforms
assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", frame)
print(len(clouds), sorted(topics))
