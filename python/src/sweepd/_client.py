"""The sweeps of a running daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._followed import Followed
from ._library import encoded, library
from ._objects import Objects
from ._sweep import Sweep

if TYPE_CHECKING:
    import os

    import numpy as np
    from numpy.typing import NDArray


class Client(Followed[Sweep]):
    """The sweeps of one sensor of a daemon on this host, one after the other; also an endless iterator over them.

    * It may be made before the daemon is started, and goes on when that was restarted.
    * It must run as the daemon's user. Another one is refused with both names.
    * Its sweeps are views into the memory that the daemon wrote. What you hold never changes, but no consumer may hold
      more than two sweeps: `sweep.copy()`, or copy an array, and drop the rest. A consumer that holds two, or is slow,
      delays neither the daemon nor other consumers: it misses sweeps, which `missed` counts.
    * A client belongs to one thread; arrays of its sweeps may go to others.
    """

    _topic = "sweeps"

    def __init__(self, name: str, root: str | os.PathLike[str] | None = None) -> None:
        """Follow the sensor of this name. `root`: the daemon's folder, if not the default one."""
        super().__init__(name, root, library().sweepd_client_open(name.encode(), encoded(root)))

    @property
    def missed(self) -> int:
        """How many sweeps were published and did not come, between the first and the newest one that came of a run."""
        return int(self._opened.call("missed"))

    def _received(self, data: NDArray[np.uint8]) -> Sweep:
        return Sweep(data)

    def latest(self, timeout: float | None = None) -> Sweep | None:
        """Do as `next`, but of several sweeps that wait give the newest."""
        sweep = self.next(timeout)
        while sweep is not None and self._opened.call("has_next"):
            # Given back first: no more than two may be held.
            sweep = None
            sweep = self.next(timeout)
        return sweep

    def objects(self) -> Objects:
        """Follow the objects of the same sensor while its head turns."""
        return Objects(self)
