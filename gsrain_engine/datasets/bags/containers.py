"""Containers of recorded messages: MCAP files and the SQLite files of ROS 2 bags, read and copied.

Facts: the MCAP specification (mcap.dev/spec), and rosbag2's storage plugins and metadata.yaml (ros2/rosbag2).
"""

import shutil
import sqlite3
import struct
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import zstandard

from ...safe_io.limits import check_file, open_file
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
    number: int = 0
    """Number among the records of a chunk (MCAP)."""


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

_MAX_MESSAGE_BYTES = 1 << 30
_ZSTD_LEVEL = 3


def _unpacked(data: bytes, path: Path) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return stream.read(_MAX_MESSAGE_BYTES)
    except zstandard.ZstdError as error:
        raise CaptureError(f"{path}: a message that can't be decompressed ({error})") from None


def _packed(data: bytes) -> bytes:
    return zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data)


# MCAP

_MAX_CHUNK_BYTES = 1 << 31
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
    except (*damages, ValueError, KeyError, OSError, MemoryError, RuntimeError) as error:
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
        for place, record in self._records():
            kind = type(record).__name__
            if kind == "Schema":
                schemas[record.id] = record
            elif kind == "Channel":
                channels[record.id] = self._topic(record, schemas)
            elif kind == "Message":
                topic = self._known(channels, record.channel_id, "channel", place)
                if topics is None or topic in topics:
                    yield BagMessage(topic, place, record.log_time, self._data(record.data))

    def read(self, place: Place) -> bytes:
        with _named_damages(self.path):
            records = _records_at(self.path, place.offset)
            return self._data(records[place.number].data)

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
            compression = self._compression()
            for place, record in self._records():
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
                    message = BagMessage(topic, place, record.log_time, self._data(record.data))
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

    def _data(self, data: bytes) -> bytes:
        return _unpacked(data, self.path) if self.compressed else data

    def _known(self, known: Mapping[int, _Value], number: int, what: str, place: Place) -> _Value:
        if number not in known:
            raise CaptureError(f"{self.path}: a record at byte {place.offset} is of {what} {number}, which is missing")
        return known[number]

    def _topic(self, channel: Any, schemas: dict[int, Any]) -> Topic:
        schema = schemas.get(channel.schema_id)
        kind, definition = ("", b"") if schema is None else (schema.name, schema.data)
        return Topic(channel.topic, kind, channel.message_encoding, bytes(definition))

    def _records(self) -> Iterator[tuple[Place, Any]]:
        """Yield all records, those of chunks too, with their places."""
        with _named_damages(self.path), open_file(self.path) as stream:
            for offset, record in _outer_records(stream, self.path):
                if type(record).__name__ == "Chunk":
                    for index, inner in enumerate(_records_of_chunk(record, self.path)):
                        yield Place(offset, index), inner
                else:
                    yield Place(offset), record

    def _compression(self) -> str:
        """Compression of the first chunk, as the writer names it."""
        with _named_damages(self.path), open_file(self.path) as stream:
            for _, record in _outer_records(stream, self.path):
                if type(record).__name__ == "Chunk":
                    return {"": "NONE", "lz4": "LZ4"}.get(record.compression, "ZSTD")
        return "NONE"


def _outer_records(stream: Any, path: Path) -> Iterator[tuple[int, Any]]:
    """Yield the records of a file outside of chunks, with the byte at which each starts."""
    reader = _mcap_module("stream_reader").StreamReader(
        stream, emit_chunks=True, record_size_limit=min(path.stat().st_size, _MAX_CHUNK_BYTES)
    )
    offset = _MAGIC_BYTES
    for record in reader.records:
        yield offset, record
        offset = stream.tell()


_MAGIC_BYTES = 8


def _records_of_chunk(chunk: Any, path: Path) -> list[Any]:
    size = chunk.uncompressed_size
    if size > _MAX_CHUNK_BYTES:
        raise CaptureError(f"{path}: a chunk says that it holds {size} bytes; at most {_MAX_CHUNK_BYTES} are read")
    content: bytes = chunk.data
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            content = stream.read(size + 1)
    elif chunk.compression == "lz4":
        content = import_module("lz4.frame").LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression:
        raise CaptureError(f"{path}: a chunk has the compression {chunk.compression!r}; expected zstd or lz4")
    if len(content) != size:
        raise CaptureError(f"{path}: a chunk says that it holds {size} bytes, and has another number of them")
    chunk.compression, chunk.data = "", content
    return _mcap_module("stream_reader").breakup_chunk(chunk)


@lru_cache(maxsize=2)
def _records_at(path: Path, offset: int) -> list[Any]:
    """Return the records of the chunk at a byte, or the single record there; neighbors are usually read next."""
    reader = _mcap_module("stream_reader").StreamReader
    with open_file(path) as stream:
        stream.seek(offset)
        limit = min(path.stat().st_size, _MAX_CHUNK_BYTES)
        record = next(reader(stream, skip_magic=True, emit_chunks=True, record_size_limit=limit).records)
    return _records_of_chunk(record, path) if type(record).__name__ == "Chunk" else [record]


# SQLite, the storage of ROS 2 bags before Iron


@dataclass(frozen=True)
class SqliteContainer:
    """SQLite file of a ROS 2 bag."""

    path: Path
    compressed: bool = False
    """True if each message is compressed."""

    def topics(self) -> list[Topic]:
        with self._opened() as database:
            used = {row[0] for row in database.execute("SELECT DISTINCT topic_id FROM messages")}
            return [topic for number, topic in _sqlite_topics(database).items() if number in used]

    def messages(self, topics: Collection[Topic] | None = None) -> Iterator[BagMessage]:
        with self._opened() as database:
            known = _sqlite_topics(database)
            asked = [number for number, topic in known.items() if topics is None or topic in topics]
            marks = ",".join("?" * len(asked))
            rows = database.execute(
                f"SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "
                "ORDER BY timestamp, id",
                asked,
            )
            for number, topic, time_ns, data in rows:
                yield BagMessage(known[topic], Place(int(number)), int(time_ns), self._data(data))

    def read(self, place: Place) -> bytes:
        with self._opened() as database:
            row = database.execute("SELECT data FROM messages WHERE id = ?", [place.offset]).fetchone()
        if row is None:
            raise CaptureError(f"{self.path}: message {place.offset} is gone")
        return self._data(row[0])

    def copy(self, target: Path, changed: Callable[[BagMessage], bytes | None]) -> None:
        """Copy the file and put new data into the rows of changed messages."""
        with whole_file(target) as partial:
            shutil.copyfile(self.path, partial)
            with self._named_damages(), closing(sqlite3.connect(partial)) as database, database:
                database.execute("PRAGMA trusted_schema = OFF")
                database.execute("PRAGMA journal_mode = MEMORY")
                for message in self.messages():
                    new = changed(message)
                    if new is not None:
                        data = _packed(new) if self.compressed else new
                        database.execute("UPDATE messages SET data = ? WHERE id = ?", [data, message.place.offset])

    def _data(self, data: Any) -> bytes:
        if not isinstance(data, bytes):
            raise CaptureError(f"{self.path}: a message that is no bytes")
        return _unpacked(data, self.path) if self.compressed else data

    @contextmanager
    def _opened(self) -> Generator[sqlite3.Connection]:
        with self._named_damages():
            check_file(self.path)
            with closing(sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
                database.execute("PRAGMA trusted_schema = OFF")
                yield database

    @contextmanager
    def _named_damages(self) -> Generator[None]:
        try:
            yield
        except FileNotFoundError:
            raise CaptureError(f"{self.path}: no such file") from None
        except (sqlite3.Error, KeyError, TypeError, OverflowError) as error:
            raise CaptureError(f"{self.path}: not the database of a ROS 2 bag that can be read ({error})") from None


def _sqlite_topics(database: sqlite3.Connection) -> dict[int, Topic]:
    rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
    return {int(number): Topic(str(name), str(kind), str(form)) for number, name, kind, form in rows}
