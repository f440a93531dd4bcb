"""Clients of rmw_cyclonedds, without ROS: two that get parameters of sweepd-ros2 at the same time, and one that sets `only_complete`.

Its argument is a JSON object: {"domain": number}. After each round it says {"round": number}; it ends where an answer is missing, wrong, or
for a client of another form. Requests and replies begin with the number of a client, which each chooses for itself, and that of the request.
"""

import json
import random
import sys
import time
import types
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int64, sequence, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
BOOL, STRING = 1, 4


def ros(folder, type_name, /, **members):
    names = {"typename": f"rcl_interfaces::{folder}::dds_::{type_name}_"}
    return dataclass(types.new_class(type_name, (IdlStruct,), names, lambda body: body.update(__annotations__=members)))


Value = ros("msg", "ParameterValue", type=uint8, bool=bool, integer=int64, double=float64, string=str, bytes=sequence[uint8],
            bools=sequence[bool], integers=sequence[int64], doubles=sequence[float64], strings=sequence[str])
Parameter = ros("msg", "Parameter", name=str, value=Value)
Result = ros("msg", "SetParametersResult", successful=bool, reason=str)
HEADER = {"client": uint64, "number": int64}
Get = ros("srv", "GetParameters_Request", **HEADER, names=sequence[str])
Got = ros("srv", "GetParameters_Response", **HEADER, values=sequence[Value])
Set = ros("srv", "SetParameters_Request", **HEADER, parameters=sequence[Parameter])
Done = ros("srv", "SetParameters_Response", **HEADER, results=sequence[Result])


class Client:
    def __init__(self, participant, service, asks, answers):
        self.id, self.number, self.asks = random.getrandbits(64), 0, asks
        self.writer = DataWriter(participant, Topic(participant, f"rq/sweepd/{service}Request", asks), qos=QOS)
        self.reader = DataReader(participant, Topic(participant, f"rr/sweepd/{service}Reply", answers), qos=QOS)

    def is_there(self):
        return self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()

    def ask(self, content):
        self.number += 1
        self.writer.write(self.asks(self.id, self.number, content))

    def answer(self, ids):
        end = time.monotonic() + 60
        while time.monotonic() < end:
            for reply in self.reader.take(10):
                # Others of this participant hear it, and no one else's answers.
                assert reply.client in ids, reply
                if reply.client == self.id:
                    assert reply.number == self.number, reply
                    return reply
            time.sleep(0.005)
        raise AssertionError(f"no answer to {self.asks.__name__} {self.number}")


def switch(value):
    return Value(BOOL, value, 0, 0.0, "", [], [], [], [], [])


def main():
    participant = DomainParticipant(json.loads(sys.argv[1])["domain"])
    one, other = [Client(participant, "get_parameters", Get, Got) for _ in range(2)]
    setter = Client(participant, "set_parameters", Set, Done)
    ids = [client.id for client in (one, other, setter)]
    print(json.dumps({"ready": True}), flush=True)
    while not all(client.is_there() for client in (one, other, setter)):
        time.sleep(0.1)
    for number in range(10**6):
        one.ask(["odometry", "base_frame"])
        other.ask(["only_complete"])
        values = one.answer(ids).values
        assert [(value.type, value.string) for value in values] == [(STRING, "odom"), (STRING, "base_link")], values
        assert [value.type for value in other.answer(ids).values] == [BOOL]
        if number % 10 == 0:
            setter.ask([Parameter("only_complete", switch(number % 20 == 0)), Parameter("root", switch(True))])
            done, refused = setter.answer(ids).results
            assert done.successful and not refused.successful and "read at the start" in refused.reason, refused
        print(json.dumps({"round": number}), flush=True)
        time.sleep(0.05)


if __name__ == "__main__":
    main()
