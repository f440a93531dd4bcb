"""A node of ROS 2 that tells where a robot is which moves evenly, each 20 ms of its time, as soon as a sweep needs it.

Its argument is a JSON object: {"cloud": topic, "start_ns": when the robot was at the origin, "velocity": [right, ahead] m/s,
"turn": clockwise rad/s, "child": frame}. A cloud's stamp says what is
needed. On standard output come lines of JSON: {"ready": true}, and how many messages there were.
"""

import json
import math
import sys

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

STEP_NS = 20_000_000
# A sweep, and a step more.
AHEAD_NS = 130_000_000


def say(message):
    print(json.dumps(message), flush=True)


class Robot(Node):
    def __init__(self, wanted):
        super().__init__("robot")
        self.wanted = wanted
        self.next_ns = None
        self.count = 0
        self.publisher = self.create_publisher(Odometry, "/odom", 10)
        quality = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(PointCloud2, wanted["cloud"], self.cloud, quality)

    def cloud(self, cloud):
        stamp_ns = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
        if self.next_ns is None or abs(self.next_ns - stamp_ns) > 1_000_000_000:
            self.next_ns = stamp_ns - 2 * STEP_NS
        while self.next_ns < stamp_ns + AHEAD_NS:
            self.publisher.publish(self.message(self.next_ns))
            self.next_ns += STEP_NS
            self.count += 1
        say({"messages": self.count})

    def message(self, time_ns):
        wanted = self.wanted
        seconds = (time_ns - wanted["start_ns"]) * 1e-9
        right, ahead = (speed * seconds for speed in wanted["velocity"])
        half = -wanted["turn"] * seconds / 2
        message = Odometry()
        position, rotation = message.pose.pose.position, message.pose.pose.orientation
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 1_000_000_000)
        message.header.frame_id, message.child_frame_id = "odom", wanted["child"]
        position.x, position.y = ahead, -right
        rotation.z, rotation.w = math.sin(half), math.cos(half)
        return message


def main():
    rclpy.init()
    robot = Robot(json.loads(sys.argv[1]))
    say({"ready": True})
    rclpy.spin(robot)


if __name__ == "__main__":
    main()
