"""Importer of ROS recordings without ROS: bags of ROS 1, of ROS 2 (SQLite) and MCAP, with messages of any type.

Each topic has a rate of its own. The rows of a log are the messages of one topic, the clock. Of every other topic a row
gets what was known then: commands are held, measurements are interpolated.
"""

import re
import sqlite3
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from leapgap.errors import InputError, needs
from leapgap.logs.clock import held_at, increasing_rows
from leapgap.logs.cutting import HELD
from leapgap.logs.files import MOST_UNPACKED, Bounded, unpack
from leapgap.logs.importers.table_format import TableFormat, TableOptions
from leapgap.logs.importers.tables import Arrays, Wanted, check_size
from leapgap.runtime.typed_values import MOST_BYTES, from_yaml
from leapgap.runtime.typed_values import check_size as check_values

RECEIVED, STAMPED = "received", "stamped"
TIME = "time"
NAME_FIELDS = ("name", "names", "joint_names")
"""Fields with the names of joints: arrays of the same length beside them are addressed by these names."""
METADATA = "metadata.yaml"
FEWEST = 10  # messages of a topic below which it is no stream
MOST_TIMES, LARGEST_PIECE = 100, 1 << 28
"""How many times the size of its files a recording may have when it is unpacked, and bytes of one packed piece."""
LONGEST = 1000  # items of an array in a message that can be addressed: motors and feet, no pixels

Step = str | int
Getter = tuple[Step, ...]  # how a value is reached in a message: fields by name, items by index


@dataclass(frozen=True)
class RosOptions(TableOptions):
    """Options of ROS recordings. Theirs are called ``/topic/field.field[index]``, in messages with names of joints
    ``/joint_states/position[knee]``."""

    clock: str | None = None  # topic whose messages are the rows; none: that of measured positions of joints
    stamps: str = RECEIVED  # times of the messages: when they were ``received``, or as ``stamped`` in their headers
    message_files: list[str] = field(default_factory=list)
    """Definitions of messages (``package/msg/Name.msg``), for an SQLite recording that does not hold them itself."""


@dataclass(frozen=True)
class Topic:
    """The messages of one topic: their times, s, (messages,), and the wanted fields, each (messages,)."""

    time: np.ndarray
    fields: dict[str, np.ndarray]


class Ros(TableFormat):
    """Bags of ROS 1 and 2, and MCAP."""

    name = "ros"
    suffixes = (".bag", ".mcap", ".db3")
    holds = "recording"
    repair = "copy it whole; name message_files if it does not hold its message types"
    Options = RosOptions
    columns: ClassVar[Mapping[str, str]] = {TIME: TIME}

    def find(self, source: Path) -> dict[str, Path]:
        """Bags of a folder: files, and folders with a ``metadata.yaml``; the source may be one of them."""
        if source.is_file() or (source / METADATA).is_file():
            return {source.stem if source.is_file() else source.name: source}
        folders = {path.parent.name: path.parent for path in sorted(source.glob(f"*/{METADATA}"))}
        return {**super().find(source), **folders}

    def read_table(self, path: Path, options: RosOptions, wanted: Wanted) -> Arrays:
        """The wanted fields of all topics, joined on the messages of the clock."""
        if options.stamps not in (RECEIVED, STAMPED):
            raise InputError("ros: stamps", options.stamps, f"{RECEIVED} or {STAMPED}", "choose one")
        topics = read_topics(path, options, wanted)
        if not topics:
            do = "name their fields as /topic/field in the map of columns"
            raise InputError(path, "no field that is mapped", "messages with these fields", do)
        clock = options.clock or clock_of(topics, options)
        if clock not in topics:
            raise InputError(path, f"no mapped field of {clock}", f"one of {', '.join(topics)}", "choose it as clock")
        return join(topics, clock, options, path)


def read_topics(path: Path, options: RosOptions, wanted: Wanted) -> dict[str, Topic]:
    """Times and wanted fields of every topic that has such fields."""
    with needs("ros"):
        from rosbags.highlevel import AnyReader
    times: dict[str, list[int]] = defaultdict(list)
    rows: dict[str, list[list[Any]]] = defaultdict(list)
    getters: dict[str, dict[str, Getter]] = {}
    # Refuse a description of a recording that is too large, names of YAML written out
    about = path / METADATA
    if about.is_file():
        if about.stat().st_size > MOST_BYTES:
            raise InputError(about, f"{about.stat().st_size} bytes", f"{MOST_BYTES} at most", "copy it again")
        check_values(from_yaml(about.read_text(encoding="utf-8")))
    with bounded_unpacking(path), AnyReader([path], default_typestore=types_of(options)) as reader:
        counts = {name: info.msgcount for name, info in reader.topics.items()}
        mapped = [one for one in reader.connections if may_be_mapped(one.topic, options)]
        for connection, received, raw in reader.messages(mapped) if mapped else ():
            topic = connection.topic
            if not getters.get(topic, True):
                continue  # nothing of it is wanted
            message = reader.deserialize(raw, connection.msgtype)
            if topic not in getters:
                getters[topic] = {name: at for name, at in leaves(message, topic) if wanted(name)}
                check_size(path, sum(counts[one] * len(found) for one, found in getters.items()))
                if not getters[topic]:
                    continue
            times[topic].append(stamp(message, topic, path) if options.stamps == STAMPED else received)
            rows[topic].append(values_of(message, getters[topic], f"{path}, {topic}, message {len(rows[topic])}"))
    first = min((min(stamps) for stamps in times.values()), default=0)
    topics = {}
    for topic, stamps in times.items():  # in the order of time, which is that since the first message of the recording
        time = (np.array(stamps, dtype=np.int64) - first) * 1e-9
        order = np.argsort(time, kind="stable")
        values = np.array(rows[topic], dtype=np.float64)[order]
        topics[topic] = Topic(time[order], dict(zip(getters[topic], values.T, strict=True)))
    return topics


def check_tables(path: Path) -> None:
    """``InputError`` for tables of SQLite that compute what is read of them, without end or of any size."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
        kinds = {kind for (kind,) in base.execute("SELECT DISTINCT type FROM sqlite_master")}
        names = [name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        hidden = [row[6] for name in names for row in base.execute("SELECT * FROM pragma_table_xinfo(?)", (name,))]
    if not kinds <= {"table", "index"} or any(hidden):
        raise InputError(path, "tables that are computed when they are read", "plain tables", "record it again")


@contextmanager
def bounded_unpacking(path: Path) -> Iterator[None]:
    """Let the reader of recordings unpack within limits: so much a piece, and not many times the size of the files.

    Tables of SQLite are looked at before they are read.
    """
    import bz2
    from unittest.mock import patch

    import lz4.frame
    from rosbags.rosbag1 import reader as bags
    from rosbags.rosbag2 import reader as recordings
    from rosbags.rosbag2 import storage_mcap, storage_sqlite3

    size = sum(one.stat().st_size for one in (path.rglob("*") if path.is_dir() else [path]) if one.is_file())
    left = max(MOST_UNPACKED, MOST_TIMES * size)

    def bounded(start: Callable[[], Any]) -> Callable[..., bytes]:
        def unpacked(data: bytes, *_: int) -> bytes:
            nonlocal left
            found = unpack(data, start, path, min(left, LARGEST_PIECE))
            left -= len(found)
            return found

        return unpacked

    def open_base(reader: Any) -> None:
        check_tables(Path(str(reader.path)))
        open_any(reader)

    zstd, open_any = recordings.zstd, storage_sqlite3.Sqlite3Reader.open
    ours = {
        "lz4": bounded(lz4.frame.LZ4FrameDecompressor),
        "bz2": bounded(bz2.BZ2Decompressor),
        "zstd": bounded(zstd.ZstdDecompressor),
    }
    tables = (bags.decompressors, storage_mcap.DECOMPRESSORS)
    unpackers = [patch.dict(table, {name: ours[name] for name in table if name in ours}) for table in tables]
    opened = SimpleNamespace(decompress=ours["zstd"], open=lambda file, *_: Bounded(zstd.open(file), path, left))
    sqlite = patch.object(storage_sqlite3.Sqlite3Reader, "open", open_base)
    with unpackers[0], unpackers[1], patch.object(recordings, "zstd", opened), sqlite:
        yield


def may_be_mapped(topic: str, options: RosOptions) -> bool:
    """Whether a name of theirs may be a field of this topic; where nothing is mapped, every topic."""
    terms = [[theirs] if isinstance(theirs, str) else list(theirs) for theirs in options.columns.values()]
    names = {name for one in terms for name in one} | set(options.drop_rows) | {options.cut_by or TIME}
    heads = {name.partition("*")[0] for name in names - {TIME}}
    return not heads or any(head.startswith(f"{topic}/") or f"{topic}/".startswith(head) for head in heads)


def types_of(options: RosOptions) -> Any:
    """Message types for recordings that hold none: those of ROS 2, and the stated files."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.LATEST)
    for name in options.message_files:
        file = Path(name)
        kind = f"{file.parent.parent.name}/msg/{file.stem}"
        try:
            store.register(get_types_from_msg(file.read_text(encoding="utf-8"), kind))
        except Exception as error:
            expected = "a message definition as package/msg/Name.msg"
            raise InputError(file, f"none that can be read ({error})", expected, "correct message_files") from None
    return store


def leaves(message: Any, topic: str) -> Iterator[tuple[str, Getter]]:
    """Every number of a message: its name, and how it is reached."""

    def below(value: Any, name: str, at: Getter, names: Sequence[str] = ()) -> Iterator[tuple[str, Getter]]:
        if isinstance(value, bool | int | float | np.number):
            yield name, at
        elif isinstance(value, list | tuple | np.ndarray):
            for i, item in enumerate(value[:LONGEST]):
                yield from below(item, f"{name}[{i}]", (*at, i), names)
        elif hasattr(value, "__msgtype__"):
            fields = [one for one in vars(value) if not one.startswith("_")]
            names = names_in(value, names)
            for one in fields:
                inner = getattr(value, one)
                path = f"{name}.{one}" if at else f"{name}/{one}"
                yield from below(inner, path, (*at, one), names)
                if names and isinstance(inner, np.ndarray) and len(inner) == len(names):
                    yield from ((f"{path}[{joint}]", (*at, one, str(joint))) for joint in names)

    return below(message, topic, ())


def values_of(message: Any, getters: dict[str, Getter], where: str) -> list[float]:
    """The wanted numbers of one message; ``InputError`` where an array is shorter than in the first one."""
    found = []
    for name, getter in getters.items():
        value = message
        try:
            for at, step in enumerate(getter):
                if isinstance(step, int):
                    value = value[step]
                elif isinstance(value, np.ndarray):
                    value = value[index_of(message, getter[: at - 1], step)]
                else:
                    value = getattr(value, step)
            found.append(float(value))
        except (IndexError, AttributeError, ValueError):
            raise InputError(where, f"no {name}", "the fields of the first message", "cut the recording") from None
    return found


def names_in(message: Any, otherwise: Sequence[str]) -> Sequence[str]:
    """The names of joints that a message lists, if it does: one text is no list of them."""
    lists = (getattr(message, one, None) for one in NAME_FIELDS)
    return next((list(one) for one in lists if isinstance(one, list | tuple | np.ndarray)), otherwise)


def index_of(message: Any, parent: Getter, joint: str) -> int:
    """Where a joint stands in this message, by the names beside its values, or beside what they are part of."""
    names: Sequence[str] = ()
    for step in (None, *parent):
        if step is not None:
            message = message[step] if isinstance(step, int) else getattr(message, step)
        names = names_in(message, names)
    return list(names).index(joint)


def stamp(message: Any, topic: str, path: Path) -> int:
    """The time in a message's header, ns."""
    header = getattr(message, "header", None)
    if header is None:
        raise InputError(f"{path}, {topic}", "messages without a header", "a stamp", "set stamps: received")
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def patterns(options: RosOptions, quantities: tuple[str, ...]) -> list[re.Pattern[str]]:
    """Names of their fields that some quantities of ours are mapped to; ``*`` stands for anything."""
    found = []
    for ours, theirs in options.columns.items():
        if ours.partition("/")[0] in quantities:
            names = [theirs] if isinstance(theirs, str) else list(theirs)
            found += [re.compile(re.escape(name).replace(r"\*", ".+")) for name in names]
    return found


def clock_of(topics: dict[str, Topic], options: RosOptions) -> str:
    """The topic that positions of joints come from, else the one with most messages."""
    measured = patterns(options, ("joint_pos",))
    for topic, one in topics.items():
        if any(pattern.fullmatch(name) for pattern in measured for name in one.fields):
            return topic
    return max(topics, key=lambda topic: len(topics[topic].time))


def join(topics: dict[str, Topic], clock: str, options: RosOptions, path: Path) -> dict[str, np.ndarray]:
    """All fields at the times of the clock's messages, from when every topic has been heard to when one ends.

    A command stays until the next, also after the last one. Where nothing is mapped, topics that were sent now and then
    keep the rows that they have: they are no part of the log.
    """
    whole = topics
    if options.columns.keys() <= {TIME}:
        middle = 0.5 * (topics[clock].time[0] + topics[clock].time[-1])
        streams = [
            topic for topic, one in topics.items() if len(one.time) >= FEWEST and one.time[0] < middle < one.time[-1]
        ]
        topics = {topic: one for topic, one in topics.items() if topic == clock or topic in streams}
    commands = patterns(options, HELD)
    held = {name for one in topics.values() for name in one.fields if any(p.fullmatch(name) for p in commands)}
    begin = max(one.time[0] for one in topics.values())
    end = min((one.time[-1] for one in topics.values() if not set(one.fields) <= held), default=np.inf)
    rows = (topics[clock].time >= begin) & (topics[clock].time <= end)
    if not rows.any():
        raise InputError(path, f"no message of {clock} while all topics are there", "topics at one time", "cut it")
    instants = topics[clock].time[rows]
    arrays = {TIME: instants}
    for topic, one in topics.items():
        kept = increasing_rows(one.time)
        for name, values in one.fields.items():
            at = held_at if name in held else np.interp
            arrays[name] = values[rows] if topic == clock else at(instants, one.time[kept], values[kept])
    return arrays | {name: at for topic in whole.keys() - topics.keys() for name, at in whole[topic].fields.items()}
