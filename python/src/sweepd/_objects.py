"""Objects while the head turns: messages, and how they come."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _show, layout
from ._followed import Followed
from ._header import Floats, Frame, Headed
from .layout import LABEL, OBJECT, OBJECTS_HEADER

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ._client import Client


class ObjectsMessage(Headed):
    """Objects of one sweep that became known together. Its memory is this program's own: it may be kept."""

    header: Any
    objects: NDArray[np.void]
    labels: NDArray[np.uint32]

    # So that help() has them.
    __slots__ = {  # noqa: RUF023
        "header": "A copy of the header: a record of `layout.OBJECTS_HEADER`, as in `message.header['sent_ns']`.",
        "objects": "(objects,) records of `layout.OBJECT`: `segment` as in the table of segments, metres in the frame of"
        " the sensor, `why` it is told, azimuths in radians, times in nanoseconds since the header's.",
        "labels": "(labels,) u32, labels of objects of the sweep, from that with the ordinal `header['first_label']` on: in"
        " the last messages of a sweep. 0 where a late packet has changed the object.",
    }

    def __init__(self, data: Any) -> None:
        """Check and copy `data`, the bytes of a message: an array of u8, or what NumPy takes for one.

        Raises `LayoutError` for what is no message.
        """
        if not isinstance(data, np.ndarray):
            data = np.frombuffer(data, np.uint8)
        self.header = layout.checked_objects_header(data)
        of_objects = int(self.header["objects"]) * OBJECT.itemsize
        of_labels = int(self.header["labels"]) * LABEL.itemsize
        told = data[OBJECTS_HEADER.itemsize :][: of_objects + of_labels].copy()
        told.flags.writeable = False
        self.objects = told[:of_objects].view(OBJECT)
        self.labels = told[of_objects:].view(LABEL)

    def __repr__(self) -> str:
        """Say of which sweep it is and what is in it."""
        return f"<sweepd.ObjectsMessage {_show.one_line(self._told())}>"

    def _repr_html_(self) -> str:
        """Give a table, for notebooks."""
        return _show.table("ObjectsMessage", self._told())

    def _told(self) -> dict[str, str]:
        """What is said of it."""
        nearest_m = self.objects["segment"]["nearest_m"]
        return {
            "sensor": self.name,
            "sequence": str(self.sequence),
            "sent": _show.time(self.header["sent_ns"]),
            "objects": str(len(self.objects)),
            "nearest": f"{nearest_m.min():.2f} m" if len(nearest_m) else "none",
            "labels": str(len(self.labels)),
            "last": "yes" if self.is_last else "no",
        }

    @property
    def is_last(self) -> bool:
        """Whether this is the last message of the sweep: all its objects and labels have been sent."""
        return self.has(layout.OBJECTS_LAST)

    @property
    def is_segment(self) -> NDArray[np.bool_]:
        """Which objects are segments of the sweep's table: (objects,).

        The others are parts of wide objects, and what lies across the cut of two turns.
        """
        segments: NDArray[np.bool_] = np.isin(self.objects["why"], (layout.WHY_COMPLETE, layout.WHY_SWEEP))
        return segments

    def when(self) -> NDArray[np.int64]:
        """Give the time of each object's newest shot: (objects,), nanoseconds since 1970 in the clock of the header."""
        times: NDArray[np.int64] = self.objects["last_ns"].astype(np.int64) + self.header["time_ns"]
        return times

    def boxes(self, frame: Frame = "sensor") -> Floats:
        """Give the box of each object: (objects, 2, 3), metres: least x, y, z and greatest.

        `frame` as in `Sweep.points`. In another frame than the sensor's it is the box around the box.
        """
        return self._boxes(self.objects["segment"], frame)


class Objects(Followed[ObjectsMessage]):
    """The objects of one sensor while its head turns, message after message; also an endless iterator over these.

    The daemon publishes them while they have a consumer, which it notices within about a second. A consumer that is
    slow by more than the 64 messages of its queue, a turn and more, misses some: then `header["first_ordinal"]` is greater
    than the number of objects that came before. All else is as in `Client`, but that any number of messages may be held.
    """

    _topic = "objects"

    def __init__(self, client: Client) -> None:
        """Follow the objects of a client's sensor: `client.objects()`."""
        super().__init__(client.name, client.root, client._opened.call("objects"))

    def _received(self, data: NDArray[np.uint8]) -> ObjectsMessage:
        return ObjectsMessage(data)
