"""A client of sweepd-ros2's parameters, with rclpy's own client, beside a subscriber of a cloud, of the log and of the parameters' events. It
tells on its standard output when it is ready, when the services are there, and as JSON what came of each step.
"""

import json
import tempfile
import time

import rclpy
import yaml
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

GET = ["stamp", "organized", "fields", "scan_heights", "scan_ring", "base_frame", "roof.frame_id", "roof.min_columns"]
LATE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def dumped(node, values):
    """The text that `ros2 param dump` writes."""
    parameters = {}
    for name, value in values.items():
        *above, own = name.split(".")
        below = parameters
        for part in above:
            below = below.setdefault(part, {})
        below[own] = value
    return yaml.dump({node: {"ros__parameters": parameters}})


def main():
    rclpy.init()
    node = Node("client")
    client = AsyncParameterClient(node, "sweepd")
    lines, heights, events = [], [], []
    node.create_subscription(Log, "/rosout", lambda line: lines.append([line.level, line.name, line.msg]), LATE)
    node.create_subscription(PointCloud2, "/sweepd/roof/points", lambda cloud: heights.append(cloud.height), 5)

    def heard(event):
        if event.node == "/sweepd":
            assert not event.deleted_parameters and abs(time.time() - event.stamp.sec) < 60
            new, changed = [{one.name: parameter_value_to_python(one.value) for one in ones}
                            for ones in (event.new_parameters, event.changed_parameters)]
            events.append({"new": new, "changed": changed})

    client.on_parameter_event(heard)

    def answer(future):
        rclpy.spin_until_future_complete(node, future, timeout_sec=60)
        return future.result()

    def set_to(**values):
        parameters = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        return results(answer(client.set_parameters(parameters)))

    def results(done):
        return [[result.successful, result.reason] for result in done.results]

    def values_of(names):
        return [parameter_value_to_python(value) for value in answer(client.get_parameters(names)).values]

    def event_of(is_it):
        wait_for("an event", lambda: any(map(is_it, events)))
        return next(filter(is_it, events))

    def wait_for(what, is_it):
        end = time.monotonic() + 60
        while not is_it():
            assert time.monotonic() < end, what
            rclpy.spin_once(node, timeout_sec=0.1)

    print("ready", flush=True)
    said = {"there": client.wait_for_services(20)}
    wait_for("a publisher of events", lambda: len(node.get_publishers_info_by_topic("/parameter_events")) == 2)
    print("there", flush=True)
    wait_for("a cloud", lambda: heights)
    said["names"] = list(answer(client.list_parameters(["roof"], 1)).result.names)
    said["all"] = len(answer(client.list_parameters()).result.names)
    said["values"] = values_of(GET)
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
    said["kept"] = values_of(["roof.organized"])
    said["new"] = event_of(lambda event: "roof.stamp" in event["new"])
    said["changed"] = [event_of(lambda event: name in event["changed"]) for name in ("roof.organized", "roof.only_complete")]
    said["hashes"] = [str(info.topic_type_hash) for info in node.get_publishers_info_by_topic("/parameter_events")]
    said["rings"] = [set_to(roof__scan_ring=value) + values_of(["roof.scan_ring"]) for value in (3, None)]
    names = [name for name in answer(client.list_parameters()).result.names if not name.endswith("only_complete")]
    before = dict(zip(names, values_of(names)))
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(dumped("/sweepd", before))
        file.flush()
        said["set"] += set_to(stamp="last", roof__fields=["x"], roof__scan_ring=5)
        said["loaded"] = results(answer(client.load_parameter_file(file.name)))
    said["same"] = values_of(names) == list(before.values())
    wait_for("the log", lambda: any("set by a client: roof.organized" in line for _, _, line in lines))
    said["log"] = [line for line in lines if line[1] == "sweepd"]
    print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()
