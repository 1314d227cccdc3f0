"""Episodes as a dataset of LeRobot, in its format v3.0.

The format: https://huggingface.co/docs/lerobot/lerobot-dataset-v3. LeRobot itself is not
needed, only pyarrow and pandas.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .columns import needed

if TYPE_CHECKING:
    from .dataset import Dataset, Recorded

VERSION = "v3.0"
#: What the policy is asked to do; LeRobot keeps one text for each frame.
TASK = "drive along the route without touching anything"
#: Where the next file of frames begins, bytes of columns in memory.
FILE_BYTES = 100_000_000
#: Files of a folder.
CHUNK_FILES = 1000
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
#: The ending of the dataset's folder until it is whole.
PART = ".part"


def write_lerobot(data: Dataset, folder: str | os.PathLike[str], fps: int) -> Path:
    """Writes a dataset of LeRobot into a new folder and returns the folder.

    `fps` is the number of steps in a second. A frame is a step: `observation.state` is the
    policy's input, `action` what the world applied, `proposal` what the driver asked for, and
    `takeover` whether another one drove; `next.reward`, `next.cost` and `next.done` are those
    of the step.
    """
    pyarrow = needed("pyarrow", "datasets of LeRobot")
    pandas = needed("pandas", "datasets of LeRobot")
    if fps < 1:
        raise ValueError(f"fps = {fps}: it must be at least 1")
    folder = Path(folder)
    if folder.exists():
        raise FileExistsError(f"{folder}: it exists; give a folder that does not")
    part = folder.with_name(folder.name + PART)
    shutil.rmtree(part, ignore_errors=True)
    try:
        columns = [_columns(number, one, fps) for number, one in enumerate(data.episodes)]
        _indexed(columns)
        rows = list(_episodes(columns, part, pyarrow))
        _table(part / "meta/episodes" / FILE.format(chunk_index=0, file_index=0), pyarrow.Table.from_pylist(rows))
        tasks = pandas.DataFrame({"task_index": [0]}, index=pandas.Index([TASK], name="task"))
        tasks.to_parquet(part / "meta/tasks.parquet")
        whole = {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}
        _json(part / "meta/stats.json", {name: _statistics(column) for name, column in whole.items()})
        _json(part / "meta/info.json", _info(whole, len(columns), fps))
        os.rename(part, folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def _columns(number: int, one: Recorded, fps: int) -> dict[str, NDArray[Any]]:
    """The columns of an episode, `[steps]` or `[steps, length]`."""
    count = len(one.actions)
    done = one.terminated | one.truncated
    # A recording may end before the episode.
    done[-1] = True
    frames = np.arange(count)
    return {
        "observation.state": one.observations[:-1],
        "action": one.actions,
        "proposal": one.proposals,
        "takeover": one.takeover,
        "next.reward": one.rewards.astype(np.float32),
        "next.cost": one.costs.astype(np.float32),
        "next.done": done,
        "timestamp": (frames / fps).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(count, number),
        "task_index": np.zeros(count, np.int64),
    }


def _indexed(columns: list[dict[str, NDArray[Any]]]) -> None:
    """Adds the number of each frame in the dataset."""
    first = 0
    for one in columns:
        one["index"] = first + one["frame_index"]
        first += len(one["frame_index"])


def _episodes(columns: list[dict[str, NDArray[Any]]], folder: Path, pyarrow: Any) -> Iterator[dict[str, Any]]:
    """Writes the frames, an episode as one group of rows, and gives the row of each episode."""
    from pyarrow import parquet

    file, size, writer = -1, FILE_BYTES, None
    try:
        for number, one in enumerate(columns):
            table = pyarrow.table({name: _arrow(column, pyarrow) for name, column in one.items()})
            if size >= FILE_BYTES:
                if writer is not None:
                    writer.close()
                file, size = file + 1, 0
                place = {"chunk_index": file // CHUNK_FILES, "file_index": file % CHUNK_FILES}
                path = folder / "data" / FILE.format(**place)
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = parquet.ParquetWriter(path, table.schema)
            assert writer is not None
            writer.write_table(table)
            size += table.nbytes
            first, count = int(one["index"][0]), len(one["index"])
            row = {
                "episode_index": number,
                "tasks": [TASK],
                "length": count,
                "data/chunk_index": place["chunk_index"],
                "data/file_index": place["file_index"],
                "dataset_from_index": first,
                "dataset_to_index": first + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
            for name, column in one.items():
                told = _statistics(column).items()
                row.update({f"stats/{name}/{what}": value for what, value in told})
            yield row
    finally:
        if writer is not None:
            writer.close()


def _arrow(column: NDArray[Any], pyarrow: Any) -> Any:
    numbers = pyarrow.array(np.ascontiguousarray(column).reshape(-1))
    if column.ndim == 1:
        return numbers
    return pyarrow.FixedSizeListArray.from_arrays(numbers, column.shape[1])


def _statistics(column: NDArray[Any]) -> dict[str, list[Any]]:
    """What LeRobot normalises with."""
    numbers = column.reshape(len(column), -1).astype(np.float64)
    found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
    return {**{name: value.tolist() for name, value in found.items()}, "count": [len(column)]}


def _info(whole: dict[str, NDArray[Any]], episodes: int, fps: int) -> dict[str, Any]:
    pair = ["steer", "pedal"]
    features = {
        name: {
            "dtype": str(column.dtype),
            "shape": list(column.shape[1:]) or [1],
            "names": pair if name in ("action", "proposal") else None,
        }
        for name, column in whole.items()
    }
    return {
        "codebase_version": VERSION,
        "robot_type": "vlaps",
        "total_episodes": episodes,
        "total_frames": len(whole["index"]),
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_BYTES // 1_000_000,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": f"data/{FILE}",
        "video_path": None,
        "features": features,
    }


def _table(path: Path, table: Any) -> None:
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table, path)


def _json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")
