"""`python -m vlaps.tables`: a recording as Parquet, Arrow, or a dataset of Minari or LeRobot."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .columns import arrow_batch, needed
from .definition import NoFixedSize
from .recording import Recording, Topic

#: Messages of one record batch: of steps about 5 MB.
ROWS = 1024
#: The ending of a table's file until it is whole.
PART = ".part"


def table_file(folder: Path, topic: str, format: str) -> Path:
    """The file of a topic; `health/world` becomes `health.world`."""
    return folder / f"{topic.replace('/', '.')}.{format}"


def write_table(
    recording: Recording,
    topic: str,
    path: str | os.PathLike[str],
    format: str = "parquet",
    start: float | None = None,
    end: float | None = None,
) -> int:
    """Writes the messages of a topic as a Parquet or an Arrow file and returns their number.

    `ROWS` messages at a time are in memory. The file has its name only when it is whole.
    """
    needed("pyarrow", "Parquet and Arrow files")
    path = Path(path)
    part = path.with_name(path.name + PART)
    rows, writer = 0, None
    try:
        for times, array in recording.batches(topic, ROWS, start, end):
            batch = arrow_batch(times, array, None)
            if writer is None:
                writer = _writer(part, batch.schema, format)
            writer.write_batch(batch)
            rows += len(times)
            _progress(f"{topic}: {rows} of {recording.topics[topic].count}")
        if writer is None:
            # No message in this time: a table without rows, which has its columns.
            empty = recording.read(topic, 0.0, -1.0)
            batch = arrow_batch(recording.times(topic, 0.0, -1.0), empty, None)
            writer = _writer(part, batch.schema, format)
        writer.close()
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
        _progress("")
    return rows


def _writer(path: Path, schema: Any, format: str) -> Any:
    if format == "parquet":
        from pyarrow import parquet

        return parquet.ParquetWriter(path, schema, compression="zstd")
    from pyarrow import ipc

    options = ipc.IpcWriteOptions(compression="zstd")
    return ipc.new_file(str(path), schema, options=options)


def _progress(text: str) -> None:
    """One line on a terminal that is overwritten; nothing in a file."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


def _tables(recording: Recording, given: argparse.Namespace) -> None:
    folder = Path(given.out or f"{Path(recording.path).stem}-{given.format}")
    folder.mkdir(parents=True, exist_ok=True)
    for topic in _wanted(recording, given.topic):
        path = table_file(folder, topic.name, given.format)
        # A table has its name only when it is whole.
        if path.exists() and given.keep:
            print(f"{path}: kept")
            continue
        rows = write_table(recording, topic.name, path, given.format, given.start, given.end)
        print(f"{path}: {rows} rows, {path.stat().st_size / 1e6:.2f} MB")


def _wanted(recording: Recording, names: Sequence[str] | None) -> Iterator[Topic]:
    if names:
        for name in names:
            if name not in recording:
                there = ", ".join(recording.topics)
                raise ValueError(f"--topic {name}: the recording has {there}")
            yield recording.topics[name]
        return
    for topic in recording.topics.values():
        try:
            topic.dtype
        except NoFixedSize as error:
            print(f"{topic.name}: left out: {error}")
        else:
            yield topic


def _minari(recording: Recording, given: argparse.Namespace) -> None:
    name = given.out or f"vlaps/{Path(recording.path).stem}-v0"
    data = recording.episodes(given.start, given.end)
    told = recording.metadata
    text = f"{data.driver}: who drove is in the infos as takeover"
    with warnings.catch_warnings():
        # It asks for an e-mail address and an environment, which a recording has not.
        warnings.simplefilter("ignore", UserWarning)
        data.to_minari(name, description=text, author=f"vlaps {told.get('commit', '')}")
    taken = int(data.transitions()["takeover"].sum())
    print(f"{name}: {len(data.episodes)} episodes, {len(data)} steps, {taken} of takeovers")


def _lerobot(recording: Recording, given: argparse.Namespace) -> None:
    folder = given.out or f"{Path(recording.path).stem}-lerobot"
    data = recording.episodes(given.start, given.end)
    path = data.to_lerobot(folder, recording.rate_hz())
    taken = int(data.transitions()["takeover"].sum())
    print(f"{path}: {len(data.episodes)} episodes, {len(data)} frames, {taken} of takeovers")


def _error(text: object) -> str:
    return f"vlaps.tables: {text}"


def main(words: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m vlaps.tables", description=__doc__)
    parser.add_argument("recording", metavar="REC", help="a recording's folder or file")
    parser.add_argument("--format", choices=("parquet", "arrow", "minari", "lerobot"), default="parquet")
    parser.add_argument("--out", help="the folder of tables or of LeRobot's dataset, or the name of Minari's")
    parser.add_argument("--topic", action="append", help="such as step; repeatable; all without it")
    parser.add_argument("--from", dest="start", type=float, help="begin there, s")
    parser.add_argument("--to", dest="end", type=float, help="end there, s")
    parser.add_argument("--keep", action="store_true", help="go on with a call that was stopped")
    given = parser.parse_args(words)
    try:
        recording = Recording(given.recording)
        for line in recording.damage:
            print(f"note: {line}", file=sys.stderr)
        {"minari": _minari, "lerobot": _lerobot}.get(given.format, _tables)(recording, given)
    except (OSError, ValueError, TypeError, ImportError) as error:
        print(_error(error), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(_error("stopped; the tables that are whole stay"), file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
