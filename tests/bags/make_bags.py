"""make_bags.py CAPTURE.pcap OTHER.pcap FOLDER

Writes the data packets of the first sensor of a capture into bags of every kind, and into
`plain.pcap`; and the packets of both captures into bags with two topics. The bags are written by
rosbags and mcap, which share no code with sweepd.
"""

import gzip
import struct
import sys
from pathlib import Path

import mcap.writer
import numpy
import rosbags.rosbag1 as ros1
import rosbags.rosbag2 as ros2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

# By the magic bytes of a little-endian pcap.
TICKS_NS = {b"\xd4\xc3\xb2\xa1": 1000, b"\x4d\x3c\xb2\xa1": 1}
TYPE = "velodyne_msgs/msg/VelodyneScan"
TYPES = {
    TYPE: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
}
ROS1_TYPES = {**TYPES, "velodyne_msgs/msg/VelodynePacket": "time stamp\nuint8[1206] data\n"}
DEFINITION = "\n".join(
    [
        "std_msgs/Header header\nVelodynePacket[] packets",
        "=" * 80 + "\nMSG: velodyne_msgs/VelodynePacket\nbuiltin_interfaces/Time stamp\nuint8[1206] data",
        "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
    ]
)


def packets_of(path):
    """The frames with data packets of the sensor that sends the first, each with its time in ns."""
    data = gzip.open(path).read() if path.endswith(".gz") else Path(path).read_bytes()
    tick_ns = TICKS_NS[data[:4]]
    at, found, first = 24, [], None
    while at + 16 <= len(data):
        seconds, fraction, captured, length = struct.unpack_from("<4I", data, at)
        frame = data[at + 16 : at + 16 + captured]
        at += 16 + captured
        if length == 42 + 1206 and frame[12:14] == b"\x08\x00":
            first = first or frame[26:38]
            if frame[26:38] == first:
                found.append((seconds * 10**9 + fraction * tick_ns, frame))
    return data[:24], found


def write_pcap(path, head, packets):
    with open(path, "wb") as file:
        file.write(head)
        for stamp, frame in packets:
            seconds, nanoseconds = divmod(stamp, 10**9)
            fraction = nanoseconds // TICKS_NS[head[:4]]
            file.write(struct.pack("<4I", seconds, fraction, len(frame), len(frame)) + frame)


def store_of(base, types):
    store = get_typestore(base)
    for name, text in types.items():
        store.register(get_types_from_msg(text, name))
    return store


ROS2 = store_of(Stores.ROS2_JAZZY, TYPES)
ROS1 = store_of(Stores.ROS1_NOETIC, ROS1_TYPES)


def scans(store, packets, count=60):
    """Messages of so many packets, each with the time when its last packet came."""
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    packet, scan = store.types["velodyne_msgs/msg/VelodynePacket"], store.types[TYPE]
    sequence = {"seq": 7} if store is ROS1 else {}
    for start in range(0, len(packets), count):
        part = packets[start : start + count]
        made = [
            packet(stamp=time(*divmod(stamp, 10**9)), data=numpy.frombuffer(frame[42:], dtype=numpy.uint8))
            for stamp, frame in part
        ]
        # A frame id whose length is no multiple of four.
        yield part[-1][0], scan(header=header(stamp=made[0].stamp, frame_id="velodyne", **sequence), packets=made)


def merged(topics, store):
    """The messages of several topics, in the order in which a recorder gets them."""
    all_scans = [(time, topic, scan) for topic, packets in topics.items() for time, scan in scans(store, packets)]
    return sorted(all_scans, key=lambda one: one[0])


def write_mcap(path, topics, compression):
    with open(path, "wb") as file:
        writer = mcap.writer.Writer(file, chunk_size=300_000, compression=compression)
        writer.start("ros2", "test")
        schema = writer.register_schema(TYPE, "ros2msg", DEFINITION.encode())
        other = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        chatter = writer.register_channel("/chatter", "cdr", other)
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in topics}
        for time, topic, scan in merged(topics, ROS2):
            writer.add_message(chatter, time, b"\0\1\0\0\3\0\0\0hi\0", time)
            writer.add_message(channels[topic], time, bytes(ROS2.serialize_cdr(scan, TYPE)), time)
        writer.finish()


def write_rosbag2(path, topics, plugin, compression=None):
    writer = ros2.Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, ros2.CompressionFormat.ZSTD)
    with writer:
        chatter = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=ROS2)
        connections = {topic: writer.add_connection(topic, TYPE, typestore=ROS2) for topic in topics}
        for time, topic, scan in merged(topics, ROS2):
            writer.write(chatter, time, b"\0\1\0\0\3\0\0\0hi\0")
            writer.write(connections[topic], time, ROS2.serialize_cdr(scan, TYPE))


def write_rosbag1(path, topics, compression=None):
    writer = ros1.Writer(path)
    writer.chunk_threshold = 200_000
    if compression:
        writer.set_compression(compression)
    with writer:
        chatter = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=ROS1)
        connections = {topic: writer.add_connection(topic, TYPE, typestore=ROS1) for topic in topics}
        for time, topic, scan in merged(topics, ROS1):
            writer.write(chatter, time, b"\2\0\0\0hi")
            writer.write(connections[topic], time, ROS1.serialize_ros1(scan, TYPE))


def main(capture, other, folder):
    folder = Path(folder)
    head, packets = packets_of(capture)
    other_head, others = packets_of(other)
    write_pcap(folder / "plain.pcap", head, packets)
    write_pcap(folder / "other.pcap", other_head, others)
    one = {"/velodyne_packets": packets}
    both = {"/left/velodyne_packets": packets, "/right/velodyne_packets": others}
    compressions = mcap.writer.CompressionType
    write_mcap(folder / "none.mcap", one, compressions.NONE)
    write_mcap(folder / "lz4.mcap", one, compressions.LZ4)
    write_mcap(folder / "zstd.mcap", one, compressions.ZSTD)
    write_mcap(folder / "two.mcap", both, compressions.ZSTD)
    sqlite, storage_mcap = ros2.StoragePlugin.SQLITE3, ros2.StoragePlugin.MCAP
    write_rosbag2(folder / "sqlite", one, sqlite)
    write_rosbag2(folder / "mcap", one, storage_mcap)
    write_rosbag2(folder / "zstd_messages", one, sqlite, ros2.CompressionMode.MESSAGE)
    write_rosbag2(folder / "zstd_files", one, storage_mcap, ros2.CompressionMode.FILE)
    write_rosbag2(folder / "two_sqlite", both, sqlite)
    write_rosbag2(folder / "empty", {}, sqlite)
    write_rosbag1(folder / "none.bag", one)
    write_rosbag1(folder / "lz4.bag", one, ros1.Writer.CompressionFormat.LZ4)
    write_rosbag1(folder / "bz2.bag", one, ros1.Writer.CompressionFormat.BZ2)
    write_rosbag1(folder / "two.bag", both, ros1.Writer.CompressionFormat.LZ4)


main(*sys.argv[1:])
