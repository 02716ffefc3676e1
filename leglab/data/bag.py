"""Messages of MCAP files and the numbers in them."""

import mmap
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import parse_json
from leglab.data.alignment import TopicSeries
from leglab.data.files import LeftOut, check_notes, first_line
from leglab.data.ros_messages import header_stamp, numbers, supported

# Our metadata record, with JSON under the key "metadata".
METADATA_NAME = "leglab"


@dataclass
class Bag:
    """The content of a file."""

    schemas: dict[int, Schema] = field(default_factory=dict)  #: Message definitions by id
    #: Channels by id; several may share a topic.
    channels: dict[int, Channel] = field(default_factory=dict)
    #: Raw messages of supported types, in file order.
    messages: list[Message] = field(default_factory=list)
    metadata: dict = field(default_factory=dict)  #: Of the recording, if it was written here

    def kind(self, channel: Channel) -> str:
        """Returns the type of a channel's messages."""
        schema = self.schemas.get(channel.schema_id)
        return "without a type" if schema is None else schema.name

    def topics(self) -> str:
        """Returns all topics with their types, for messages."""
        found = {channel.topic: self.kind(channel) for channel in self.channels.values()}
        # A type of a damaged file may hold anything, line ends as well.
        return ", ".join(f"{t!r} ({kind!r})" for t, kind in found.items()) or "no topic"


def scan(path: Path) -> Bag:
    """Reads a whole file.

    Raises:
        LeglabError: The file is truncated, a checksum is wrong, or it is no MCAP file.
    """
    bag = Bag()
    wanted: set[int] = set()
    try:
        # A mapped file, for its `read` never allocates more than there is, whatever a broken
        # record says of its length.
        read = mmap.ACCESS_READ
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=read) as stream:
            for record in StreamReader(stream, validate_crcs=True).records:  # type: ignore[arg-type]
                # The summary at the end repeats schemas and channels: the first ones count.
                if isinstance(record, Schema):
                    bag.schemas.setdefault(record.id, record)
                elif isinstance(record, Channel):
                    bag.channels.setdefault(record.id, record)
                    if supported(bag.kind(record)):
                        wanted.add(record.id)
                elif isinstance(record, Message) and record.channel_id in wanted:
                    bag.messages.append(record)
                elif isinstance(record, Metadata) and record.name == METADATA_NAME:
                    bag.metadata = parse_json(record.metadata["metadata"])
                    check_notes(bag.metadata)
    # Whatever the decompressors and parsers trip over, the cause is the file.
    except Exception as error:
        at = f"after {len(bag.messages)} readable messages"
        if isinstance(error, EndOfFile | struct.error):
            reason = f"it ends {at}; is the file truncated?"
        else:
            reason = f"{at}: {first_line(error)}"
        raise FileError(f"{path}: not a complete MCAP file: {reason}", given=path) from error
    return bag


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

    Returns:
        Numbers by topic.

    Raises:
        LeglabError: A message cannot be decoded; names topic and message.
    """
    factory = DecoderFactory()
    rows: dict[str, list[tuple[int, int | None, dict[str, float]]]] = {clock_topic: []}
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
            content = decoder(message.data)
            stamp = header_stamp(content)
            is_clock = channel.topic == clock_topic
            found = numbers(schema.name, content, channel.topic, is_clock=is_clock)
        # Definitions come from the file too, so that anything can go wrong in decoding.
        except Exception as error:
            told = RecordingError(f"{where}: {first_line(error)}", given=channel.topic)
            if channel.topic == clock_topic or not left_out.partial:
                raise told from error
            left_out.add(owner, told)
            del rows[channel.topic]
            continue
        of_topic.append((message.log_time, stamp, found))
    return {topic: _series(topic, found, wanted_stamps, path) for topic, found in rows.items()}


def _series(topic: str, rows: list, wanted_stamps: str, path: Path) -> TopicSeries:
    log = [row[0] for row in rows]
    header = [row[1] for row in rows]
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
