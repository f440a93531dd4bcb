"""What rclpy makes of command lines: reads rows of rcl.txt, prints one line of JSON for each."""

import json
import os
import sys
import tempfile

import rclpy
import rclpy.type_support
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from type_description_interfaces.srv import GetTypeDescription

TOPICS = ["~/roof/points", "/tf_static", "/diagnostics"]
OF_NODE = {"sensors": [""], "root": "", "health": "127.0.0.1:9177", "base_frame": "base_link", "clock": False}
OF_SENSOR = {"frame_id": "roof", "stamp": "first", "organized": False, "layout": "xyzirt"}


def taken(words):
    context = rclpy.Context()
    try:
        rclpy.init(args=["sweepd-ros2", *words], context=context)
        node = Node("sweepd", context=context, enable_rosout=False, start_parameter_services=False)
        given = {}
        # A node that declares them, so that a value of another type is refused.
        for name, default in [*OF_NODE.items(), *OF_SENSOR.items()]:
            given[name] = node.declare_parameter(name, default).value
        for name in OF_SENSOR:
            given[name] = node.declare_parameter(f"roof.{name}", given[name]).value
    except Exception as error:
        return {"refused": f"{type(error).__name__}: {error}"}
    given["sensors"] = [name for name in given["sensors"] if name]
    topics = [node.resolve_topic_name(topic) for topic in TOPICS]
    return {"node": node.get_fully_qualified_name(), "topics": topics, **given}


def row(line):
    words, has_file, text = line.partition(" <<< ")
    words = words.split()
    if not has_file:
        return taken(words)
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(text.replace("\\n", "\n"))
        file.flush()
        return taken([*words, "--params-file", file.name])


# Once, not in each process.
for message in (ParameterEvent, Clock):
    rclpy.type_support.check_for_type_support(message)
rclpy.type_support.check_is_valid_srv_type(GetTypeDescription)
for line in sys.stdin:
    # In a process of its own: what rcl keeps for all nodes of a process is that of one row.
    if not os.fork():
        print(json.dumps(row(line.rstrip("\n"))), flush=True)
        os._exit(0)
    if os.wait()[1] != 0:
        print("null", flush=True)
