"""The sweeps of a running daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._followed import Followed
from ._library import encoded, library
from ._objects import Objects
from ._sweep import Sweep
from .layout import SweepdError

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
      delays neither the daemon nor other consumers: it misses sweeps, which `missed` counts. A notebook holds what the
      last line of a cell gives: end it with `sweep.copy()`.
    * A client belongs to one thread; arrays of its sweeps may go to others.
    * A client belongs to one process. After a fork (`multiprocessing` with "fork", workers of a `DataLoader`) the child
      makes a client of its own, and sweeps that the parent held may change there: copy them before.
    """

    _topic = "sweeps"

    def __init__(self, name: str, root: str | os.PathLike[str] | None = None) -> None:
        """Follow the sensor of this name. `root`: the daemon's folder, if not the default one.

        Raises `SweepdError` for what is no name.
        """
        super().__init__(name, root, library().sweepd_client_open(_name(name), encoded(root)))

    @property
    def missed(self) -> int:
        """How many sweeps were published and did not come, between the first and the newest one that came of a run."""
        return int(self._opened.call("missed"))

    def _received(self, data: NDArray[np.uint8]) -> Sweep:
        return Sweep(data)

    def latest(self, timeout: float | None = None) -> Sweep | None:
        """Like `next`, but returns the newest of several waiting sweeps."""
        sweep = self.next(timeout)
        while sweep is not None and self._opened.call("has_next"):
            # Given back first: no more than two may be held.
            sweep = None
            sweep = self.next(timeout)
        return sweep

    def objects(self) -> Objects:
        """Follow the objects of the same sensor while its head turns."""
        return Objects(self)


def _name(name: str) -> bytes:
    """Give the name of a sensor as the library takes it."""
    if not isinstance(name, str):
        raise SweepdError(f'the name of a sensor is a str, as in Client("roof"), and not {name!r}')
    # A zero would end it in C. The library refuses what is left in its place.
    return name.encode(errors="replace").replace(b"\0", b"?")
