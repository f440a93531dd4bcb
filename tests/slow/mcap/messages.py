"""Deserialises, by rosbags, the messages that no MCAP file of ours has.

usage: messages.py FOLDER

FOLDER has expected.json: by the name of a file in FOLDER, the type, the definition, the hash and the values that its
message must have.
"""

import json
import math
import sys
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def same(found, expected):
    if isinstance(expected, dict):
        return all(same(getattr(found, name), value) for name, value in expected.items())
    if isinstance(expected, list):
        return len(found) == len(expected) and all(same(one, other) for one, other in zip(found, expected))
    if expected == "nan":
        return math.isnan(found)
    return found == expected


def values(message, kind):
    """The pixels of an image; else the message itself."""
    if kind != "sensor_msgs/msg/Image":
        return message
    code = {"32FC1": "<f4", "16UC1": "<u2", "32SC1": "<i4"}[message.encoding]
    message.data = message.data.view(code)
    return message


def main():
    folder = Path(sys.argv[1])
    expected = json.loads((folder / "expected.json").read_text())
    for name, one in expected.items():
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(one["definition"], one["type"]))
        assert store.hash_rihs01(one["type"]) == one["hash"], name
        raw = (folder / name).read_bytes()
        message = values(store.deserialize_cdr(raw, one["type"]), one["type"])
        for field, value in one["values"].items():
            assert same(getattr(message, field), value), (name, field, getattr(message, field), value)
    print(len(expected))


main()
