"""What can still be read of mcap files whose end is missing: every whole record before the break."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Collection, Iterable, Iterator
from io import BufferedReader
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.storage_mcap import McapReader

_MAGIC = b"\x89MCAP0\r\n"
DISORDER = 2000  # messages
_DATA_END, _FOOTER = 0x0F, 0x02


class Salvaged:
    """Damaged mcap files, read in sequence as far as they are whole; the part of a bag's interface that we use."""

    def __init__(self, readers: list[McapReader], lost: str) -> None:
        self.lost = lost
        self._readers = readers
        self.connections = [c for r in readers[:1] for c in r.connections]
        counts = {
            c.topic: sum(d.msgcount for r in readers for d in r.connections if d.topic == c.topic)
            for c in self.connections
        }
        self.connections = [c._replace(msgcount=counts[c.topic]) for c in self.connections]

    @property
    def start_time(self) -> int:
        return min(r.metadata.start_time for r in self._readers)

    @property
    def end_time(self) -> int:
        return max(r.metadata.end_time for r in self._readers)

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Every message of these connections, in order."""
        by_topic = {c.topic: c for c in connections}
        for reader in self._readers:
            wanted = [c for c in reader.connections if c.topic in by_topic]
            for log_time_ns, _, connection, data in _sorted(reader.messages_scan(wanted)):
                yield by_topic[connection.topic], log_time_ns, data

    def close(self) -> None:
        for reader in self._readers:
            reader.close()


def _sorted(messages: Iterable[tuple[Connection, int, bytes]]) -> Iterator[tuple[int, int, Connection, bytes]]:
    """In order of time, where no message is written later than so many others that are younger."""
    waiting: list[tuple[int, int, Connection, bytes]] = []
    for place, (connection, log_time_ns, data) in enumerate(messages):
        heapq.heappush(waiting, (log_time_ns, place, connection, data))
        if len(waiting) > DISORDER:
            yield heapq.heappop(waiting)
    while waiting:
        yield heapq.heappop(waiting)


def salvage(files: list[Path]) -> Salvaged:
    """The readable part of these files; ReaderError if there is none."""
    if not files:
        raise ReaderError("only mcap files can be read without their end")
    readers, lost = [], 0
    for file in files:
        reader, missing = _scan(file)
        readers.append(reader)
        lost += missing
    return Salvaged(readers, f"the last {lost} bytes that are there cannot be read, what precedes them is used")


def _scan(file: Path) -> tuple[McapReader, int]:
    """A reader over the whole records of a file, and the number of bytes behind them."""
    reader = McapReader(file)
    bio = file.open("rb")
    reader.bio = bio
    if bio.read(8) != _MAGIC:
        bio.close()
        raise ReaderError(f"{file.name} is empty or not an mcap file")
    reader.data_start = bio.tell()
    reader.data_end = _end_of_whole_records(bio)
    reader.meta_scan()
    statistics = reader.statistics
    if statistics is None or not statistics.message_count:
        bio.close()
        raise ReaderError(f"{file.name} has no whole message")
    counts = statistics.channel_message_counts
    reader.connections = [c._replace(msgcount=counts.get(c.id, 0)) for c in reader.connections]
    reader.metadata = reader.metadata._replace(
        start_time=statistics.start_time, end_time=statistics.end_time + 1, message_count=statistics.message_count
    )
    return reader, file.stat().st_size - reader.data_end


def _end_of_whole_records(bio: BufferedReader) -> int:
    """Where the last complete record of the data section ends."""
    size = bio.seek(0, 2)
    bio.seek(len(_MAGIC))
    end = bio.tell()
    while len(head := bio.read(9)) == 9:
        code, length = struct.unpack("<BQ", head)
        if code in (_DATA_END, _FOOTER) or not 0 < code <= _DATA_END or end + 9 + length > size:
            break
        end = bio.seek(length, 1)
    return end
