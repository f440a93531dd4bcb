"""A node of ROS 2 that tells what it hears, and publishes: rclpy, its own deserialiser, and the graph as it sees it.

Its argument is a JSON object: {"clouds": [topic, ...], "images": [topic, ...], "scans": [topic, ...],
"diagnostics": bool, "data": bool, "sim_time": bool, "qualities": ["best_effort", "reliable"], "nodes": bool,
"publish": [[topic, quality, bytes], ...]}: those clouds 20 times a second, numbered by the seconds of their stamps from 1 on, or one on a
topic that is "transient_local". On standard output each message is a line of JSON; with "bytes"
in it, that many bytes of the message's data follow.
"""

import fcntl
import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, LaserScan, PointCloud2

# Deeper than usual: what is judged is what arrives, not how fast Python takes it.
DEPTH = 50
QUALITIES = {
    "best_effort": QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
    "reliable": QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE),
}
OFFERS = QUALITIES | {
    "transient_local": QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL),
}


def say(message, data=b""):
    if data:
        message["bytes"] = len(data)
    sys.stdout.buffer.write(json.dumps(message).encode() + b"\n")
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


def head(topic, quality, message):
    """What clouds and images have in common."""
    stamp = message.header.stamp
    return {
        "received_ns": time.time_ns(),
        "topic": topic,
        "quality": quality,
        "stamp_ns": stamp.sec * 1_000_000_000 + stamp.nanosec,
        "frame_id": message.header.frame_id,
        "height": message.height,
        "width": message.width,
        "is_bigendian": bool(message.is_bigendian),
    }


class Peer(Node):
    def __init__(self, wanted):
        sim_time = wanted.get("sim_time", False)
        super().__init__("peer", parameter_overrides=[Parameter("use_sim_time", value=sim_time)])
        self.wanted = wanted
        self.graph = None
        for quality in wanted.get("qualities", QUALITIES):
            for topic in wanted.get("clouds", []):
                self.hear(PointCloud2, topic, quality, self.cloud)
            for topic in wanted.get("images", []):
                self.hear(Image, topic, quality, self.image)
        for topic in wanted.get("scans", []):
            self.hear(LaserScan, topic, "best_effort", self.scan)
        if sim_time:
            back = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
            self.jumps = self.get_clock().create_jump_callback(
                back, post_callback=lambda jump: say({"jump_ns": jump.delta.nanoseconds}))
            self.create_timer(0.1, lambda: say({"tick_ns": self.get_clock().now().nanoseconds}))
        if wanted.get("diagnostics"):
            self.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics, 10)

        for topic, quality, size in wanted.get("publish", []):
            self.publish(self.create_publisher(PointCloud2, topic, OFFERS[quality]), quality, size)

    def publish(self, publisher, quality, size):
        cloud = PointCloud2()

        def send():
            cloud.header.stamp.sec += 1
            cloud.data = bytes([cloud.header.stamp.sec % 256]) * size
            publisher.publish(cloud)

        if quality == "transient_local":
            send()
        else:
            self.create_timer(0.05, send)

    def hear(self, kind, topic, quality, heard):
        self.create_subscription(kind, topic, lambda message: heard(topic, quality, message), QUALITIES[quality])

    def cloud(self, topic, quality, cloud):
        said = head(topic, quality, cloud)
        said["fields"] = [[field.name, field.offset, field.datatype, field.count] for field in cloud.fields]
        said["point_step"], said["row_step"] = cloud.point_step, cloud.row_step
        said["clock_ns"] = self.get_clock().now().nanoseconds
        said["is_dense"], said["length"] = cloud.is_dense, len(cloud.data)
        say(said, memoryview(cloud.data).cast("B") if self.wanted.get("data") else b"")

    def image(self, topic, quality, image):
        said = head(topic, quality, image)
        said["encoding"], said["step"], said["length"] = image.encoding, image.step, len(image.data)
        say(said, memoryview(image.data).cast("B"))

    def scan(self, topic, quality, scan):
        stamp = scan.header.stamp
        say({"topic": topic, "quality": quality, "stamp_ns": stamp.sec * 1_000_000_000 + stamp.nanosec,
             "frame_id": scan.header.frame_id, "angles": [scan.angle_min, scan.angle_max, scan.angle_increment],
             "times": [scan.time_increment, scan.scan_time], "limits": [scan.range_min, scan.range_max],
             "intensities": len(scan.intensities)}, scan.ranges.tobytes())

    def diagnostics(self, array):
        statuses = []
        for status in array.status:
            level = status.level[0] if isinstance(status.level, bytes) else status.level
            values = {pair.key: pair.value for pair in status.values}
            statuses.append({"name": status.name, "level": level, "message": status.message,
                             "hardware_id": status.hardware_id, "values": values})
        say({"diagnostics": statuses})

    def look(self):
        """Tells of the graph when it has changed."""
        nodes = sorted(namespace.rstrip("/") + "/" + name for name, namespace in self.get_node_names_and_namespaces())
        publishers, subscriptions = {}, {}
        if "/sweepd" in nodes:
            # The node goes while it is asked for.
            try:
                topics = self.get_publisher_names_and_types_by_node("sweepd", "/")
                subscriptions = dict(self.get_subscriber_names_and_types_by_node("sweepd", "/"))
            except rclpy._rclpy_pybind11.NodeNameNonExistentError:
                topics = []
            for topic, _ in topics:
                publishers[topic] = [
                    {"node": info.node_namespace.rstrip("/") + "/" + info.node_name, "type": info.topic_type,
                     "hash": str(info.topic_type_hash), "reliability": info.qos_profile.reliability.name,
                     "durability": info.qos_profile.durability.name}
                    for info in self.get_publishers_info_by_topic(topic)]
        graph = {"nodes": nodes, "publishers": publishers, "subscriptions": subscriptions}
        if graph != self.graph:
            self.graph = graph
            say({"graph": graph})


def main():
    # Large pieces of a cloud at a time.
    fcntl.fcntl(sys.stdout, fcntl.F_SETPIPE_SZ, 1 << 20)
    rclpy.init()
    peer = Peer(json.loads(sys.argv[1]))
    say({"ready": True})
    looked = 0.0
    while rclpy.ok():
        rclpy.spin_once(peer, timeout_sec=0.1)
        if peer.wanted.get("nodes") and time.monotonic() - looked > 0.5:
            looked = time.monotonic()
            peer.look()


if __name__ == "__main__":
    main()
