"""Recorded drives as episodes: what a learner takes, with who drove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._vlaps import RecordingError, words
from .dataset import Dataset, Recorded

if TYPE_CHECKING:
    from .recording import Recording

#: What a step is joined by with the progress that the world told.
_KEY = ("producer", "episode", "tick")


def dataset_of(recording: Recording, start: float | None = None, end: float | None = None) -> Dataset:
    """The steps of a recording as episodes.

    - An observation is the policy's input, an action the command that was sent.
    - `proposals` are the policy's, where it proposed; otherwise the command.
    - `takeover` is true where the policy did not drive.
    - A reward is the metres of the route driven since the step before, a cost is 1 where
      something was touched. Both are from the world's progress; without it they are 0.
    - The last step is `terminated` when the car arrived or left the road, `truncated` when the
      time was over or the recording ends.

    A tick that was skipped or not recorded ends an episode, which is then truncated.
    """
    if "step" not in recording:
        raise RecordingError(f"{recording.path}: it has no topic 'step', of which episodes are made")
    steps = recording.read("step", start, end)
    # Without an observation there is nothing to learn from.
    steps = steps[steps["observation_age_ns"] != np.uint64(2**64 - 1)]
    driver = {word: code for code, word in words()["Driver"].items()}["policy"]
    progress = _progress(recording, start, end)
    episodes = []
    for part in _parts(steps):
        # The last step has no successor.
        if len(part) > 1:
            episodes.append(_episode(recording, part, driver, progress))
    if not episodes:
        raise RecordingError(f"{recording.path}: no two successive steps with an observation")
    return Dataset(f"recording of {recording.metadata['run']}", None, episodes)


def _parts(steps: NDArray[Any]) -> list[NDArray[Any]]:
    """Steps of one episode and world, tick after tick."""
    if not len(steps):
        return []
    header, seen = steps["header"], steps["observation"]["header"]
    goes_on = header["tick"][1:] == header["tick"][:-1] + 1
    for name in ("producer", "episode"):
        goes_on &= seen[name][1:] == seen[name][:-1]
    # One observation twice is no transition.
    goes_on &= seen["sequence"][1:] > seen["sequence"][:-1]
    return np.split(steps, np.flatnonzero(~goes_on) + 1)


def _progress(
    recording: Recording, start: float | None, end: float | None
) -> dict[tuple[int, ...], NDArray[Any]]:
    if "progress" not in recording:
        return {}
    rows = recording.read("progress", start, end)
    return {_key(row["header"]): row for row in rows}


def _key(header: Any) -> tuple[int, ...]:
    return tuple(int(header[name]) for name in _KEY)


def _episode(
    recording: Recording,
    steps: NDArray[Any],
    policy: int,
    progress: dict[tuple[int, ...], NDArray[Any]],
) -> Recorded:
    count = len(steps) - 1
    told = [progress.get(_key(header)) for header in steps["observation"]["header"]]
    rewards, costs = np.zeros(count), np.zeros(count)
    for k, (before, after) in enumerate(zip(told, told[1:])):
        if before is not None and after is not None:
            rewards[k] = (after["completion"] - before["completion"]) * after["route_m"]
            touched = sum(int(after[name]) - int(before[name]) for name in ("vehicle_contacts", "object_contacts"))
            costs[k] = float(touched > 0)
    command, proposed = steps["command"][:-1], steps["policy"][:-1]
    actions = _pairs(command)
    is_there = (proposed["present"] == 1)[:, None]
    terminated, truncated = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    outcome = _outcome(recording, steps)
    terminated[-1] = outcome in ("arrived", "out_of_road")
    truncated[-1] = not terminated[-1]
    known = [row for row in told if row is not None]
    return Recorded(
        seed=int(known[0]["seed"]) if known else 0,
        observations=recording.features(steps["observation"]),
        actions=actions,
        rewards=rewards,
        costs=costs,
        terminated=terminated,
        truncated=truncated,
        proposals=np.where(is_there, _pairs(proposed), actions),
        takeover=command["driver"] != policy,
    )


def _pairs(action: NDArray[Any]) -> NDArray[np.float32]:
    return np.stack([action["steer"], action["pedal"]], axis=1).astype(np.float32)


def _outcome(recording: Recording, steps: NDArray[Any]) -> str:
    """How the episode ended, if these are its last steps."""
    if "episode" not in recording:
        return "driving"
    last = steps[-1]["observation"]["header"]
    for row in recording["episode"]:
        header = row["header"]
        same = header["producer"] == last["producer"] and header["episode"] == last["episode"]
        # The world may move on for a tick after the last step.
        if same and int(header["tick"]) - int(last["tick"]) <= 2:
            return words()["Outcome"][int(row["outcome"])]
    return "driving"
