"""Logs: rosbag2 directories and files, read and written as records, without ROS.

Topics go by their names in the graph; a vehicle's namespace in front of them in the bag is a parameter.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, ReaderError, StoragePlugin, WriterError

from fbn_common.graph import GRAPH, SIMULATOR_TOPICS, Topic
from fbn_common.records import Record
from fbn_ros.cdr import Cdr
from fbn_ros.conversion import ConversionError
from fbn_ros.definitions import typestore
from fbn_ros.mcap import QuickWriter
from fbn_ros.qos import bag_qos
from fbn_ros.salvage import Salvaged, salvage

KNOWN_TOPICS: Mapping[str, Topic] = GRAPH.topics | {t.name: t for t in SIMULATOR_TOPICS}


class BagError(Exception):
    """A log that cannot be read or written; the text says why and what to do."""


class Logged(NamedTuple):
    """One message of a log."""

    log_time_ns: int
    topic: str
    record: Record | ConversionError  # the error says why there is no record


@dataclass(frozen=True, slots=True)
class BagTopic:
    """What a bag says of one of its topics."""

    ros_type: str
    count: int


class BagReader:
    """A log, opened; use it in a ``with`` statement.

    ``topics`` are all it has, by name without namespace.  Of a truncated bag the good part is read, and
    ``truncated`` says what is lost.  ``refused`` counts, by topic, the messages that :meth:`records` left out.
    """

    def __init__(self, path: Path, namespace: str = "", known: Mapping[str, Topic] = KNOWN_TOPICS) -> None:
        self.path, self.known = path, known
        self.refused: Counter[str] = Counter()
        self.truncated = ""
        self._prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
        self._cdr = Cdr()
        self._bag = self._open()
        self._connections = {c.id: c for c in self._bag.connections}
        self.topics = self._topics()
        if not sum(t.count for t in self.topics.values()):
            raise BagError(f"{path}: the bag is empty" + self._namespace_hint(namespace))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bag.close()

    @property
    def start_ns(self) -> int:
        """Log time of the first message."""
        return self._bag.start_time

    @property
    def end_ns(self) -> int:
        """Log time of the last message."""
        return self._bag.end_time - 1

    def raw(self, topics: Collection[str] | None = None) -> Iterator[tuple[int, str, bytes]]:
        """Log time, topic and bytes of every message, in order of time; of these topics, or all."""
        wanted = self._wanted(topics)
        names = {c.id: self._name(c) for c in wanted}
        if wanted:
            for connection, log_time_ns, data in self._bag.messages(wanted):
                yield log_time_ns, names[connection.id], data

    def entries(self, topics: Collection[str] | None = None) -> Iterator[Logged]:
        """Every message of these topics (default: all that are known) as a record, or as the reason why not.

        Raises BagError if one of the topics has another type or definition than ours.
        """
        wanted = [t for t in (self.known if topics is None else topics) if t in self.topics]
        for topic in wanted:
            self.check_type(topic)
        for log_time_ns, topic, data in self.raw(wanted):
            yield Logged(log_time_ns, topic, self.decode(topic, data))

    def records(self, topics: Collection[str] | None = None) -> Iterator[tuple[int, str, Record]]:
        """Log time, topic, record; what is malformed is left out and counted in ``refused``."""
        for log_time_ns, topic, record in self.entries(topics):
            if isinstance(record, ConversionError):
                self.refused[topic] += 1
            else:
                yield log_time_ns, topic, record

    def decode(self, topic: str, data: bytes) -> Record | ConversionError:
        """The record in a message's bytes, or why there is none."""
        try:
            return self._cdr.decode(topic, self.known[topic].record, data)
        except ConversionError as error:
            return error

    def connection(self, topic: str) -> Connection:
        """rosbags' own account of a topic: type, definition, quality of service."""
        return next(c for c in self._connections.values() if self._name(c) == topic)

    def all_connections(self) -> list[Connection]:
        """Everything in the bag, with full names, also outside the namespace."""
        return list(self._connections.values())

    def check_type(self, topic: str) -> None:
        """Raise BagError unless the topic's type is the one that the graph declares."""
        connection, expected = self.connection(topic), self.known[topic].ros_type
        if connection.msgtype != expected:
            raise BagError(
                f"{self.path}: topic {topic} is {connection.msgtype}, expected {expected}; convert or rename it"
            )
        ours = typestore().hash_rihs01(expected)
        if connection.digest and connection.digest != ours and expected.startswith("fbn_msgs/"):
            raise BagError(
                f"{self.path}: topic {topic}: {expected} was defined otherwise when this was recorded; "
                "replay the log's sensor topics instead"
            )

    def _open(self) -> Reader | Salvaged:
        if not self.path.exists():
            raise BagError(f"{self.path}: no such bag")
        if self.path.is_dir() and not any(f for p in ("metadata.yaml", "*.mcap", "*.db3") for f in self.path.glob(p)):
            raise BagError(f"{self.path}: holds no bag (metadata.yaml and a .mcap or .db3 file)")
        reader = None
        try:
            reader = Reader(self.path)
            reader.open()
        except (ReaderError, OSError, EOFError, AssertionError, TypeError, ValueError) as error:
            return self._salvage(error)
        return reader

    def _salvage(self, cause: Exception) -> Salvaged:
        files = sorted(self.path.glob("*.mcap")) if self.path.is_dir() else [self.path]
        try:
            bag = salvage([f for f in files if f.suffix == ".mcap"])
        except (ReaderError, OSError, ValueError) as error:
            raise BagError(f"{self.path}: not a readable bag: {error}") from error
        self.truncated = f"{self.path} is damaged ({cause}); {bag.lost}"
        return bag

    def _topics(self) -> dict[str, BagTopic]:
        mine = [c for c in self._connections.values() if c.topic.startswith(self._prefix)]
        return {self._name(c): BagTopic(c.msgtype, c.msgcount) for c in mine}

    def _name(self, connection: Connection) -> str:
        return connection.topic.removeprefix(self._prefix)

    def _wanted(self, topics: Collection[str] | None) -> list[Connection]:
        mine = [c for c in self._connections.values() if c.topic.startswith(self._prefix)]
        return [c for c in mine if topics is None or self._name(c) in topics]

    def _namespace_hint(self, namespace: str) -> str:
        """What to do if the bag's topics are all somewhere else."""
        names = [c.topic for c in self._connections.values() if c.msgcount]
        if not names:
            return ""
        return f" under namespace {namespace or '/'!r}; it has {', '.join(sorted(names)[:5])} ..."


class BagWriter:
    """A new log (rosbag2 directory, mcap, compressed); use it in a ``with`` statement."""

    def __init__(self, path: Path, known: Mapping[str, Topic] = KNOWN_TOPICS) -> None:
        self.path, self.known = path, known
        self.counts: Counter[str] = Counter()
        self._cdr = Cdr()
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = QuickWriter(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise BagError(f"{path}: cannot write a bag here: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Also after an error the bag is finished: what was written is good."""
        self._writer.close()

    def write(self, log_time_ns: int, topic: str, record: Record) -> None:
        """Append a record."""
        self.write_raw(log_time_ns, topic, record.ros_type, self._cdr.encode(record))

    def write_raw(self, log_time_ns: int, topic: str, ros_type: str, data: bytes) -> None:
        """Append a message's bytes."""
        if topic not in self._connections:
            self._connections[topic] = self._connect(topic, ros_type)
        self._append(log_time_ns, topic, data)

    def copy(self, log_time_ns: int, topic: str, data: bytes, source: BagReader) -> None:
        """Append a message of another bag as it is, whatever its type."""
        if topic not in self._connections:
            origin = source.connection(topic)
            if origin.msgtype in typestore().types:
                self._connections[topic] = self._connect(topic, origin.msgtype)
            else:
                digest = origin.digest or "RIHS01_" + 64 * "0"
                self._connections[topic] = self._writer.add_connection(
                    _absolute(topic), origin.msgtype, msgdef=origin.msgdef.data, rihs01=digest
                )
        self._append(log_time_ns, topic, data)

    def _append(self, log_time_ns: int, topic: str, data: bytes) -> None:
        self._writer.write(self._connections[topic], log_time_ns, data)
        self.counts[topic] += 1

    def _connect(self, topic: str, ros_type: str) -> Connection:
        qos = [bag_qos(self.known[topic])] if topic in self.known else []
        return self._writer.add_connection(_absolute(topic), ros_type, typestore=typestore(), offered_qos_profiles=qos)


def _absolute(topic: str) -> str:
    return f"/{topic.lstrip('/')}"
