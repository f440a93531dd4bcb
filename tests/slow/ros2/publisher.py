"""A plain publisher: a node of rclpy that sends a cloud of so many bytes at 10 Hz, its stamp the time before it is sent.

publisher.py TOPIC BYTES
"""

import sys
import time

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField

NAMES = ["x", "y", "z", "intensity", "ring", "time", "label"]
OFFSETS = [0, 4, 8, 12, 16, 18, 22]
DATATYPES = [7, 7, 7, 7, 4, 7, 6]


def main():
    topic, size = sys.argv[1], int(sys.argv[2])
    rclpy.init()
    node = Node("plain")
    publisher = node.create_publisher(PointCloud2, topic, QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE))
    cloud = PointCloud2(height=1, width=size // 26, point_step=26, row_step=size // 26 * 26, is_dense=True)
    cloud.header.frame_id = "front"
    cloud.fields = [PointField(name=name, offset=offset, datatype=datatype, count=1)
                    for name, offset, datatype in zip(NAMES, OFFSETS, DATATYPES)]
    cloud.data.frombytes(bytes(cloud.row_step))

    def send():
        cloud.header.stamp.sec, cloud.header.stamp.nanosec = divmod(time.time_ns(), 1_000_000_000)
        publisher.publish(cloud)

    node.create_timer(0.1, send)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
