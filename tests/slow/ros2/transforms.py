"""Cyclone DDS, without ROS, that tells on /tf where a robot is which moves evenly, as odometry.py does on /odom.

Its argument is that of odometry.py, and {"domain": number}.
"""

import json
import math
import sys

from cyclonedds.core import Qos, ReadCondition, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from dds_peer import ANY, QUALITIES, Cloud, Header, Quaternion, Stamped, Tf, Time, Transform, Vector3, say, stamp_ns

STEP_NS = 20_000_000
# A sweep, and a step more.
AHEAD_NS = 130_000_000


def transform(wanted, time_ns, child):
    seconds = (time_ns - wanted["start_ns"]) * 1e-9
    right, ahead = (speed * seconds for speed in wanted["velocity"])
    half = -wanted["turn"] * seconds / 2
    sec, nanosec = divmod(time_ns, 1_000_000_000)
    moved = Transform(translation=Vector3(x=ahead, y=-right, z=0.0),
                      rotation=Quaternion(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)))
    return Stamped(header=Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id="odom"), child_frame_id=child, transform=moved)


def main():
    wanted = json.loads(sys.argv[1])
    participant = DomainParticipant(wanted["domain"])
    writer = DataWriter(participant, Topic(participant, "rt/tf", Tf), qos=Qos(QUALITIES["reliable"]))
    clouds = DataReader(participant, Topic(participant, "rt" + wanted["cloud"], Cloud), qos=Qos(QUALITIES["best_effort"]))
    waits = WaitSet(participant)
    waits.attach(ReadCondition(clouds, ANY))
    say({"ready": True})
    next_ns = 0
    while True:
        waits.wait(duration(milliseconds=100))
        for cloud in clouds.take():
            now_ns = stamp_ns(cloud.header)
            if abs(next_ns - now_ns) > 1_000_000_000:
                next_ns = now_ns - 2 * STEP_NS
            while next_ns < now_ns + AHEAD_NS:
                # Of a still camera, which nobody asked for, too.
                camera = transform(wanted, wanted["start_ns"], "camera")
                writer.write(Tf(transforms=[camera, transform(wanted, next_ns, wanted["child"])]))
                next_ns += STEP_NS


main()
