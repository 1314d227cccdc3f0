"""Many environments: `gymnasium.make_vec("vlaps/MetaDrive-c29cc37-v0", num_envs=64)`."""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from . import _vlaps
from .config import expert_json, is_whole, listed, merged, to_json, whole
from .env import (
    ASSESSMENTS,
    VERDICTS,
    action_space,
    check_expert,
    checked_view,
    observation_space,
)
from .takeover import Decided, Takeover, driver_names

_REALS, _COUNTS, _FLAGS = _vlaps.Worlds.figure_names()
_NAMES = _REALS + _COUNTS + _FLAGS
_VERDICTS = np.array(VERDICTS)

#: Observations, rewards, terminated, truncated.
Outputs = tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]
#: Observations, rewards, terminated, truncated, info.
Stepped = tuple[
    NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
]


def _cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _mode(name: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(name)
    except ValueError:
        names = ", ".join(mode.value for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode {name!r}: choose from {names}") from None


class MetaDriveVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many worlds in one object, stepped by `threads` threads with the same results.

    With `copy=False` the returned arrays, those of `info` included, are views that the next
    call overwrites. World k takes the positions k, k + n, k + 2n, ... in the order of seeds,
    so that the episodes of a world depend only on the options. To split the seeds between
    programs, pass each its part: `seeds=range(first, last)[part::parts]`.

    `info` contains each figure of the step as an array over the worlds. In the same-step
    mode, the figures of a world whose episode ended are those of the ended episode, as in
    `info["final_info"]`.

    `takeover` and `expert_config` are those of `MetaDriveEnv`. A step with a takeover rule
    adds "proposal" and "applied" `[num_envs, 2]`, "expert" (NaN where it was not asked),
    "driver" and "takeover" to `info`. In the next-step mode, a step that only begins an
    episode has no driver: its mask "_driver" is false.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        render_view: str = "top_down",
        render_size: tuple[int, int] = (640, 480),
        takeover: Takeover | str | None = None,
        expert_config: dict[str, Any] | None = None,
        **options: Any,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r}: a vector of environments supports only rgb_array")
        self.num_envs = num_envs = whole("num_envs", num_envs, 1)
        self.autoreset_mode = _mode(autoreset_mode)
        self._ends_in_step = self.autoreset_mode == AutoresetMode.SAME_STEP
        self.metadata = {
            "autoreset_mode": self.autoreset_mode,
            "render_modes": ["rgb_array"],
            "render_fps": 10,
        }
        self.render_mode = render_mode
        self._view = checked_view(render_view, render_size)
        self.config = merged(options)
        self._worlds: _vlaps.Worlds | None = _vlaps.Worlds(
            to_json(self.config),
            expert_json(expert_config),
            self.autoreset_mode.value,
            num_envs,
            _cores() if threads is None else whole("threads", threads, 1),
        )
        self._takeover = Takeover.of(takeover)
        arrays = self._worlds.arrays()
        self._observation, self._final_observation = arrays["observations"]
        reward, *reals = arrays["reals"]
        terminated, truncated, self._began, *flags = arrays["flags"]
        # The outputs as they are, for copy=False: each call writes them anew.
        self._outputs = (self._observation, reward, terminated, truncated)
        self._written = dict(zip(_NAMES, (*reals, *arrays["counts"], *flags)))
        self._copy = copy
        self._executor: ThreadPoolExecutor | None = None
        self._process = os.getpid()
        self._sent: Future[Decided | None] | None = None
        self._all = everything = np.ones(num_envs, np.bool_)
        self._masks = {f"_{name}": everything for name in _NAMES}
        self._shown = {**self._masks, **self._written}
        self.single_observation_space = observation_space(self._worlds.features)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _open(self) -> _vlaps.Worlds:
        if self._worlds is None:
            raise RuntimeError("the environments are closed: make new ones")
        if self._sent is not None:
            raise RuntimeError("a step was sent: call recv before anything else")
        return self._worlds

    def _shown_now(self) -> tuple[Outputs, dict[str, Any]]:
        """The outputs of the last step; each figure as an array over the worlds, with its mask."""
        if not self._copy:
            return self._outputs, self._shown.copy()
        observation, reward, terminated, truncated = self._outputs
        outputs = (observation.copy(), reward.copy(), terminated.copy(), truncated.copy())
        figures = {name: figure.copy() for name, figure in self._written.items()}
        return outputs, {**self._masks, **figures}

    def reset(
        self,
        *,
        seed: int | Iterable[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode in each world, or only where `options["reset_mask"]` is true.

        An integer seed N gives world k the seed N + k; a list has one seed per world.
        Without a seed each world continues in the order of seeds.
        """
        worlds = self._open()
        if seed is None:
            seeds = [-1] * self.num_envs
        elif is_whole(seed):
            seeds = [whole("seed", int(seed) + k) for k in range(self.num_envs)]
        else:
            each = listed("seed", seed)
            if len(each) != self.num_envs:
                raise ValueError(f"{len(each)} seeds for {self.num_envs} environments")
            seeds = [-1 if one is None else whole("seed", one) for one in each]
        if not isinstance(options, dict | None):
            raise TypeError(f"options = {options!r}: it must be a dictionary, such as with 'reset_mask'")
        mask = (options or {}).get("reset_mask")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.shape != (self.num_envs,):
                raise ValueError(f"reset_mask must be a boolean array of the shape ({self.num_envs},)")
            mask = self._marks("reset_mask", mask)
            seeds = [one if chosen else -2 for one, chosen in zip(seeds, mask)]
        worlds.reset(seeds)
        outputs, info = self._shown_now()
        return outputs[0], info

    def step(self, actions: ArrayLike, takeover: ArrayLike | None = None) -> Stepped:
        """Drives all worlds for 0.1 s.

        `takeover` replaces the takeover rule for this step: a boolean for each world, or
        one for all, that says whether the expert drives.
        """
        worlds = self._open()
        driven = self._drive(worlds, np.ascontiguousarray(actions, np.float32), takeover)
        return self._stepped(driven)

    def send(self, actions: ArrayLike, takeover: ArrayLike | None = None) -> None:
        """Begins a step on another thread and returns immediately. What is wrong with the
        numbers, `recv` raises."""
        worlds = self._open()
        if self._executor is None or self._process != os.getpid():
            # A thread does not survive a fork.
            self._process = os.getpid()
            self._executor = ThreadPoolExecutor(1, thread_name_prefix="vlaps-send")
        # The caller may overwrite its array before the step has read it.
        copied = np.array(actions, np.float32, order="C")
        self._check_shape(copied)
        if takeover is not None:
            takeover = self._marks("takeover", takeover).copy()
        self._sent = self._executor.submit(self._drive, worlds, copied, takeover)

    def recv(self) -> Stepped:
        """Waits for the step that was sent, and returns its result."""
        if self._sent is None:
            raise RuntimeError("no step was sent: call send first")
        sent, self._sent = self._sent, None
        if self._process != os.getpid():
            raise RuntimeError("the step was sent before a fork: its result is in the other process")
        return self._stepped(sent.result())

    def _drive(
        self, worlds: _vlaps.Worlds, actions: NDArray[np.float32], takeover: ArrayLike | None
    ) -> Decided | None:
        if takeover is None and self._takeover is None:
            worlds.step(actions)
            return None
        asked = None if takeover is None else self._marks("takeover", takeover)
        self._check_shape(actions)
        driving = ~worlds.ended()
        rule = self._takeover or Takeover()
        decided = rule.decide(actions.copy(), driving, asked, worlds.advise, worlds.judge)
        worlds.step(decided.applied)
        return decided

    def _check_shape(self, actions: NDArray[np.float32]) -> None:
        if actions.shape != (self.num_envs, 2):
            raise ValueError(
                f"actions have the shape {actions.shape}: it must be ({self.num_envs}, 2), "
                "steering and pedal"
            )

    def _marks(self, name: str, given: ArrayLike) -> NDArray[np.bool_]:
        """Checks a boolean per world, or one for all; returns one per world."""
        marks = np.asarray(given)
        if marks.dtype != np.bool_ or marks.shape not in ((), (self.num_envs,)):
            raise ValueError(f"{name} must be a boolean array of the shape ({self.num_envs},)")
        return np.broadcast_to(marks, (self.num_envs,))

    def _stepped(self, decided: Decided | None) -> Stepped:
        """The results of a step, with Gymnasium's vector info."""
        outputs, info = self._shown_now()
        if decided is not None:
            shown = {
                "proposal": decided.proposal,
                "applied": decided.applied,
                "expert": decided.expert,
                "takeover": decided.taken,
                "driver": driver_names(decided.taken),
            }
            info.update(shown)
            info.update((f"_{name}", decided.driving) for name in shown)
        if not (self._ends_in_step and self._began.any()):
            return (*outputs, info)
        ended = self._began.copy()
        observations = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(ended):
            observations[index] = self._final_observation[index].copy()
        final = {name: ended if name.startswith("_") else values for name, values in info.items()}
        info["final_obs"], info["_final_obs"] = observations, ended
        info["final_info"], info["_final_info"] = final, ended
        return (*outputs, info)

    def seeds(self) -> NDArray[np.int64]:
        """The seed of the current episode in each world. In the same-step mode,
        `info["seed"]` may differ: it is the seed of the episode that the step drove."""
        return np.array(self._open().seeds(), np.int64)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each world."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render_mode: make with render_mode="rgb_array"')
            return None
        worlds = self._open()
        return tuple(worlds.render(index, *self._view) for index in range(self.num_envs))

    def expert(self, method: str = "idm", mask: ArrayLike | None = None) -> NDArray[np.float32]:
        """The actions of an expert, `[num_envs, 2]`, in the worlds where `mask` is true; NaN
        in the others. See `MetaDriveEnv.expert`."""
        check_expert(method)
        marks = self._all if mask is None else self._marks("mask", mask)
        return self._open().advise(method, marks)

    def judge(self, actions: ArrayLike) -> dict[str, NDArray[Any]]:
        """The assessment of one action per world; see `MetaDriveEnv.judge`."""
        numbers = self._open().judge(np.ascontiguousarray(actions, np.float32))
        measured: dict[str, NDArray[Any]] = {
            name: numbers[:, column] for column, name in enumerate(ASSESSMENTS)
        }
        measured["verdict"] = _VERDICTS[measured["verdict"].astype(np.int64)]
        measured["veto"] = measured["veto"] != 0.0
        return measured

    def get_state(self, index: int) -> _vlaps.State:
        """The state of one world; `bytes()` of it can be stored."""
        return self._open().get_state(self._place(index))

    def _place(self, index: int) -> int:
        if not is_whole(index):
            raise TypeError(f"environment {index!r}: it must be a whole number")
        if not 0 <= index < self.num_envs:
            raise IndexError(f"environment {index}: there are {self.num_envs}, counted from 0")
        return index

    def set_state(self, index: int, state: _vlaps.State | bytes) -> NDArray[np.float32]:
        """Restores in one world a state of a world with the same options, bit by bit;
        returns its observation."""
        self._open().set_state(self._place(index), state)
        observation: NDArray[np.float32] = self._observation[index].copy()
        return observation

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the worlds and ends their threads."""
        if self._executor is not None and self._process == os.getpid():
            self._executor.shutdown(wait=True)
        self._worlds = self._sent = None
