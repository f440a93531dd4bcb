"""A client of sweepd-ros2's parameters, with rclpy's own client, beside a subscriber of a cloud and of the log. It tells on its standard
output, as JSON, what came of each step.
"""

import json
import time

import rclpy
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

GET = ["stamp", "organized", "fields", "scan_heights", "scan_ring", "base_frame", "roof.frame_id", "roof.min_columns"]
LATE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main():
    rclpy.init()
    node = Node("client")
    client = AsyncParameterClient(node, "sweepd")
    lines, heights = [], []
    node.create_subscription(Log, "/rosout", lambda line: lines.append([line.level, line.name, line.msg]), LATE)
    node.create_subscription(PointCloud2, "/sweepd/roof/points", lambda cloud: heights.append(cloud.height), 5)

    def answer(future):
        rclpy.spin_until_future_complete(node, future, timeout_sec=20)
        return future.result()

    def set_to(**values):
        parameters = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        return [[result.successful, result.reason] for result in answer(client.set_parameters(parameters)).results]

    def wait_for(what, is_it):
        end = time.monotonic() + 30
        while not is_it():
            assert time.monotonic() < end, what
            rclpy.spin_once(node, timeout_sec=0.1)

    print("ready", flush=True)
    said = {"there": client.wait_for_services(20)}
    wait_for("a cloud", lambda: heights)
    said["names"] = list(answer(client.list_parameters(["roof"], 1)).result.names)
    said["all"] = len(answer(client.list_parameters()).result.names)
    said["values"] = [parameter_value_to_python(value) for value in answer(client.get_parameters(GET)).values]
    said["types"] = list(answer(client.get_parameter_types(GET)).types)
    said["unknown"] = len(answer(client.get_parameters(["stamp", "none"])).values)
    said["described"] = [[one.name, one.type, one.read_only] for one in answer(client.describe_parameters(["roof.stamp", "root"])).descriptors]
    said["before"] = heights[-1]
    said["set"] = set_to(roof__organized=True, stamp="centre", root="/x", none=1)
    wait_for("another cloud", lambda: heights[-1] != said["before"])
    said["after"] = heights[-1]
    both = [Parameter("roof.organized", value=False), Parameter("min_columns", value=-1)]
    result = answer(client.set_parameters_atomically(both)).result
    said["atomically"] = [result.successful, result.reason]
    said["kept"] = [parameter_value_to_python(value) for value in answer(client.get_parameters(["roof.organized"])).values]
    wait_for("the log", lambda: any("set by a client" in line for _, _, line in lines))
    said["log"] = [line for line in lines if line[1] == "sweepd"]
    print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()
