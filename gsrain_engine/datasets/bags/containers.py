"""Containers of recorded messages: MCAP files and the SQLite files of ROS 2 bags, read and copied.

The packages mcap and sqlite3 read them message by message, without an index, so that a recording that was cut off gives
what comes before. Facts: rosbag2's storage plugins and metadata.yaml (ros2/rosbag2).
"""

import io
import shutil
import sqlite3
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import zstandard

from ...optional_packages import MissingPackageError, import_package
from ...safe_io.files import whole_file
from ...safe_io.limits import ByteBudget, ExpansionBudget, TooLargeError, check_file, open_file
from ...safe_io.text_files import read_whole, yaml_values
from ...threads import results_in_order
from ..capture import CaptureError, check_inside

MCAP, SQLITE = ".mcap", ".db3"
"""Suffixes of containers."""

_ABOUT, _HEAD_BYTES = "rosbag2_bagfile_information", 1 << 12

METADATA = "metadata.yaml"
"""List of the containers of a ROS 2 bag, which is a folder."""


@dataclass(frozen=True, slots=True)
class Topic:
    """Named stream of messages of one type."""

    name: str
    type: str
    """Such as sensor_msgs/msg/Image, foxglove.CompressedImage."""
    encoding: str
    """Of the messages: cdr, json, protobuf."""
    definition: bytes = b""
    """Schema as stored in an MCAP file; of protobuf a FileDescriptorSet."""


class Place(NamedTuple):
    """Position of a message in its container."""

    offset: int
    """Byte of the record (MCAP), or number of the row (SQLite)."""
    byte: int = -1
    """Byte of the record in the expanded chunk at `offset` (MCAP); -1 for a record outside of chunks."""


class BagMessage(NamedTuple):
    """One recorded message, not decoded."""

    topic: Topic
    place: Place
    time_ns: int
    """Time of its recording."""
    data: bytes


Change = Callable[[BagMessage], Callable[[], bytes | None] | None]
"""Returns what makes other data for a message, in any thread, or None as what it makes; None for one that stays."""


@dataclass(frozen=True)
class Container(ABC):
    """One file of messages. Every method raises `CaptureError`, which names the file."""

    path: Path
    compressed: bool = False
    """True if each message is compressed (zstd), as rosbag2 can do."""

    kind: ClassVar[str]
    """Name of the format in errors."""

    @abstractmethod
    def messages(self) -> Iterator[BagMessage]:
        """Yield the messages in the order of the file."""

    @abstractmethod
    def read(self, place: Place) -> bytes:
        """Read the data of one message."""

    @abstractmethod
    def copy(self, target: Path, changed: Change, threads: int = 1) -> Iterator[None]:
        """Copy the container with other data in those messages for which `changed` makes some, in several threads.

        Yields after each of them.
        """

    def _size(self) -> int:
        return self.path.stat().st_size

    def _budget(self) -> ExpansionBudget:
        return ExpansionBudget(self._size(), self.path)

    def _unpacked(self, data: bytes, budget: ExpansionBudget) -> bytes:
        return _expanded(data, "zstd", budget) if self.compressed else data

    def _packed(self, data: bytes) -> bytes:
        return zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data) if self.compressed else data

    @contextmanager
    def _named_damages(self) -> Generator[None]:
        try:
            yield
        except CaptureError:
            raise
        except FileNotFoundError:
            raise CaptureError(f"{self.path}: no such file") from None
        except TooLargeError as error:
            raise CaptureError(f"{self.path}: its content is {error.strerror}") from None
        except Exception as error:  # of mcap, zstandard, lz4 and sqlite3, which raise many kinds
            cut_off = type(error).__name__ == "EndOfFile" or isinstance(error, struct.error)
            why = "it is cut off; mcap recover writes one that is not" if cut_off else str(error)
            raise CaptureError(f"{self.path}: not {self.kind} ({why or type(error).__name__})") from None


_ZSTD_LEVEL = 3


def _expanded(data: bytes, compression: str, budget: ExpansionBudget) -> bytes:
    """Decompress a message or a chunk; raises `TooLargeError` if it is a bomb or more than the budget has left."""
    own = ExpansionBudget(len(data), "part")
    max_bytes = min(own.max_bytes, budget.left_bytes) + 1  # allocated at once
    if compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            data = stream.read(max_bytes)
    elif compression == "lz4":
        data = import_module("lz4.frame").LZ4FrameDecompressor().decompress(data, max_bytes)
    elif compression:
        raise ValueError(f"a chunk has the compression {compression!r}; expected zstd or lz4")
    own.spend(len(data))
    budget.spend(len(data))
    return data


def recognizes_bag(path: Path) -> bool:
    """Return whether a path is an MCAP file, an SQLite file of a bag, or the folder of a ROS 2 bag."""
    if path.is_file():
        return path.suffix in (MCAP, SQLITE)
    file = path / METADATA
    if not file.is_file():
        return False
    with open_file(file) as stream:
        return _ABOUT.encode() in stream.read(_HEAD_BYTES)


def open_bag(path: Path) -> list[Container]:
    """Open the containers of a bag in their order. Raises `CaptureError`."""
    if path.is_file():
        return [_container(path, compressed=False)]
    file = path / METADATA
    try:
        values = yaml_values(read_whole(file))
        about: Any = values[_ABOUT]
        names = [str(name) for name in about["relative_file_paths"]]
        form, mode = str(about.get("compression_format") or ""), str(about.get("compression_mode") or "").upper()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CaptureError(f"{file}: not the list of a ROS 2 bag's files ({error})") from None
    check_inside(path, names, file)
    if mode == "FILE" or (mode == "MESSAGE" and form != "zstd"):
        raise CaptureError(f"{file}: a bag with compressed files ({form}); ros2 bag convert writes it without")
    if not names:
        raise CaptureError(f"{file}: lists no file of messages")
    return [_container(path / name, compressed=mode == "MESSAGE") for name in names]


def _container(path: Path, *, compressed: bool) -> Container:
    if path.suffix == MCAP:
        return McapContainer(path, compressed)
    if path.suffix == SQLITE:
        return SqliteContainer(path, compressed)
    raise CaptureError(f"{path}: not a container of messages; expected {MCAP} or {SQLITE}")


# MCAP

_MAX_RECORD_BYTES = 1 << 31
_CHUNK_BYTES = 1 << 20
_MAGIC_BYTES = 8
_IN_CHUNKS = ("Schema", "Channel", "Message")


def _mcap_module(name: str) -> Any:
    try:
        return import_package(f"mcap.{name}", "an MCAP file")
    except MissingPackageError as error:
        raise CaptureError(str(error)) from None


class McapContainer(Container):
    """MCAP file, read from its start to its end: an index is not needed."""

    kind = "an MCAP file that can be read to its end"

    def messages(self) -> Iterator[BagMessage]:
        return (message for _, message in self._records() if message is not None)

    def read(self, place: Place) -> bytes:
        with self._named_damages():
            record, content = _record_at(self.path, place.offset)
            if place.byte >= 0:
                stream = io.BytesIO(content)
                stream.seek(place.byte)
                _, record = next(_parsed(stream, len(content), has_magic=False))
            return self._unpacked(record.data, self._budget())

    def copy(self, target: Path, changed: Change, threads: int = 1) -> Iterator[None]:
        """Copy schemas, channels, messages, attachments and metadata; chunks and indexes are written anew.

        Sequence numbers and both times of each message stay. Raises `CaptureError` if the file is cut off.
        """
        chunks = (record.compression for record, _ in self._records() if _kind(record) == "Chunk")
        writers = _mcap_module("writer")
        compression = writers.CompressionType[(next(chunks, "") or "none").upper()]
        with whole_file(target) as partial, partial.open("wb") as stream:
            writer = writers.Writer(stream, chunk_size=_CHUNK_BYTES, compression=compression)
            schemas, channels = {0: 0}, dict[int, int]()
            calls = ((each, None if each[1] is None else changed(each[1])) for each in self._records())
            for (record, message), new in results_in_order(calls, threads):
                kind = _kind(record)
                if kind == "Header":
                    writer.start(profile=record.profile, library=record.library)
                elif kind == "Schema" and record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                elif kind == "Channel" and record.id not in channels:
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                    )
                elif message is not None:
                    data = record.data if new is None else self._packed(new)
                    number = channels[record.channel_id]
                    writer.add_message(number, record.log_time, data, record.publish_time, record.sequence)
                    if new is not None:
                        yield
                elif kind == "Attachment":
                    writer.add_attachment(
                        record.create_time, record.log_time, record.name, record.media_type, record.data
                    )
                elif kind == "Metadata":
                    writer.add_metadata(record.name, record.metadata)
                elif kind == "DataEnd":
                    break  # a summary repeats schemas and channels
            writer.finish()

    def _records(self) -> Iterator[tuple[Any, BagMessage | None]]:
        """Yield all records, those of a chunk after the chunk; with each message itself, unpacked."""
        schemas: dict[int, tuple[str, bytes]] = {0: ("", b"")}
        topics: dict[int, Topic] = {}
        with self._named_damages():
            budget = self._budget()
            for place, record in self._placed_records(budget):
                kind, message = _kind(record), None
                if kind == "Schema":
                    schemas[record.id] = record.name, bytes(record.data)
                elif kind == "Channel":
                    if record.schema_id not in schemas:
                        raise ValueError(f"a channel at byte {place.offset} has no schema {record.schema_id}")
                    name, definition = schemas[record.schema_id]
                    topics[record.id] = Topic(record.topic, name, record.message_encoding, definition)
                elif kind == "Message":
                    if record.channel_id not in topics:
                        raise ValueError(f"a message at byte {place.offset} has no channel {record.channel_id}")
                    data = self._unpacked(record.data, budget)
                    message = BagMessage(topics[record.channel_id], place, record.log_time, data)
                yield record, message

    def _placed_records(self, budget: ExpansionBudget) -> Iterator[tuple[Place, Any]]:
        with open_file(self.path) as stream:
            for offset, record in _parsed(stream, self._size()):
                if (_kind(record) == "Header") != (offset == _MAGIC_BYTES):
                    raise ValueError("it must begin with its header")
                yield Place(offset), record
                if _kind(record) == "Chunk":
                    content = _chunk_content(record, budget)
                    for byte, inner in _parsed(io.BytesIO(content), len(content), has_magic=False):
                        if _kind(inner) in _IN_CHUNKS:
                            yield Place(offset, byte), inner


def _kind(record: Any) -> str:
    return type(record).__name__


def _parsed(stream: io.BufferedIOBase, size: int, *, has_magic: bool = True) -> Iterator[tuple[int, Any]]:
    """Yield the records of a file, or of the content of a chunk, one by one, with the byte at which each starts."""
    reader = _mcap_module("stream_reader").StreamReader(
        stream, skip_magic=not has_magic, emit_chunks=True, record_size_limit=min(size, _MAX_RECORD_BYTES)
    )
    records, start = reader.records, _MAGIC_BYTES if has_magic else stream.tell()
    while has_magic or start < size:  # a chunk has no record that ends it
        record = next(records, None)
        if record is None:
            return
        yield start, record
        start = stream.tell()


def _chunk_content(chunk: Any, budget: ExpansionBudget) -> bytes:
    content = _expanded(chunk.data, chunk.compression, budget)
    if len(content) != chunk.uncompressed_size:
        raise ValueError(f"a chunk says that it holds {chunk.uncompressed_size} bytes, and has another number of them")
    return content


@lru_cache(maxsize=2)
def _record_at(path: Path, offset: int) -> tuple[Any, bytes]:
    """Return the record at a byte, and its content if it is a chunk; neighbors are usually read next."""
    size = path.stat().st_size
    with open_file(path) as stream:
        stream.seek(offset)
        _, record = next(_parsed(stream, size, has_magic=False))
    return record, _chunk_content(record, ExpansionBudget(size, path)) if _kind(record) == "Chunk" else b""


# SQLite, the storage of ROS 2 bags before Iron

_STORED_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"  # no views, nothing virtual
_MIN_STEPS, _STEPS_PER_BYTE = 10_000_000, 8  # of SQLite's machine, which takes some 12 for a row
_STEPS_BETWEEN_CHECKS = 10_000


class SqliteContainer(Container):
    """SQLite file of a ROS 2 bag."""

    kind = "the database of a ROS 2 bag that can be read"

    def messages(self) -> Iterator[BagMessage]:
        with self._opened() as database:
            budget, delivered = self._budget(), ByteBudget(self._size(), self.path)
            topics = {
                number: Topic(str(name), str(kind), str(form))
                for number, name, kind, form in database.execute(
                    "SELECT id, name, type, serialization_format FROM topics"
                )
            }
            for number, topic, time_ns, data in database.execute("SELECT id, topic_id, timestamp, data FROM messages"):
                delivered.spend(len(data))  # a damaged file may repeat its pages
                if topic in topics:
                    yield BagMessage(topics[topic], Place(int(number)), int(time_ns), self._bytes(data, budget))

    def read(self, place: Place) -> bytes:
        with self._opened() as database:
            row = database.execute("SELECT data FROM messages WHERE id = ?", [place.offset]).fetchone()
            if row is None:
                raise ValueError(f"message {place.offset} is gone")
            return self._bytes(row[0], self._budget())

    def copy(self, target: Path, changed: Change, threads: int = 1) -> Iterator[None]:
        """Copy the file and put new data into the rows of changed messages."""
        with whole_file(target) as partial:
            shutil.copyfile(self.path, partial)
            with closing(sqlite3.connect(partial)) as database, database:
                with self._named_damages():
                    limit_steps(database, self._size())
                    database.execute("PRAGMA journal_mode = MEMORY")
                calls = ((message, changed(message)) for message in self.messages())
                for message, new in results_in_order(calls, threads):
                    if new is not None:
                        with self._named_damages():
                            row = self._packed(new), message.place.offset
                            database.execute("UPDATE messages SET data = ? WHERE id = ?", row)
                        yield

    def _bytes(self, data: Any, budget: ExpansionBudget) -> bytes:
        if not isinstance(data, bytes):
            raise TypeError("a message that is no bytes")
        return self._unpacked(data, budget)

    @contextmanager
    def _opened(self) -> Generator[sqlite3.Connection]:
        with self._named_damages():
            check_file(self.path)
            size = self._size()
            with closing(sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, size)  # a value is stored in the file
                limit_steps(database, size)
                stored = {str(row[0]).lower() for row in database.execute(_STORED_TABLES)}
                for name in {"messages", "topics"} - stored:
                    raise CaptureError(f"{self.path}: not the database of a ROS 2 bag: it has no table {name!r}")
                yield database


def limit_steps(database: sqlite3.Connection, stored_bytes: int) -> None:
    """Let queries of a database from a stranger end, in which pages may repeat without end and triggers may loop."""
    database.execute("PRAGMA trusted_schema = OFF")
    steps = iter(range((_MIN_STEPS + _STEPS_PER_BYTE * stored_bytes) // _STEPS_BETWEEN_CHECKS))
    database.set_progress_handler(lambda: next(steps, None) is None, _STEPS_BETWEEN_CHECKS)
