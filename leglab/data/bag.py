"""Messages of bags, MCAP or sqlite3, and the numbers in them."""

import io
import mmap
import sqlite3
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdDecompressor

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import parse_json
from leglab.data.alignment import TopicSeries
from leglab.data.files import LeftOut, check_notes, first_line
from leglab.data.ros_messages import DEFINITIONS, header_stamp, numbers, supported

# Our metadata record, with JSON under the key "metadata".
METADATA_NAME = "leglab"
_IDS = 2**16  # of channels, and of schemas, that a file can have
_SQLITE, _ZSTD = b"SQLite format 3\0", b"\x28\xb5\x2f\xfd"


@dataclass
class Bag:
    """The content of the files of a recording."""

    schemas: dict[int, Schema] = field(default_factory=dict)  #: Message definitions by id
    #: Channels by id; several may share a topic.
    channels: dict[int, Channel] = field(default_factory=dict)
    #: Raw messages of supported types, in file order.
    messages: list[Message] = field(default_factory=list)
    metadata: dict = field(default_factory=dict)  #: Of the recording, if it was written here
    lost: list[str] = field(default_factory=list)  #: One line for each damaged or missing part
    offset: int = 0  #: Of the ids of a file, each of which counts anew

    def take(self, record: object) -> None:
        """Keeps a record that says or holds something."""
        # The summary at the end repeats schemas and channels: the first ones count.
        if isinstance(record, Schema):
            self.schemas.setdefault(record.id + self.offset, record)
        elif isinstance(record, Channel):
            channel = replace(record, schema_id=record.schema_id + self.offset)
            self.channels.setdefault(record.id + self.offset, channel)
        elif isinstance(record, Message):
            record.channel_id += self.offset
            # The channel of a broken chunk is at the end.
            if record.channel_id not in self.channels or self.supports(record):
                self.messages.append(record)
        elif isinstance(record, Metadata) and record.name == METADATA_NAME:
            metadata = parse_json(record.metadata["metadata"])
            check_notes(metadata)
            self.metadata |= metadata

    def supports(self, message: Message) -> bool:
        """Returns whether a message has a channel, and numbers."""
        channel = self.channels.get(message.channel_id)
        return channel is not None and supported(self.kind(channel))

    def kind(self, channel: Channel) -> str:
        """Returns the type of a channel's messages."""
        schema = self.schemas.get(channel.schema_id)
        return "without a type" if schema is None else schema.name

    def topics(self) -> str:
        """Returns all topics with their types, for messages."""
        found = {channel.topic: self.kind(channel) for channel in self.channels.values()}
        # A type of a damaged file may hold anything, line ends as well.
        return ", ".join(f"{t!r} ({kind!r})" for t, kind in found.items()) or "no topic"


def scan(paths: Iterable[Path], *, salvage: bool = False) -> Bag:
    """Reads whole files, the parts of one recording, of which `lost` counts what is not whole.

    Args:
        paths: MCAP or sqlite3 files, packed by zstd where they end on `.zstd`.
        salvage: Whether what is whole of broken files is read.

    Raises:
        LeglabError: A file is truncated, a checksum is wrong, or it is no bag.
    """
    bag = Bag()
    for index, path in enumerate(paths):
        lost: list[str] = []
        bag.offset, before = _IDS * index, (len(bag.messages), len(bag.channels))
        try:
            if path.suffix == ".zstd":
                packed = ZstdDecompressor().stream_reader(path.open("rb"), read_across_frames=True)
                _scan(io.BytesIO(packed.read()), bag, lost, salvage)
            else:
                # A mapped file, for its `read` never allocates more than there is, whatever a
                # broken record says of its length.
                read = mmap.ACCESS_READ
                with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=read) as stream:
                    _scan(cast(BinaryIO, stream), bag, lost, salvage)
        # Whatever the decompressors and parsers trip over, the cause is the file.
        except Exception as error:
            readable = len(bag.messages) - before[0]
            at, why = f"after {readable} readable messages", first_line(error)
            if not salvage or before == (len(bag.messages), len(bag.channels)):
                ends = isinstance(error, EndOfFile | struct.error)
                reason = f"it ends {at}; is the file truncated?" if ends else f"{at}: {why}"
                way = "" if salvage else "; --salvage reads what is whole"
                what = "bag of sqlite3" if ".db3" in path.name else "MCAP file"
                told = f"{path}: not a complete {what}: {reason}{way}"
                raise FileError(told, given=path) from error
            lost.append(f"it ends or is broken {at} ({why}), the rest is lost")
        bag.lost += [f"{path.name}: {line}" for line in lost]
    bag.messages = [message for message in bag.messages if bag.supports(message)]
    return bag


def _scan(stream: BinaryIO, bag: Bag, lost: list[str], salvage: bool) -> None:
    if stream.read(len(_SQLITE)) == _SQLITE:
        _scan_sqlite(_SQLITE + stream.read(), bag)
        return
    stream.seek(0)
    chunks, broken, missing, whole = 0, 0, 0, True
    # Of a broken file the checksum of all is wrong; those of its chunks are checked one by one.
    reader = StreamReader(stream, validate_crcs=not salvage, emit_chunks=True)
    for record in reader.records:
        if isinstance(record, Chunk):
            chunks += 1
            try:
                for one in breakup_chunk(record, validate_crc=True):
                    bag.take(one)
                whole = True
            except Exception:
                if not salvage:
                    raise
                broken, whole = broken + 1, False
        elif isinstance(record, MessageIndex) and not whole:
            missing += len(record.records)
        else:
            bag.take(record)
    if broken:
        lost.append(f"{broken} of {chunks} chunks are broken, with them {missing} messages lost")


def _scan_sqlite(content: bytes, bag: Bag) -> None:
    """Reads a sqlite3 bag; it contains message definitions from ROS 2 Iron on."""
    database = sqlite3.connect(":memory:")
    # Versions 2 of the format mean a log beside the file, which a bag that was closed has not.
    database.deserialize(content[:18] + b"\1\1" + content[20:])
    named = database.execute("SELECT name FROM sqlite_master").fetchall()
    definitions = {kind: ("ros2msg", text) for kind, text in DEFINITIONS.items()}
    if ("message_definitions",) in named:
        rows = "topic_type, encoding, encoded_message_definition FROM message_definitions"
        found = database.execute(f"SELECT {rows}")
        definitions |= {kind: (form, text) for kind, form, text in found if text}
    rows = "id, name, type, serialization_format FROM topics"
    for row in database.execute(f"SELECT {rows}"):
        number, topic, kind, encoding = _typed(row, int, str, str, str)
        form, text = definitions.get(kind, ("", ""))
        bag.take(Schema(id=number, data=text.encode(), encoding=form, name=kind))
        bag.take(Channel(number, topic, encoding, {}, number))
    for row in database.execute("SELECT topic_id, timestamp, data FROM messages"):
        number, time, data = _typed(row, int, int, bytes)
        bag.take(Message(number, time, data, time, 0))


def _typed(row: tuple, *types: type) -> tuple:
    """The values of a row; sqlite3 itself takes any type in any column."""
    for value, kind in zip(row, types, strict=True):
        if not isinstance(value, kind):
            raise ValueError(f"{value!r} where {kind.__name__} should be")
    return row


def decode(
    bag: Bag, clock_topic: str, wanted_stamps: str, path: Path, left_out: LeftOut
) -> dict[str, TopicSeries]:
    """Decodes all messages; those of a topic in the order of their log times.

    Args:
        bag: Of the file.
        clock_topic: The JointState topic that gives the time axis; it may have no message.
        wanted_stamps: "header", where there are any, or "log".
        path: Of the file, for messages.
        left_out: Gets topics other than the clock's that cannot be decoded.

    Raises:
        LeglabError: A message cannot be decoded; names topic and message.
    """
    factory = DecoderFactory()
    rows: dict[str, list[tuple[int, int | None, dict[str, float]]]] = {clock_topic: []}
    undecoded: dict[str, list[str]] = {}
    for message in sorted(bag.messages, key=lambda m: m.log_time):
        channel = bag.channels[message.channel_id]
        owner = channel.topic.removeprefix("/")
        if owner in left_out:
            continue
        of_topic = rows.setdefault(channel.topic, [])
        where = f"{path}: topic {channel.topic!r}, message {len(of_topic)}"
        try:
            schema = bag.schemas[channel.schema_id]
            decoder = factory.decoder_for(channel.message_encoding, schema)
            if decoder is None:
                raise RecordingError(
                    f"encoded as {channel.message_encoding!r} with a definition in "
                    f"{schema.encoding!r}; allowed: 'cdr' with 'ros2msg'"
                )
            data = message.data
            if data.startswith(_ZSTD):  # No message that is not packed does.
                data = ZstdDecompressor().decompressobj().decompress(data)
            content = decoder(data)
            found = numbers(schema.name, content, channel.topic, channel.topic == clock_topic)
            of_topic.append((message.log_time, header_stamp(content), found))
        # Definitions come from the file too, so that anything can go wrong in decoding.
        except Exception as error:
            if left_out.salvage:
                undecoded.setdefault(channel.topic, []).append(first_line(error))
                continue
            told = RecordingError(f"{where}: {first_line(error)}", given=channel.topic)
            if channel.topic == clock_topic:
                raise told from error
            left_out.add(owner, told)
            del rows[channel.topic]
    for topic, reasons in undecoded.items():
        why = f"{len(reasons)} messages cannot be decoded, the first: {reasons[0]}"
        bag.lost.append(f"topic {topic!r}: {why}")
    return {topic: _series(topic, found, wanted_stamps, path) for topic, found in rows.items()}


def _series(topic: str, rows: list, wanted_stamps: str, path: Path) -> TopicSeries:
    log, header = [row[0] for row in rows], [row[1] for row in rows]
    # A header that nobody filled in has zeros.
    by_header = wanted_stamps == "header" and None not in header and (any(header) or header == log)
    try:
        stamps = np.array(header if by_header else log, dtype=np.int64)
    except (OverflowError, TypeError, ValueError) as error:
        told = f"{path}: topic {topic!r}: stamps beyond 2^63 ns"
        raise RecordingError(told, given=topic) from error
    names = dict.fromkeys(name for row in rows for name in row[2])
    columns = {n: np.array([row[2].get(n, np.nan) for row in rows]) for n in names}
    return TopicSeries(topic, stamps, columns, stamped_by="header" if by_header else "log")
