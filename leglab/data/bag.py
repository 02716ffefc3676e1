"""Messages of bags (MCAP or sqlite3) and the numbers in them."""

import io
import mmap
import sqlite3
import struct
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdDecompressor

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import parse_json
from leglab.data.alignment import TopicSeries
from leglab.data.files import LeftOut, first_line
from leglab.data.ros_messages import DEFINITIONS, numbers, supported

METADATA_NAME = "leglab"  # leglab's metadata record, with JSON under the key "metadata"
_SQLITE, _ZSTD = b"SQLite format 3\0", b"\x28\xb5\x2f\xfd"


@dataclass
class Bag:
    """The content of all files of a recording."""

    schemas: dict[int, Schema] = field(default_factory=dict)  #: Message definitions by id
    channels: dict[int, Channel] = field(default_factory=dict)  #: Channels of topics by id
    messages: list[Message] = field(default_factory=list)  #: Supported messages, in file order
    metadata: dict = field(default_factory=dict)  #: Metadata, if leglab wrote the recording
    lost: list[str] = field(default_factory=list)  #: One line for each damaged or missing part
    offset: int = 0  #: Added to the 16-bit ids of the present file, as each file starts at 0

    def take(self, record: object) -> None:
        """Stores a record if it is a schema, channel, supported message or leglab's metadata."""
        # The summary at the end repeats schemas and channels; the repetitions are ignored.
        if isinstance(record, Schema):
            record.id += self.offset
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            record.id, record.schema_id = record.id + self.offset, record.schema_id + self.offset
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Message):
            record.channel_id += self.offset
            # If a channel's chunk is broken, the channel is unknown until the summary at the end.
            if record.channel_id not in self.channels or supported(self.kind(record.channel_id)):
                self.messages.append(record)
        elif isinstance(record, Metadata) and record.name == METADATA_NAME:
            self.metadata |= parse_json(record.metadata["metadata"])

    def kind(self, channel_id: int) -> str:
        """Returns the type of a channel's messages."""
        channel = self.channels.get(channel_id)
        schema = self.schemas.get(channel.schema_id) if channel else None
        return schema.name if schema else "without a type"


def scan(paths: Iterable[Path], *, salvage: bool = False) -> Bag:
    """Reads all files of one recording; `lost` of the result lists damaged parts.

    Args:
        paths: MCAP or sqlite3 files, compressed by zstd if they end on `.zstd`.
        salvage: Whether to read the intact parts of broken files.

    Raises:
        LeglabError: A file is truncated, a checksum is wrong, or it is no bag.
    """
    bag = Bag()
    for index, path in enumerate(paths):
        bag.offset, before = 2**16 * index, (len(bag.messages), len(bag.channels))
        try:
            with path.open("rb") as file:
                # Mapped, so that a wrong length in a broken record cannot exhaust memory.
                stream: Any = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            if path.suffix == ".zstd":
                packed = ZstdDecompressor().stream_reader(stream, read_across_frames=True)
                stream = io.BytesIO(packed.read())
            if stream.read(len(_SQLITE)) == _SQLITE:
                _scan_sqlite(_SQLITE + stream.read(), bag)
            else:
                stream.seek(0)
                _scan_mcap(stream, bag, path.name, salvage)
        # Any error of the decompressors and parsers is caused by the file.
        except Exception as error:
            ends = isinstance(error, EndOfFile | struct.error)
            why = "it ends; is the file truncated?" if ends else first_line(error)
            text = f"after {len(bag.messages) - before[0]} readable messages: {why}"
            if not salvage or before == (len(bag.messages), len(bag.channels)):
                form = "sqlite3" if ".db3" in path.name else "MCAP"
                way = "" if salvage else "; --salvage reads what is whole"
                raise FileError(f"{path}: not a complete {form} file: {text}{way}") from error
            bag.lost.append(f"{path.name}: {text}; the rest is lost")
    bag.messages = [m for m in bag.messages if supported(bag.kind(m.channel_id))]
    return bag


def _scan_mcap(stream: Any, bag: Bag, name: str, salvage: bool) -> None:
    chunks, broken, missing, whole = 0, 0, 0, True
    # In a broken file the checksum of the file is wrong, so only those of its chunks are checked.
    for record in StreamReader(stream, validate_crcs=not salvage, emit_chunks=True).records:
        if isinstance(record, Chunk):
            chunks, whole = chunks + 1, True
            try:
                for one in breakup_chunk(record, validate_crc=True):
                    bag.take(one)
            except Exception:
                if not salvage:
                    raise
                broken, whole = broken + 1, False
        elif isinstance(record, MessageIndex) and not whole:
            missing += len(record.records)
        else:
            bag.take(record)
    if broken:
        bag.lost.append(f"{name}: {broken} of {chunks} chunks are broken, {missing} messages lost")


def _scan_sqlite(content: bytes, bag: Bag) -> None:
    database = sqlite3.connect(":memory:")
    # The version numbers 2 in the head would require a write-ahead log, which a closed bag lacks.
    database.deserialize(content[:18] + b"\1\1" + content[20:])
    definitions = {kind: ("ros2msg", text) for kind, text in DEFINITIONS.items()}
    with suppress(sqlite3.OperationalError):  # The table exists from ROS 2 Iron on.
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions |= {kind: (form, text) for kind, form, text in database.execute(query) if text}
    query = "SELECT id, name, type, serialization_format FROM topics"
    for number, topic, kind, encoding in database.execute(query):
        form, text = definitions.get(kind, ("", ""))
        bag.take(Schema(id=number, data=text.encode(), encoding=form, name=kind))
        bag.take(Channel(number, topic, encoding, {}, number))
    for number, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages"):
        bag.take(Message(int(number), int(time), data, 0, 0))  # sqlite columns hold any type.


def decode(
    bag: Bag, clock_topic: str, wanted_stamps: str, left_out: LeftOut
) -> dict[str, TopicSeries]:
    """Decodes all messages, in the order of their log times within each topic.

    Args:
        bag: Content of the files.
        clock_topic: The JointState topic of the time axis; it may have no message.
        wanted_stamps: "header" for header stamps if there are any, or "log".
        left_out: Gets topics other than the clock's that cannot be decoded.

    Raises:
        LeglabError: A message cannot be decoded; names topic and message.
    """
    factory = DecoderFactory()
    rows: dict[str, list[tuple[int, int | None, dict[str, float]]]] = {clock_topic: []}
    undecoded: dict[str, list[str]] = {}
    for message in sorted(bag.messages, key=lambda m: m.log_time):
        channel = bag.channels[message.channel_id]
        topic, schema = channel.topic, bag.schemas[channel.schema_id]
        of_topic = rows.setdefault(topic, [])
        if topic.removeprefix("/") in left_out:
            continue
        try:
            decoder = factory.decoder_for(channel.message_encoding, schema)
            if decoder is None:
                forms = f"{channel.message_encoding!r} with a definition in {schema.encoding!r}"
                raise ValueError(f"encoded as {forms}; allowed: 'cdr' with 'ros2msg'")
            data = message.data
            if data.startswith(_ZSTD):  # No uncompressed message starts with these bytes.
                data = ZstdDecompressor().decompressobj().decompress(data)
            content = decoder(data)
            header = getattr(content, "header", None)
            stamp = header and int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)
            found = numbers(schema.name, content, topic, topic == clock_topic)
            of_topic.append((message.log_time, stamp, found))
        # Definitions come from the file, so that decoding can raise any exception.
        except Exception as error:
            if left_out.salvage:
                undecoded.setdefault(topic, []).append(first_line(error))
                continue
            text = f"topic {topic!r}, message {len(of_topic)}: {first_line(error)}"
            if topic == clock_topic:
                raise RecordingError(text, given=topic) from error
            left_out.add(topic.removeprefix("/"), RecordingError(text, given=topic))
            of_topic.clear()
    for topic, reasons in undecoded.items():
        why = f"{len(reasons)} messages cannot be decoded, the first: {reasons[0]}"
        bag.lost.append(f"topic {topic!r}: {why}")
    return {topic: _series(topic, found, wanted_stamps) for topic, found in rows.items()}


def _series(topic: str, rows: list, wanted_stamps: str) -> TopicSeries:
    log, header = [row[0] for row in rows], [row[1] for row in rows]
    # The stamps of headers that were not filled in are zero.
    by_header = wanted_stamps == "header" and None not in header and (any(header) or header == log)
    stamps = np.array(header if by_header else log, dtype=np.int64)
    names = dict.fromkeys(name for row in rows for name in row[2])
    columns = {n: np.array([row[2].get(n, np.nan) for row in rows]) for n in names}
    return TopicSeries(topic, stamps, columns, stamped_by="header" if by_header else "log")
