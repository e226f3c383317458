"""Containers of recorded messages: MCAP files and the SQLite files of ROS 2 bags, read and copied.

Facts: the MCAP specification (mcap.dev/spec), and rosbag2's storage plugins and metadata.yaml (ros2/rosbag2).
"""

import io
import shutil
import sqlite3
import struct
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from errno import ENOENT
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import zstandard

from ...safe_io.limits import ByteBudget, ExpansionBudget, TooLargeError, check_file, open_file, reading_deadline
from ...safe_io.text_files import read_whole, yaml_values
from ...scene.files import whole_file
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


@runtime_checkable
class Container(Protocol):
    """One file of messages. Every method raises `CaptureError`, which names the file."""

    @property
    def path(self) -> Path: ...

    def topics(self) -> list[Topic]:
        """Topics that have messages."""
        ...

    def messages(self, topics: Collection[Topic] | None = None) -> Iterator[BagMessage]:
        """Yield the messages (of some topics) in the order of the file."""
        ...

    def read(self, place: Place) -> bytes:
        """Read the data of one message."""
        ...

    def copy(self, target: Path, changed: Callable[[BagMessage], bytes | None]) -> None:
        """Copy the container with other data in those messages for which `changed` returns some."""
        ...


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


# Messages that are compressed one by one

_ZSTD_LEVEL = 3


def _unpacked(data: bytes, path: Path, budget: ExpansionBudget) -> bytes:
    try:
        return _unzstd(data, budget)
    except zstandard.ZstdError as error:
        raise CaptureError(f"{path}: a message that can't be decompressed ({error})") from None


def _unzstd(data: bytes, budget: ExpansionBudget) -> bytes:
    """Decompress a zstd frame; raises `TooLargeError` if it holds more than the budget has left."""
    with zstandard.ZstdDecompressor().stream_reader(data) as stream:
        content = stream.read(budget.left_bytes + 1)
    budget.spend(len(content))
    return content


def _packed(data: bytes) -> bytes:
    return zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data)


# MCAP

_MAX_RECORD_BYTES = 1 << 31
_Value = TypeVar("_Value")
_CHUNK_BYTES = 1 << 20


def _mcap_module(name: str) -> Any:
    try:
        return import_module(f"mcap.{name}")
    except ImportError:
        raise CaptureError("MCAP files need the package mcap: pip install 'gsrain[recordings]'") from None


@contextmanager
def _named_damages(path: Path) -> Generator[None]:
    """Turn the errors of the mcap package into `CaptureError` with the file's name."""
    damages = (_mcap_module("exceptions").McapError, struct.error, zstandard.ZstdError)
    try:
        yield
    except FileNotFoundError:
        raise CaptureError(f"{path}: no such file") from None
    except CaptureError:
        raise
    except TooLargeError as error:
        raise CaptureError(f"{path}: its compressed parts are {error.strerror}") from None
    except (*damages, ValueError, KeyError, OSError, MemoryError, OverflowError, RuntimeError) as error:
        cut_off = type(error).__name__ == "EndOfFile" or isinstance(error, struct.error)
        why = "it is cut off; mcap recover writes one that is not" if cut_off else str(error) or type(error).__name__
        raise CaptureError(f"{path}: not an MCAP file that can be read to its end ({why})") from None


@dataclass(frozen=True)
class McapContainer:
    """MCAP file, read from its start to its end: an index is not needed."""

    path: Path
    compressed: bool = False
    """True if each message is compressed, as rosbag2 can do."""

    def topics(self) -> list[Topic]:
        return list(dict.fromkeys(message.topic for message in self.messages()))

    def messages(self, topics: Collection[Topic] | None = None) -> Iterator[BagMessage]:
        schemas: dict[int, Any] = {}
        channels: dict[int, Topic] = {}
        budget = self._budget()
        for place, record in self._records(budget):
            kind = type(record).__name__
            if kind == "Schema":
                schemas[record.id] = record
            elif kind == "Channel":
                channels[record.id] = self._topic(record, schemas)
            elif kind == "Message":
                topic = self._known(channels, record.channel_id, "channel", place)
                if topics is None or topic in topics:
                    yield BagMessage(topic, place, record.log_time, self._data(record.data, budget))

    def read(self, place: Place) -> bytes:
        with _named_damages(self.path):
            record, content = _record_at(self.path, place.offset)
            if place.byte >= 0:
                _, record = next(_inner_records(content, place.byte))
            return self._data(record.data, self._budget())

    def copy(self, target: Path, changed: Callable[[BagMessage], bytes | None]) -> None:
        """Copy schemas, channels, messages, attachments and metadata; chunks and indexes are written anew.

        Sequence numbers and both times of each message stay. Raises `CaptureError` if the file is cut off.
        """
        writers = _mcap_module("writer")
        with whole_file(target) as partial, partial.open("wb") as stream:
            writer: Any = None
            schemas: dict[int, Any] = {0: None}
            numbers = {0: 0}
            channels: dict[int, tuple[Topic, int]] = {}
            compression, budget = self._compression(), self._budget()
            for place, record in self._records(budget):
                kind = type(record).__name__
                if kind == "Header":
                    writer = writers.Writer(
                        stream, chunk_size=_CHUNK_BYTES, compression=writers.CompressionType[compression]
                    )
                    writer.start(profile=record.profile, library=record.library)
                elif writer is None:
                    raise CaptureError(f"{self.path}: has no header")
                elif kind == "Schema" and record.id not in numbers:
                    schemas[record.id] = record
                    numbers[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                elif kind == "Channel" and record.id not in channels:
                    schema = self._known(numbers, record.schema_id, "schema", place)
                    number = writer.register_channel(record.topic, record.message_encoding, schema, record.metadata)
                    channels[record.id] = self._topic(record, schemas), number
                elif kind == "Message":
                    topic, number = self._known(channels, record.channel_id, "channel", place)
                    message = BagMessage(topic, place, record.log_time, self._data(record.data, budget))
                    new = changed(message)
                    data = record.data if new is None else (_packed(new) if self.compressed else new)
                    writer.add_message(number, record.log_time, data, record.publish_time, record.sequence)
                elif kind == "Attachment":
                    writer.add_attachment(
                        record.create_time, record.log_time, record.name, record.media_type, record.data
                    )
                elif kind == "Metadata":
                    writer.add_metadata(record.name, record.metadata)
                elif kind == "DataEnd":
                    break  # a summary repeats schemas and channels
            writer.finish()

    def _data(self, data: bytes, budget: ExpansionBudget) -> bytes:
        with _named_damages(self.path):
            return _unpacked(data, self.path, budget) if self.compressed else data

    def _budget(self) -> ExpansionBudget:
        return ExpansionBudget(_size(self.path), self.path)

    def _known(self, known: Mapping[int, _Value], number: int, what: str, place: Place) -> _Value:
        if number not in known:
            raise CaptureError(f"{self.path}: a record at byte {place.offset} is of {what} {number}, which is missing")
        return known[number]

    def _topic(self, channel: Any, schemas: dict[int, Any]) -> Topic:
        schema = schemas.get(channel.schema_id)
        kind, definition = ("", b"") if schema is None else (schema.name, schema.data)
        return Topic(channel.topic, kind, channel.message_encoding, bytes(definition))

    def _records(self, budget: ExpansionBudget) -> Iterator[tuple[Place, Any]]:
        """Yield all records, those of chunks too, with their places."""
        with _named_damages(self.path), open_file(self.path) as stream:
            for offset, record in _outer_records(stream, self.path):
                if type(record).__name__ == "Chunk":
                    for byte, inner in _inner_records(_chunk_content(record, self.path, budget)):
                        yield Place(offset, byte), inner
                else:
                    yield Place(offset), record

    def _compression(self) -> str:
        """Compression of the first chunk, as the writer names it."""
        with _named_damages(self.path), open_file(self.path) as stream:
            for _, record in _outer_records(stream, self.path):
                if type(record).__name__ == "Chunk":
                    return {"": "NONE", "lz4": "LZ4"}.get(record.compression, "ZSTD")
        return "NONE"


_MAGIC_BYTES = 8
_IN_CHUNKS = ("Schema", "Channel", "Message")


def _outer_records(stream: Any, path: Path, *, from_start: bool = True) -> Iterator[tuple[int, Any]]:
    """Yield the records of a file outside of chunks, with the byte at which each starts."""
    return _records_of(stream, min(_size(path), _MAX_RECORD_BYTES), has_magic=from_start)


def _inner_records(content: bytes, start: int = 0) -> Iterator[tuple[int, Any]]:
    """Yield the records of an expanded chunk one by one, with the byte at which each starts."""
    stream = io.BytesIO(content)
    stream.seek(start)
    for byte, record in _records_of(stream, len(content), has_magic=False) if content else ():
        if type(record).__name__ in _IN_CHUNKS:
            yield byte, record
        if stream.tell() == len(content):
            return


def _records_of(stream: Any, max_bytes: int, *, has_magic: bool) -> Iterator[tuple[int, Any]]:
    reader = _mcap_module("stream_reader").StreamReader(
        stream, skip_magic=not has_magic, emit_chunks=True, record_size_limit=max_bytes
    )
    start = stream.tell() + (_MAGIC_BYTES if has_magic else 0)
    for record in reader.records:
        yield start, record
        start = stream.tell()


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise CaptureError(f"{path}: {'no such file' if error.errno == ENOENT else error.strerror}") from None


def _chunk_content(chunk: Any, path: Path, budget: ExpansionBudget) -> bytes:
    """Expand a chunk; raises `TooLargeError` if it holds more than the budget has left."""
    size, content = chunk.uncompressed_size, chunk.data
    if chunk.compression == "zstd":
        content = _unzstd(content, budget)
    elif chunk.compression == "lz4":
        content = import_module("lz4.frame").LZ4FrameDecompressor().decompress(content, budget.left_bytes + 1)
        budget.spend(len(content))
    elif chunk.compression:
        raise CaptureError(f"{path}: a chunk has the compression {chunk.compression!r}; expected zstd or lz4")
    if len(content) != size:
        raise CaptureError(f"{path}: a chunk says that it holds {size} bytes, and has another number of them")
    return content


@lru_cache(maxsize=2)
def _record_at(path: Path, offset: int) -> tuple[Any, bytes]:
    """Return the record at a byte, and its content if it is a chunk; neighbors are usually read next."""
    with open_file(path) as stream:
        stream.seek(offset)
        _, record = next(_outer_records(stream, path, from_start=False))
    is_chunk = type(record).__name__ == "Chunk"
    return record, _chunk_content(record, path, ExpansionBudget(_size(path), path)) if is_chunk else b""


# SQLite, the storage of ROS 2 bags before Iron


@dataclass(frozen=True)
class SqliteContainer:
    """SQLite file of a ROS 2 bag."""

    path: Path
    compressed: bool = False
    """True if each message is compressed."""

    def topics(self) -> list[Topic]:
        with self._opened() as query:
            used = {row[0] for row in query("SELECT DISTINCT topic_id FROM messages")}
            return [topic for number, topic in _sqlite_topics(query).items() if number in used]

    def messages(self, topics: Collection[Topic] | None = None) -> Iterator[BagMessage]:
        budget = self._budget()
        with self._opened() as query:
            known = _sqlite_topics(query)
            asked = [number for number, topic in known.items() if topics is None or topic in topics]
            marks = ",".join("?" * len(asked))
            rows = query(
                f"SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "
                "ORDER BY timestamp, id",
                asked,
            )
            for number, topic, time_ns, data in rows:
                yield BagMessage(known[topic], Place(int(number)), int(time_ns), self._data(data, budget))

    def read(self, place: Place) -> bytes:
        with self._opened() as query:
            row = next(query("SELECT data FROM messages WHERE id = ?", [place.offset]), None)
        if row is None:
            raise CaptureError(f"{self.path}: message {place.offset} is gone")
        return self._data(row[0], self._budget())

    def copy(self, target: Path, changed: Callable[[BagMessage], bytes | None]) -> None:
        """Copy the file and put new data into the rows of changed messages."""
        with whole_file(target) as partial:
            shutil.copyfile(self.path, partial)
            with self._named_damages(), closing(sqlite3.connect(partial)) as database, database:
                query = Query(database, _size(partial))
                list(query("PRAGMA journal_mode = MEMORY"))
                for message in self.messages():
                    new = changed(message)
                    if new is not None:
                        data = _packed(new) if self.compressed else new
                        list(query("UPDATE messages SET data = ? WHERE id = ?", [data, message.place.offset]))

    def _data(self, data: Any, budget: ExpansionBudget) -> bytes:
        if not isinstance(data, bytes):
            raise CaptureError(f"{self.path}: a message that is no bytes")
        with self._named_damages():
            return _unpacked(data, self.path, budget) if self.compressed else data

    def _budget(self) -> ExpansionBudget:
        return ExpansionBudget(_size(self.path), self.path)

    @contextmanager
    def _opened(self) -> "Generator[Query]":
        with self._named_damages():
            check_file(self.path)
            with closing(sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _size(self.path))  # a value is stored in the file
                query = Query(database, _size(self.path))
                stored = {str(row[0]).lower() for row in query(_STORED_TABLES)}
                for name in {"messages", "topics"} - stored:
                    raise CaptureError(f"{self.path}: not the database of a ROS 2 bag: it has no table {name!r}")
                yield query

    @contextmanager
    def _named_damages(self) -> Generator[None]:
        try:
            yield
        except FileNotFoundError:
            raise CaptureError(f"{self.path}: no such file") from None
        except TooLargeError as error:
            raise CaptureError(f"{self.path}: its messages are {error.strerror}") from None
        except (sqlite3.Error, KeyError, TypeError, OverflowError, TimeoutError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, TimeoutError) else str(error)
            raise CaptureError(f"{self.path}: not the database of a ROS 2 bag that can be read ({why})") from None


_STORED_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"  # no views, nothing virtual
_STEPS_BETWEEN_CHECKS = 20_000  # of SQLite's machine: some 0.2 ms
_MIN_ROW_BYTES = 4  # a row takes more in a file


class Query:
    """Queries of a database from a stranger, in which pages may repeat without end and values may be made up."""

    def __init__(self, database: sqlite3.Connection, stored_bytes: int) -> None:
        self._database, self._stored_bytes = database, stored_bytes
        database.execute("PRAGMA trusted_schema = OFF")

    def __call__(self, statement: str, values: Sequence[Any] = ()) -> Iterator[Any]:
        """Yield the rows, no more bytes of them than the file has.

        Raises sqlite3.Error, `TooLargeError`, and TimeoutError if the next row takes too long.
        """
        budget = ByteBudget(self._stored_bytes, "query")
        rows: Iterator[Any] | None = None
        while True:
            deadline = reading_deadline(self._stored_bytes)
            self._database.set_progress_handler(lambda end=deadline: end.left_s == 0, _STEPS_BETWEEN_CHECKS)
            try:
                rows = self._database.execute(statement, values) if rows is None else rows
                row = next(rows, None)
            except sqlite3.OperationalError as error:
                # Errors of Python's module have no code.
                if getattr(error, "sqlite_errorcode", None) != sqlite3.SQLITE_INTERRUPT:
                    raise
                deadline.check()
                raise KeyboardInterrupt from None  # the module drops what its handler raises
            if row is None:
                return
            budget.spend(_MIN_ROW_BYTES + sum(len(value) for value in row if isinstance(value, bytes | str)))
            yield row


def _sqlite_topics(query: Query) -> dict[int, Topic]:
    rows = query("SELECT id, name, type, serialization_format FROM topics")
    return {int(number): Topic(str(name), str(kind), str(form)) for number, name, kind, form in rows}
