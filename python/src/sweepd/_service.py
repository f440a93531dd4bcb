"""A service of a running daemon, through iceoryx2: finding it, waiting, finding it again."""

from __future__ import annotations

import ctypes
import os
import pwd
import re
import stat
import time
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import iceoryx2 as iox2
import numpy as np

from .layout import LAYOUT_VERSION, LayoutError, Preamble, SweepdError, other_version

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

T = TypeVar("T")

# Seconds: how long is slept at once before it is looked whether everything is still there, and how often it is looked for
# a service that is not there.
LOOK_EVERY_S = 0.2
SEEK_EVERY_S = 0.1
# A file that is unfinished for so long has no maker any more.
ABANDONED_AFTER_S = 1.0
# How long places of consumers that died are waited for.
FULL_FOR_S = 2.0
SHARED_MEMORY = "/dev/shm"
# What iceoryx2 needs there for a consumer, with room to spare.
OVERHEAD_BYTES = 256 * 1024
# The shortest that is slept: less than a microsecond would be for ever, since the socket is told whole ones.
LEAST_S = 0.0001
# Sweeps that a consumer may hold.
BORROWED = 2
# Folders whose files have the plain prefix.
USUAL_ROOTS = ("/run/sweepd/iox2", "/tmp/sweepd/iox2")


class Followed(Generic[T]):
    """What a service of one sensor carries, one after the other; also an endless iterator over it."""

    # The last part of the service's name.
    _topic: str

    def __init__(self, name: str, root: str | os.PathLike[str] | None = None) -> None:
        """Follow the sensor of this name. `root`: the daemon's folder, if not the default one."""
        self.name = name
        """Name of the sensor."""
        self.root = absolute(root or default_root())
        """The daemon's folder."""
        self.reopened = 0
        """How often the service was lost and looked for again."""
        self._service_name = iox2.ServiceName.new(f"sweepd/{name}/{self._topic}")
        self._open: _Open | None = None
        self._file: str | None = None
        self._looked = time.monotonic()
        self._full_since: float | None = None
        # What fails is an exception here; iceoryx2 would write it to standard error as well.
        iox2.set_log_level(iox2.LogLevel.Fatal)

    def __iter__(self) -> Iterator[T]:
        """Wait for each."""
        return self

    def __next__(self) -> T:
        """Wait for the next, as long as it takes."""
        while (received := self.next()) is None:
            pass
        return received

    def _received(self, data: NDArray[np.uint8]) -> T:
        """Give what these bytes are; views of them keep them."""
        raise NotImplementedError

    @property
    def is_connected(self) -> bool:
        """Whether the service was found; the daemon may be gone for all that."""
        return self._open is not None

    @property
    def is_published(self) -> bool:
        """Whether a daemon publishes at the moment."""
        return self._open is not None and self._open.service.dynamic_config.number_of_publishers > 0

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
        return None if self._open is None else _value(self._open.service.attributes, key)

    def next(self, timeout: float | None = None) -> T | None:
        """Wait for the next, and for the daemon if there is none, but at most `timeout` seconds; `None` then.

        Raises `SweepdError` for what waiting longer does not mend.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            if self._open is None:
                self._open = self._find()
            rest = LOOK_EVERY_S if deadline is None else max(0.0, deadline - time.monotonic())
            if self._open is not None:
                sample = self._receive(self._open)
                if sample is not None:
                    return self._received(np.asarray(_Memory(sample, self._open.subscriber)))
                if self._is_lost(self._open):
                    continue
            if rest == 0.0:
                return None
            if self._open is None:
                time.sleep(min(rest, SEEK_EVERY_S))
            else:
                self._open.wait(max(LEAST_S, min(rest, LOOK_EVERY_S)))

    def _is_lost(self, opened: _Open) -> bool:
        """Look now and then whether the service is still the one that was opened, and drop it if not."""
        if time.monotonic() - self._looked < LOOK_EVERY_S:
            return False
        self._looked = time.monotonic()
        if opened.is_current():
            return False
        # Its files are gone or another's: no event tells, and nothing would come any more.
        self._open = None
        self.reopened += 1
        return True

    def _receive(self, opened: _Open) -> Any:
        try:
            return opened.subscriber.receive()
        except iox2.ReceiveError as error:
            if "ExceedsMaxBorrows" in repr(error):
                raise SweepdError(
                    f"this program holds {BORROWED} sweeps of `{self.name}` already, and no consumer may hold more; drop "
                    "one first, with all arrays that look at it, or keep a copy: sweep.copy()"
                ) from error
            # The memory of a daemon that is going away: the next look tells.
            return None

    def _find(self) -> _Open | None:
        """Look for the service: `None` when it is not there, or not yet whole."""
        if not check_owner(self.root) or not is_shared_memory_ready(self.root):
            return None
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(self.root)
        config.global_cfg.prefix = iox2.FileName.new(prefix(self.root))
        # The daemon does that, on a thread that may wait.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        try:
            builder = iox2.NodeBuilder.new().config(config).signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            node = builder.create(iox2.ServiceType.Ipc)
            if self._file is None:
                self._file = _service_file(self.root, config, self._samples(node))
            # Read first: a service that is made anew after this has another file.
            content = _content(self._file)
            service = self._samples(node)
            self._check_version(_value(service.attributes, "schema"))
            event = node.service_builder(self._service_name).event().open()
            subscriber = service.subscriber_builder().create()
            self._full_since = None
            return _Open(node, service, event.listener_builder().create(), subscriber, self._file, content)
        except (iox2.PublishSubscribeOpenError, iox2.SubscriberCreateError, iox2.EventOpenError) as error:
            self._explain(error, config)
            return None

    def _samples(self, node: Any) -> Any:
        builder = node.service_builder(self._service_name).publish_subscribe(iox2.Slice[ctypes.c_uint8])
        return builder.user_header(Preamble).open()

    def _check_version(self, found: str | None, error: Exception | None = None) -> None:
        """Refuse another version. What a tunnel mirrors from another host names none: each sweep says it."""
        if found is not None and found != str(LAYOUT_VERSION):
            raise SweepdError(other_version(f"the sweeps of `{self.name}` have layout version {found}")) from error

    def _explain(self, error: Exception, config: Any) -> None:
        """Raise what waiting does not mend."""
        said = repr(error)
        if any(f"Incompatible{what}" in said for what in ("Types", "MessagingPattern")):
            self._check_version(self._published_version(config), error)
            raise SweepdError(
                f"`{self.name}` is published by a program that is not sweepd: stop that one, or give sweepd and its "
                "consumers a folder of their own (--root, or the variable SWEEPD_ROOT)"
            ) from error
        if "VersionMismatch" in said:
            raise SweepdError(
                f"`{self.name}` is published through another version of iceoryx2 than this program's: install the one that "
                "docs/layout.md of the sweepd on this host names"
            ) from error
        if any(word in said for word in ("ExceedsMaxNumberOfNodes", "ExceedsMaxSupportedSubscribers")):
            # Consumers that died hold their places until the daemon has cleaned up, which it does each second.
            self._full_since = self._full_since or time.monotonic()
            if time.monotonic() - self._full_since >= FULL_FOR_S:
                raise SweepdError(
                    f"`{self.name}` has as many consumers as it has room for: raise the sensor's max_consumers, or stop one"
                ) from error

    def _published_version(self, config: Any) -> str | None:
        """The version of the layout that the service names; `None` when it names none."""
        pattern = iox2.MessagingPattern.PublishSubscribe
        try:
            details = iox2.Service.details(self._service_name, config, pattern, iox2.ServiceType.Ipc)
        except iox2.ServiceDetailsError:
            details = None
        return None if details is None else _value(details.attributes(), "schema")


class _Memory:
    """The bytes of a sample. NumPy keeps this object, and so the sample, for as long as any array looks at it."""

    def __init__(self, sample: Any, subscriber: Any) -> None:
        # With the subscriber, iceoryx2 would give back what its samples still look at.
        self.sample, self.subscriber = sample, subscriber
        payload, preamble = sample.payload(), sample.user_header().contents
        version, length, there = preamble.layout_version, preamble.sweep_bytes, payload.len()
        if version != LAYOUT_VERSION:
            raise LayoutError(other_version(f"a sweep of layout version {version}"))
        if length > there:
            raise LayoutError(f"torn: it should have {length} bytes, and has {there}")
        is_read_only = True
        self.__array_interface__ = {
            "version": 3, "typestr": "|u1", "shape": (length,), "data": (payload.as_ptr(), is_read_only),
        }  # fmt: skip


class _Open:
    """A service that was found."""

    def __init__(self, node: Any, service: Any, listener: Any, subscriber: Any, file: str, content: bytes | None) -> None:
        self.node, self.service, self.listener, self.subscriber = node, service, listener, subscriber
        self.file, self.content = file, content

    def is_current(self) -> bool:
        """Whether the service that was opened is the one that others find.

        Its file names its own number, so that one that was made anew is another even under the same name.
        """
        return self.content is not None and _content(self.file) == self.content

    def wait(self, seconds: float) -> None:
        """Wait for what comes next."""
        try:
            self.listener.timed_wait(iox2.Duration.from_secs_f64(seconds))
        except iox2.ListenerWaitError:
            # A signal; Ctrl-C comes as KeyboardInterrupt.
            time.sleep(0.001)


def _value(attributes: Any, key: str) -> str | None:
    values = attributes.key_values(iox2.AttributeKey.new(key))
    return str(values[0].to_string()) if values else None


def _service_file(root: str, config: Any, service: Any) -> str:
    """The file by which a service is found."""
    of_services = config.global_cfg.service
    file = f"{prefix(root)}{service.service_hash.as_str}{of_services.static_config_storage_suffix.to_string()}"
    return os.path.join(root, of_services.directory.to_string(), file)


def _content(file: str) -> bytes | None:
    try:
        with open(file, "rb") as opened:
            return opened.read()
    except OSError:
        return None


def default_root() -> str:
    """Give the folder by which daemon and consumers find each other where none is named."""
    return os.environ.get("SWEEPD_ROOT") or USUAL_ROOTS[0 if os.path.isdir("/run/sweepd") else 1]


def absolute(root: str | os.PathLike[str]) -> str:
    """Give the path from the top; links are not followed, as the daemon does not."""
    path = os.path.join(os.getcwd(), root)
    return "/" + "/".join(part for part in path.split("/") if part not in ("", "."))


def prefix(root: str) -> str:
    """Give what the names of all files of a folder begin with, there and in /dev/shm."""
    if root in USUAL_ROOTS:
        return "sweepd_"
    fnv_1a = 0xCBF29CE484222325
    for byte in os.fsencode(root):
        fnv_1a = (fnv_1a ^ byte) * 0x100000001B3 % (1 << 64)
    return f"sweepd_{fnv_1a:016x}_"


def check_owner(root: str) -> bool:
    """Whether the folder is there; one of another user is an error, since that would silently deliver nothing."""
    own = os.geteuid()
    try:
        # A link of another user is not followed.
        owner = os.lstat(root).st_uid
        if owner == own:
            owner = os.stat(root).st_uid
    except FileNotFoundError:
        return False
    except OSError as error:
        raise SweepdError(f"cannot use {root} for shared memory: {error}") from error
    if owner != own:
        theirs = _user(owner)
        raise SweepdError(
            f"{root} belongs to user {theirs}, this program runs as {_user(own)}: sweeps are shared within one user "
            f"alone. If a daemon of {theirs} runs, run it as {theirs} (`sudo -u {theirs} ...`, or `User={theirs}` in its "
            f"systemd unit); if none does, an earlier one left the folder: have {theirs} or root remove it"
        )
    return True


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"number {uid}"


def is_shared_memory_ready(root: str) -> bool:
    """Whether iceoryx2 can be called now.

    It would wait for ever for a file that a process left empty when it died, and a page that is missing would end this
    program without a word. The daemon removes such files within a second or two.
    """
    room = os.statvfs(SHARED_MEMORY)
    free = room.f_bavail * room.f_frsize
    if free < OVERHEAD_BYTES:
        raise SweepdError(
            f"{SHARED_MEMORY} has {free} bytes free and {OVERHEAD_BYTES} are needed, {OVERHEAD_BYTES - free} more: make it "
            f"larger (`mount -o remount,size=1G {SHARED_MEMORY}`, or --shm-size for a container) or free some"
        )
    # The prefix of the usual folders is the beginning of all others.
    name_of_root = re.compile(prefix(root) + "[0-9a-f]{40}_")
    named = [entry for entry in os.scandir(SHARED_MEMORY) if name_of_root.match(entry.name)]
    return all(_is_whole(entry) for entry in named)


def _is_whole(entry: os.DirEntry[str]) -> bool:
    """Whether a file of shared memory is whole; an unfinished one that has no maker any more is removed."""
    try:
        status = entry.stat(follow_symlinks=False)
    except FileNotFoundError:
        return True
    if status.st_uid != os.geteuid():
        if entry.name.endswith(".global_mgmt"):
            raise SweepdError(
                f"{entry.path} belongs to user number {status.st_uid} and stands where a file of this user must be: "
                f"have it removed (`sudo rm {entry.path}`)"
            )
        return True
    is_unfinished = status.st_size == 0 or not status.st_mode & stat.S_IRUSR
    if is_unfinished and time.time() - status.st_ctime >= ABANDONED_AFTER_S:
        os.unlink(entry.path)
        return True
    return not is_unfinished
