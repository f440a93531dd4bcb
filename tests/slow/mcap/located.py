"""Writes, by rosbags, messages that tell where a robot is, in both byte orders: located.py FOLDER.

For each definition in FOLDER, such as Odometry.txt, the message in Odometry.little and Odometry.big. The type's hash is printed.
"""

import sys
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FOLDER = Path(sys.argv[1])


def main():
    for kind in ("nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"):
        name = kind.rsplit("/", 1)[1]
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg((FOLDER / f"{name}.txt").read_text(), kind))
        of = store.types
        header = of["std_msgs/msg/Header"](of["builtin_interfaces/msg/Time"](1_700_000_000, 5), "odom")
        turned = of["geometry_msgs/msg/Quaternion"](0.5, -0.5, 0.5, 0.5)
        if name == "Odometry":
            pose = of["geometry_msgs/msg/Pose"](of["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), turned)
            still = of["geometry_msgs/msg/Vector3"](4.0, 5.0, 6.0)
            twist = of["geometry_msgs/msg/Twist"](still, still)
            message = of[kind](header, "base_link", of["geometry_msgs/msg/PoseWithCovariance"](pose, np.full(36, 7.0)),
                               of["geometry_msgs/msg/TwistWithCovariance"](twist, np.full(36, 8.0)))
        else:
            moved = of["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
            transform = of["geometry_msgs/msg/Transform"](moved, turned)
            stamped = of["geometry_msgs/msg/TransformStamped"]
            message = of[kind]([stamped(header, child, transform) for child in ("camera", "base_link")])
        for order in ("little", "big"):
            data = store.serialize_cdr(message, kind, little_endian=order == "little")
            (FOLDER / f"{name}.{order}").write_bytes(data)
        print(store.hash_rihs01(kind))


main()
