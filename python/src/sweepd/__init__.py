"""The sweeps of a Velodyne that sweepd shares on this host, or makes of a capture, as NumPy arrays.

    for sweep in sweepd.Client("roof"):                      # a running daemon
        things = sweep.points("robot")[sweep.label >= 2]     # metres

    for sweep in sweepd.replay("capture.pcap"):              # a capture
        nearest_m = sweep.segments["nearest_m"].min(initial=float("inf"))

    for message in sweepd.Client("roof").objects():          # objects while the head turns
        boxes = message.boxes("robot")                       # least and greatest x, y, z

`sensors` names what is published on this host, `Sweep` says what there is of a sweep. Lengths are metres, angles
radians, times nanoseconds since 1970; images are arrays of (columns, rows), the highest beam first. `sweepd.layout` has
the numbers of docs/layout.md.
"""

from . import layout
from ._client import Client
from ._header import ROS
from ._library import sensors
from ._objects import Objects, ObjectsMessage
from ._replay import replay
from ._sweep import Obstacle, Sweep
from .layout import LayoutError, SweepdError

__version__ = "0.4.0.dev0"
__all__ = [
    "ROS", "Client", "LayoutError", "Objects", "ObjectsMessage", "Obstacle", "Sweep", "SweepdError", "layout", "replay",
    "sensors",
]  # fmt: skip
