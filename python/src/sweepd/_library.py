"""The functions of `libsweepd.so`, as sweepd.h has them."""

from __future__ import annotations

import ctypes
import functools
import os
from pathlib import Path
from typing import Any, Callable

from .layout import SweepdError

NAME = "libsweepd.so"
# The interface of the library that this package calls.
ABI_VERSION = 1

# Why `sweepd_client_next` returned: `sweepd_next` of sweepd.h.
RECEIVED, TIMEOUT, UNPUBLISHED, INTERRUPTED, INVALID, FAILED = range(6)

_POINTER, _TEXT, _SIZE = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
# Of each function what it gives, and what it is given.
_FUNCTIONS = {
    "sweepd_error": (_TEXT,),
    "sweepd_client_open": (_POINTER, _TEXT, _TEXT),
    "sweepd_client_objects": (_POINTER, _POINTER),
    "sweepd_client_next": (ctypes.c_int32, _POINTER, ctypes.c_int64, ctypes.POINTER(_POINTER)),
    "sweepd_sample_bytes": (_POINTER, _POINTER, ctypes.POINTER(_SIZE)),
    "sweepd_sample_release": (None, _POINTER),
    "sweepd_client_has_next": (ctypes.c_int32, _POINTER),
    "sweepd_client_missed": (ctypes.c_uint64, _POINTER),
    "sweepd_client_reopened": (ctypes.c_uint64, _POINTER),
    "sweepd_client_is_connected": (ctypes.c_int32, _POINTER),
    "sweepd_client_is_published": (ctypes.c_int32, _POINTER),
    "sweepd_client_attribute": (_SIZE, _POINTER, _TEXT, _TEXT, _SIZE),
    "sweepd_sensors": (_SIZE, _TEXT, _TEXT, _SIZE),
    "sweepd_client_close": (None, _POINTER),
    "sweepd_find_obstacle": (ctypes.c_int32, _POINTER, _SIZE, _POINTER, _POINTER, _POINTER),
}


@functools.cache
def library() -> ctypes.CDLL:
    """Load the library: the file that SWEEPD_LIBRARY names, else the one in the wheel, else the one of this host."""
    within = Path(__file__).with_name(NAME)
    name = os.environ.get("SWEEPD_LIBRARY") or (str(within) if within.exists() else f"{NAME}.{ABI_VERSION}")
    try:
        # Its functions run while other threads of Python do.
        loaded = ctypes.CDLL(name)
    except OSError as error:
        raise SweepdError(
            f"cannot load the library through which daemons are read ({error}): install a wheel of sweepd that is made for "
            f"this machine, or name a {NAME} in the variable SWEEPD_LIBRARY"
        ) from None
    try:
        version = loaded.sweepd_abi_version
    except AttributeError:
        raise SweepdError(f"{name} is not the library of sweepd: name a {NAME} in the variable SWEEPD_LIBRARY") from None
    version.restype = ctypes.c_uint32
    found = version()
    if found != ABI_VERSION:
        raise SweepdError(
            f"{name} has version {found} of its interface, and this package calls version {ABI_VERSION}: install both of "
            "one version of sweepd"
        )
    for function, (gives, *given) in _FUNCTIONS.items():
        if not hasattr(loaded, function):
            raise SweepdError(
                f"{name} has no {function}: it is older than this package; install both of one version of sweepd"
            )
        getattr(loaded, function).restype, getattr(loaded, function).argtypes = gives, given
    return loaded


def error() -> str:
    """Give what the library says of the last failure of this thread."""
    return (library().sweepd_error() or b"").decode(errors="replace")


def text(function: Callable[..., int], *args: Any) -> str | None:
    """Give the text that a function of the library writes as snprintf(3) does; `None` where it has none."""
    size = 0
    while True:
        written = ctypes.create_string_buffer(size + 1)
        needed = function(*args, written, size + 1)
        if needed == _SIZE(-1).value:
            return None
        if needed <= size:
            return written.value.decode(errors="replace")
        # It may be longer by the next call.
        size = needed


def encoded(root: str | os.PathLike[str] | None) -> bytes | None:
    """Give a daemon's folder as the library takes it; `None` is the default one."""
    if root is None:
        return None
    folder = os.fsencode(root)
    if b"\0" in folder:
        raise SweepdError(f"{root!r} cannot be a folder: it has a zero byte")
    return folder


def sensors(root: str | os.PathLike[str] | None = None) -> list[str]:
    """Give the names of the sensors that are published on this host. `root`: the daemon's folder, if not the default one.

    Those of a daemon that crashed stay in the list until it is started again.
    """
    names = text(library().sweepd_sensors, encoded(root))
    if names is None:
        raise SweepdError(error())
    return names.splitlines()
