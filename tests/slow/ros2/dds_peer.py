"""Cyclone DDS, the other usual middleware of ROS 2, without ROS: it announces no type hashes, as ROS before Iron.

Its argument is a JSON object: {"domain": number, "clouds": [topic, ...], "markers": [topic, ...], "transforms": bool,
"graph": bool, "data": bool, "qualities": [...], "publish": [...]}. It tells and publishes as ros_peer.py does. Clouds are decoded by rosbags,
the rest by Cyclone itself.
"""

import fcntl
import json
import sys
import time
import types
from dataclasses import dataclass

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

# Deeper than usual: what is judged is what arrives, not how fast Python takes it.
DEPTH = 50
ANY = SampleState.Any | ViewState.Any | InstanceState.Any
ROS = get_typestore(Stores.ROS2_HUMBLE)


def ros(package, type_name, /, **members):
    names = {"typename": f"{package}::msg::dds_::{type_name}_"}
    return dataclass(types.new_class(type_name, (IdlStruct,), names, lambda body: body.update(__annotations__=members)))


Time = ros("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Duration = ros("builtin_interfaces", "Duration", sec=int32, nanosec=uint32)
Header = ros("std_msgs", "Header", stamp=Time, frame_id=str)
Field = ros("sensor_msgs", "PointField", name=str, offset=uint32, datatype=uint8, count=uint32)
Cloud = ros("sensor_msgs", "PointCloud2", header=Header, height=uint32, width=uint32, fields=sequence[Field],
            is_bigendian=bool, point_step=uint32, row_step=uint32, data=sequence[uint8], is_dense=bool)
Vector3 = ros("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
Point = ros("geometry_msgs", "Point", x=float64, y=float64, z=float64)
Quaternion = ros("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = ros("geometry_msgs", "Pose", position=Point, orientation=Quaternion)
Transform = ros("geometry_msgs", "Transform", translation=Vector3, rotation=Quaternion)
Stamped = ros("geometry_msgs", "TransformStamped", header=Header, child_frame_id=str, transform=Transform)
Tf = ros("tf2_msgs", "TFMessage", transforms=sequence[Stamped])
Color = ros("std_msgs", "ColorRGBA", r=float32, g=float32, b=float32, a=float32)
Compressed = ros("sensor_msgs", "CompressedImage", header=Header, format=str, data=sequence[uint8])
Uv = ros("visualization_msgs", "UVCoordinate", u=float32, v=float32)
Mesh = ros("visualization_msgs", "MeshFile", filename=str, data=sequence[uint8])
Marker = ros("visualization_msgs", "Marker", header=Header, ns=str, id=int32, type=int32, action=int32, pose=Pose,
             scale=Vector3, color=Color, lifetime=Duration, frame_locked=bool, points=sequence[Point],
             colors=sequence[Color], texture_resource=str, texture=Compressed, uv_coordinates=sequence[Uv], text=str,
             mesh_resource=str, mesh_file=Mesh, mesh_use_embedded_materials=bool)
Markers = ros("visualization_msgs", "MarkerArray", markers=sequence[Marker])
# Before Iron a Gid has 24 bytes.
Gid = ros("rmw_dds_common", "Gid", data=array[uint8, 24])
Entities = ros("rmw_dds_common", "NodeEntitiesInfo", node_namespace=str, node_name=str, reader_gid_seq=sequence[Gid],
               writer_gid_seq=sequence[Gid])
Graph = ros("rmw_dds_common", "ParticipantEntitiesInfo", gid=Gid, node_entities_info_seq=sequence[Entities])

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
QUALITIES = {"best_effort": Policy.Reliability.BestEffort, "reliable": RELIABLE}


def say(message, data=b""):
    if len(data):
        message["bytes"] = len(data)
    sys.stdout.buffer.write(json.dumps(message).encode() + b"\n")
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


def stamp_ns(header):
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def say_cloud(topic, quality, raw, wants_data):
    received_ns = time.time_ns()
    cloud = ROS.deserialize_cdr(raw, "sensor_msgs/msg/PointCloud2")
    say({"received_ns": received_ns, "topic": topic, "quality": quality, "stamp_ns": stamp_ns(cloud.header),
         "frame_id": cloud.header.frame_id, "height": cloud.height, "width": cloud.width,
         "fields": [[field.name, field.offset, field.datatype, field.count] for field in cloud.fields],
         "is_bigendian": cloud.is_bigendian, "point_step": cloud.point_step, "row_step": cloud.row_step,
         "is_dense": cloud.is_dense, "length": len(cloud.data)},
        cloud.data.tobytes() if wants_data else b"")


def say_transforms(message):
    transforms = []
    for stamped in message.transforms:
        translation, rotation = stamped.transform.translation, stamped.transform.rotation
        transforms.append({"parent": stamped.header.frame_id, "child": stamped.child_frame_id,
                           "translation": [translation.x, translation.y, translation.z],
                           "rotation": [rotation.x, rotation.y, rotation.z, rotation.w]})
    say({"transforms": transforms})


def say_markers(topic, message):
    markers = []
    for one in message.markers:
        markers.append({"ns": one.ns, "id": one.id, "type": one.type, "action": one.action,
                        "frame_id": one.header.frame_id, "stamp_ns": stamp_ns(one.header),
                        "position": [one.pose.position.x, one.pose.position.y, one.pose.position.z],
                        "scale": [one.scale.x, one.scale.y, one.scale.z], "points": len(one.points), "text": one.text})
    say({"topic": topic, "markers": markers})


def say_graph(message):
    nodes = [entities.node_namespace.rstrip("/") + "/" + entities.node_name
             for entities in message.node_entities_info_seq]
    writers = [bytes(gid.data).hex() for entities in message.node_entities_info_seq for gid in entities.writer_gid_seq]
    say({"participant": bytes(message.gid.data).hex(), "nodes": nodes, "writers": writers})


def main():
    # Large pieces of a cloud at a time.
    fcntl.fcntl(sys.stdout, fcntl.F_SETPIPE_SZ, 1 << 20)
    wanted = json.loads(sys.argv[1])
    participant = DomainParticipant(wanted["domain"])
    waits = WaitSet(participant)
    readers = []

    def hear(topic, kind, qos, heard):
        reader = DataReader(participant, Topic(participant, topic, kind), qos=qos)
        waits.attach(ReadCondition(reader, ANY))
        readers.append((reader, heard))

    for quality in wanted.get("qualities", QUALITIES):
        for topic in wanted.get("clouds", []):
            hear("rt" + topic, Cloud, Qos(QUALITIES[quality], Policy.History.KeepLast(DEPTH)),
                 lambda raw, topic=topic, quality=quality: say_cloud(topic, quality, raw, wanted.get("data")))
    for topic in wanted.get("markers", []):
        hear("rt" + topic, Markers, Qos(RELIABLE, Policy.History.KeepLast(5)),
             lambda raw, topic=topic: say_markers(topic, Markers.deserialize(raw)))
    late = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    if wanted.get("transforms"):
        hear("rt/tf_static", Tf, late, lambda raw: say_transforms(Tf.deserialize(raw)))
    if wanted.get("graph"):
        hear("ros_discovery_info", Graph, late, lambda raw: say_graph(Graph.deserialize(raw)))
    writers = []
    for topic, quality, size in wanted.get("publish", []):
        qos = Qos(QUALITIES[quality], Policy.History.KeepLast(5))
        writers.append((DataWriter(participant, Topic(participant, "rt" + topic, Cloud), qos=qos), size))
    say({"ready": True})
    number = 0
    while True:
        if writers:
            number += 1
            time.sleep(0.05)
        for writer, size in writers:
            data = [number % 256] * size
            writer.write(Cloud(header=Header(stamp=Time(sec=number, nanosec=0), frame_id=""), height=0, width=0, fields=[],
                               is_bigendian=False, point_step=0, row_step=0, data=data, is_dense=False))
        waits.wait(duration(milliseconds=0 if writers else 100))
        for reader, heard in readers:
            samples = ddspy_take(reader._ref, ANY, 8)
            assert not isinstance(samples, int), samples
            for raw, info in samples:
                if info.valid_data:
                    heard(raw)


if __name__ == "__main__":
    main()
