"""Recordings of runs: files that `./vlaps up --record` writes, read as NumPy arrays."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _vlaps
from ._vlaps import RecordingError
from .columns import RECORDED_S, arrow_batch, flat, needed
from .definition import NoFixedSize, dtype_of

#: The latest time on a run's clock, ns.
_END_NS = 2**64 - 1
#: Messages that cross the border at once while iterating.
_AT_ONCE = 256


@dataclass(frozen=True)
class Topic:
    """The messages of one service."""

    name: str
    #: Such as `vlaps_msgs/msg/Step`.
    schema: str
    #: The message's definition, in the format `ros2msg`.
    definition: str = field(repr=False)
    #: Messages in the recording.
    count: int
    #: When the first and the last were recorded, s since the recording's first message.
    start: float
    end: float
    #: Whether this build of vlaps has the same message layout.
    is_current: bool

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """The NumPy type of a message, made of its definition.

        Raises `TypeError` for a message without a fixed size.
        """
        return dtype_of(self.definition, self.schema)


@dataclass(frozen=True)
class Attachment:
    """A file in a recording: the configuration, a policy, a judge's picture."""

    name: str
    media_type: str
    bytes: int


@dataclass(frozen=True)
class Message:
    """One recorded message."""

    topic: str
    #: When it was recorded, s since the recording's first message.
    time: float
    #: When it was taken, on the run's clock, ns.
    taken_ns: int
    #: The message; bytes when it has no fixed size.
    data: Any


class Recording:
    """A recording: a folder with the files of one run, or one file, also without its end.

    Times are seconds since the recording's first message. The messages stay on disk until
    they are asked for.

    >>> recording = vlaps.Recording("rec")
    >>> recording.topics["step"].count
    553
    >>> steps = recording["step"]
    >>> steps["command"]["steer"].shape
    (553,)
    >>> for message in recording.iterate(["progress"], start=10.0, end=10.25):
    ...     print(message.data["completion"])

    Raises `FileNotFoundError`, or `vlaps.RecordingError` for an empty folder, a foreign file or
    one of a newer format.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self._file = _vlaps.RecordingFile(self.path)
        self._start_ns, self._end_ns = self._file.span_ns() or (0, 0)
        self._dtypes: dict[str, np.dtype[Any] | None] = {}

    def __repr__(self) -> str:
        return f"Recording({self.path!r}: {self.duration:.1f} s, topics {', '.join(self.topics)})"

    @cached_property
    def topics(self) -> dict[str, Topic]:
        """What was recorded, by name; services without a message are left out."""
        rows = self._file.channels()
        return {
            name: Topic(name, schema, definition, count, self._s(first), self._s(last), current)
            for name, schema, definition, current, count, first, last in rows
        }

    @property
    def duration(self) -> float:
        """Seconds from the first to the last message."""
        return (self._end_ns - self._start_ns) * 1e-9

    @property
    def start_ns(self) -> int:
        """When the first message was recorded, on the run's clock, ns."""
        return self._start_ns

    @property
    def metadata(self) -> dict[str, str]:
        """Run, commit, processor, hashes of the programs, clock."""
        return self._file.metadata()

    @property
    def files(self) -> list[str]:
        """Its files in order of time."""
        return [os.fspath(path) for path in self._file.files()]

    @property
    def damage(self) -> list[str]:
        """One line for each file that ends before its end; its beginning is read."""
        return self._file.damage()

    @property
    def attachments(self) -> list[Attachment]:
        """The files in it."""
        return [Attachment(*row) for row in self._file.attachments()]

    def attachment(self, name: str) -> bytes:
        """The data of the first attachment of this name, such as "config.toml"."""
        for place, one in enumerate(self.attachments):
            if one.name == name:
                return self._file.attachment(place)
        names = sorted({one.name for one in self.attachments})
        raise KeyError(f"no attachment {name!r}; there are {', '.join(names) or 'none'}")

    @property
    def configuration(self) -> str:
        """The configuration as it ran, TOML."""
        return self.attachment("config.toml").decode()

    def rate_hz(self) -> int:
        """The rate of its steps, 1/s, to the next whole number."""
        times = self.times("step") if "step" in self else np.empty(0)
        period_s = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        if period_s <= 0.0:
            raise RecordingError(f"{self.path}: without two steps it has no rate")
        return max(round(1 / period_s), 1)

    def __contains__(self, topic: object) -> bool:
        return topic in self.topics

    def __iter__(self) -> Iterator[str]:
        return iter(self.topics)

    def __len__(self) -> int:
        """Number of topics."""
        return len(self.topics)

    def __getitem__(self, topic: str) -> NDArray[Any]:
        """All messages of a topic as a structured array, `[count]`."""
        return self.read(topic)

    def read(
        self, topic: str, start: float | None = None, end: float | None = None, every: int = 1
    ) -> NDArray[Any]:
        """The messages of a topic recorded from `start` to `end`, or each `every`-th of them.

        Nested messages are nested types: `steps["observation"]["ego"]["speed_mps"]`.
        """
        return self._read(topic, start, end, every)[0]

    def times(
        self, topic: str, start: float | None = None, end: float | None = None, every: int = 1
    ) -> NDArray[np.float64]:
        """When each message that `read` returns was recorded."""
        return self._read(topic, start, end, every)[1]

    def batches(
        self,
        topic: str,
        rows: int = 1024,
        start: float | None = None,
        end: float | None = None,
    ) -> Iterator[tuple[NDArray[np.float64], NDArray[Any]]]:
        """Times and messages of a topic, at most `rows` at a time."""
        dtype = self._dtype(topic)
        messages = self._file.messages([topic], self._span(start, end))
        while found := messages.next(_positive("rows", rows)):
            times = np.array([self._s(recorded_ns) for _, recorded_ns, _, _ in found])
            for _, _, _, data in found:
                _checked(topic, data, dtype)
            yield times, np.frombuffer(b"".join(row[3] for row in found), dtype)

    def iterate(
        self,
        topics: str | Iterable[str] | None = None,
        start: float | None = None,
        end: float | None = None,
    ) -> Iterator[Message]:
        """The messages of these topics, or of all, in order of time.

        At most one chunk of the recording, a few megabytes, is in memory. After an error a new
        iterator with a later `start` goes on behind the damage.
        """
        names = None if topics is None else self._names(topics)
        messages = self._file.messages(names, self._span(start, end))

        def each() -> Iterator[Message]:
            while found := messages.next(_AT_ONCE):
                for topic, recorded_ns, taken_ns, data in found:
                    yield Message(topic, self._s(recorded_ns), taken_ns, self._decoded(topic, data))

        return each()

    def to_pandas(
        self,
        topic: str,
        start: float | None = None,
        end: float | None = None,
        every: int = 1,
        columns: Iterable[str] | None = None,
    ) -> Any:
        """A pandas frame with a column for each number, such as `command.steer`.

        `columns` keeps those that match a pattern, such as `["header.tick", "command.*"]`. A
        column of arrays holds NumPy arrays.
        """
        pandas = needed("pandas", "pandas frames")
        array, times = self._read(topic, start, end, every)
        found = {name: one if one.ndim == 1 else list(one) for name, one in flat(array, columns).items()}
        return pandas.DataFrame({RECORDED_S: times, **found})

    def to_polars(
        self,
        topic: str,
        start: float | None = None,
        end: float | None = None,
        every: int = 1,
        columns: Iterable[str] | None = None,
    ) -> Any:
        """The same as a Polars frame; arrays are columns of the type `Array`."""
        polars = needed("polars", "Polars frames")
        array, times = self._read(topic, start, end, every)
        found = {RECORDED_S: times, **flat(array, columns)}
        return polars.DataFrame(
            [polars.Series(name, np.ascontiguousarray(one)) for name, one in found.items()]
        )

    def to_arrow(
        self,
        topic: str,
        start: float | None = None,
        end: float | None = None,
        every: int = 1,
        columns: Iterable[str] | None = None,
    ) -> Any:
        """The same as a table of pyarrow; arrays are lists of fixed size."""
        pyarrow = needed("pyarrow", "Arrow tables")
        array, times = self._read(topic, start, end, every)
        return pyarrow.Table.from_batches([arrow_batch(times, array, columns)])

    def features(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """The policy's input for recorded observations, `[count, 259]`.

        `observations` is `recording["observation"]` or `recording["step"]["observation"]`.
        """
        is_current = all(self.topics[name].is_current for name in ("step", "observation") if name in self)
        if not is_current:
            raise RecordingError(
                f"{self.path}: its observations have another layout than this build's; use the "
                f"build that recorded it (commit {self.metadata.get('commit', 'unknown')})"
            )
        made = _vlaps.observation_features(np.ascontiguousarray(observations).tobytes())
        return made.reshape(len(observations), -1)

    def episodes(self, start: float | None = None, end: float | None = None) -> Any:
        """The recorded drives as a `vlaps.Dataset`, with who drove: takeovers become data.

        See `vlaps.episodes.dataset_of`.
        """
        from .episodes import dataset_of

        return dataset_of(self, start, end)

    def fork(self, tick: int, **change: Any) -> dict[str, Any]:
        """Drives on from a tick with the built program; see `vlaps.forking.fork`."""
        from .forking import fork

        return fork(self.path, tick, **change)

    def _s(self, run_ns: int) -> float:
        return (run_ns - self._start_ns) * 1e-9

    def _span(self, start: float | None, end: float | None) -> tuple[int, int]:
        for name, value in (("start", start), ("end", end)):
            if value is not None and not np.isfinite(value):
                raise ValueError(f"{name} = {value}: it must be a number of seconds")
        from_ns = 0 if start is None else self._start_ns + _ns(start)
        to_ns = _END_NS if end is None else self._start_ns + _ns(end)
        if to_ns < 0:
            # Before every message.
            return _END_NS, 0
        return min(max(from_ns, 0), _END_NS), min(to_ns, _END_NS)

    def _names(self, topics: str | Iterable[str]) -> list[str]:
        names = [topics] if isinstance(topics, str) else list(topics)
        for name in names:
            self._topic(name)
        return names

    def _topic(self, name: str) -> Topic:
        try:
            return self.topics[name]
        except KeyError:
            there = ", ".join(self.topics) or "none"
            raise KeyError(f"no topic {name!r} in {self.path}; there are {there}") from None

    def _dtype(self, topic: str) -> np.dtype[Any]:
        try:
            return self._topic(topic).dtype
        except NoFixedSize as error:
            raise TypeError(f"{error}; recording.iterate gives its messages as bytes") from None

    def _decoded(self, topic: str, data: bytes) -> Any:
        if topic not in self._dtypes:
            try:
                self._dtypes[topic] = self.topics[topic].dtype
            except NoFixedSize:
                self._dtypes[topic] = None
        dtype = self._dtypes[topic]
        if dtype is None:
            return data
        _checked(topic, data, dtype)
        return np.frombuffer(data, dtype)[0]

    def _read(
        self, topic: str, start: float | None, end: float | None, every: int
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        dtype = self._dtype(topic)
        span, shape = self._span(start, end), (dtype.itemsize, _positive("every", every))
        data, times = self._file.read(topic, span, shape)
        return data.view(dtype), (times - np.uint64(self._start_ns)).astype(np.float64) * 1e-9


def _ns(seconds: float) -> int:
    """Nanoseconds, at most those of the run's clock."""
    return round(min(max(seconds, -_END_NS * 1e-9), _END_NS * 1e-9) * 1e9)


def _positive(name: str, value: int) -> int:
    if value < 1:
        raise ValueError(f"{name} = {value}: it must be at least 1")
    return value


def _checked(topic: str, data: bytes, dtype: np.dtype[Any]) -> None:
    if len(data) != dtype.itemsize:
        raise RecordingError(
            f"a message of '{topic}' has {len(data)} bytes in place of the {dtype.itemsize} of its "
            "definition; the recording is damaged, or of another program"
        )
