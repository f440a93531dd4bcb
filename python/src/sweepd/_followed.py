"""What a running daemon shares of a sensor: waiting for it, and its memory."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import threading
import time
import weakref
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from . import _library, _show
from ._library import library
from .layout import LayoutError, SweepdError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

T = TypeVar("T")
LOG = logging.getLogger("sweepd")

# How long the library waits at once, seconds: a signal that comes between two waits is handled after that.
WAIT_S = 0.2
# How long nothing comes before the log says so, seconds: a daemon is restarted faster.
SILENT_S = 3.0


class Followed(Generic[T]):
    """What one sensor has on one topic, one after the other; also an endless iterator over it."""

    # What it is, in messages.
    _topic: str

    def __init__(self, name: str, root: str | os.PathLike[str] | None, opened: Any) -> None:
        """Follow what was opened, unless that failed."""
        if not opened:
            raise SweepdError(_library.error())
        self._name = name
        self._root = root
        self._opened = _Opened(opened)
        self._silent_since: float | None = None
        weakref.finalize(self, self._opened.close)

    def __iter__(self) -> Iterator[T]:
        """Wait for each."""
        return self

    def __next__(self) -> T:
        """Wait for the next, as long as it takes."""
        while (received := self.next()) is None:
            pass
        return received

    def __repr__(self) -> str:
        """Say what is followed, and whether it is there."""
        return f"<sweepd.{type(self).__name__} {_show.one_line(self._told())}>"

    def _repr_html_(self) -> str:
        """Give a table, for notebooks."""
        return _show.table(type(self).__name__, self._told())

    def _told(self) -> dict[str, str]:
        """What is said of it."""
        if self._opened.is_of_parent():
            return {"sensor": self.name, "of": "the process that forked"}
        published = ("yes" if self.is_published else "no") if self.is_connected else "not found yet"
        told = {"sensor": self.name, "published": published}
        if self.model is not None:
            told["model"] = self.model
        if self.address is not None:
            told["address"] = self.address
        return told

    def _received(self, data: NDArray[np.uint8]) -> T:
        """Give what these bytes are; views of them keep them."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self._name

    @property
    def root(self) -> str | os.PathLike[str] | None:
        """The daemon's folder; `None`: the default one."""
        return self._root

    @property
    def is_connected(self) -> bool:
        """Whether the service was found; the daemon may be gone since."""
        return bool(self._opened.call("is_connected"))

    @property
    def is_published(self) -> bool:
        """Whether a daemon publishes at the moment, once the service was found.

        A daemon that was killed could not say so, and still counts: only that sweeps come tells that it is alive.
        """
        return bool(self._opened.call("is_published"))

    @property
    def reopened(self) -> int:
        """How often the service was lost and looked for again."""
        return int(self._opened.call("reopened"))

    @property
    def model(self) -> str | None:
        """Model of the sensor, once the service was found."""
        return self.attribute("model")

    @property
    def address(self) -> str | None:
        """Where the sensor's packets come from, once the service was found."""
        return self.attribute("address")

    def attribute(self, key: str) -> str | None:
        """Give an attribute of the service, once it was found: "schema", "model" or "address"."""
        return _library.text(lambda *room: self._opened.call("attribute", key.encode(), *room))

    def next(self, timeout: float | None = None) -> T | None:
        """Wait for the next, and for the daemon if there is none, but at most `timeout` seconds; `None` then.

        After three seconds without any, a warning in the log `sweepd` says what there is instead. Raises `SweepdError` for
        what does not pass by waiting.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            rest_s = WAIT_S if deadline is None else max(0.0, deadline - time.monotonic())
            sample = _Sample()
            reason = self._opened.next(min(rest_s, WAIT_S), sample)
            if reason == _library.RECEIVED:
                self._silent_since = None
                return self._received(sample.array())
            self._warn_of(reason)
            if rest_s == 0.0 and reason != _library.INTERRUPTED:
                return None

    def _warn_of(self, reason: int) -> None:
        """Say once, when nothing has come for a while, what there is."""
        now = time.monotonic()
        if reason == _library.INTERRUPTED:
            return
        if self._silent_since is None:
            self._silent_since = now
        elif now - self._silent_since >= SILENT_S:
            self._silent_since = float("inf")
            LOG.warning("%s (still waiting)", self._silence(reason))

    def _silence(self, reason: int) -> str:
        """Why nothing comes, as far as can be told."""
        there = _library.sensors(self.root)
        if reason == _library.UNPUBLISHED and self.name not in there:
            names = ", ".join(f"`{name}`" for name in there)
            others = f"what is published here: {names}" if names else "nor anything else here: is sweepd running?"
            return f"nobody publishes the {self._topic} of `{self.name}`, {others}"
        if reason == _library.UNPUBLISHED and self._topic == "objects":
            return f"`{self.name}` is published, but without objects"
        return f"nothing comes of `{self.name}`: is its daemon alive, and its sensor on?"


class _Opened:
    """A client of the library, which one thread at a time may use."""

    def __init__(self, client: int) -> None:
        self._client: int | None = client
        self._process = os.getpid()
        # A signal's handler, which runs in between, may use it.
        self._lock = threading.RLock()

    def is_of_parent(self) -> bool:
        """Whether the process was forked since."""
        return os.getpid() != self._process

    def call(self, function: str, *args: Any) -> Any:
        """Call the function of the library that has this name behind `sweepd_client_`."""
        # Before the lock, which a thread of the parent may have held.
        if self.is_of_parent():
            raise SweepdError("this client is of the process that forked: make one here")
        with self._lock:
            if self._client is None:
                raise SweepdError("the program ends, and its clients are closed")
            return getattr(library(), f"sweepd_client_{function}")(self._client, *args)

    def next(self, timeout_s: float, sample: _Sample) -> int:
        """Wait for a sample, and give why that ended."""
        reason = int(self.call("next", round(timeout_s * 1e9), ctypes.byref(sample.pointer)))
        if reason == _library.INVALID:
            raise LayoutError(_library.error())
        if reason == _library.FAILED:
            said = _library.error()
            # A cell whose last line is a sweep keeps it in Out[].
            is_held = "holds" in said and "IPython" in sys.modules
            raise SweepdError(f"{said}; in a notebook, show `sweep.copy()`" if is_held else said)
        return reason

    def close(self) -> None:
        """Give back its place among the consumers, unless it is a parent's."""
        if not self.is_of_parent():
            with self._lock:
                client, self._client = self._client, None
                library().sweepd_client_close(client)


class _Sample:
    """A sample, or none yet. NumPy keeps this object, and so the memory, for as long as any array looks at it."""

    def __init__(self) -> None:
        # What Ctrl-C keeps from being returned is given back as well.
        self.pointer = ctypes.c_void_p()
        # Not at the end of the program, where arrays may still look at it.
        weakref.finalize(self, _release, self.pointer, os.getpid()).atexit = False

    def array(self) -> NDArray[np.uint8]:
        """Give its bytes."""
        length, is_read_only = ctypes.c_size_t(), True
        at = library().sweepd_sample_bytes(self.pointer, ctypes.byref(length))
        self.__array_interface__ = {
            "version": 3, "typestr": "|u1", "shape": (length.value,), "data": (at, is_read_only),
        }  # fmt: skip
        return np.asarray(self)


def _release(sample: ctypes.c_void_p, process: int) -> None:
    """Give a sample back, unless it is a parent's: the process was forked since."""
    if os.getpid() == process:
        library().sweepd_sample_release(sample)
