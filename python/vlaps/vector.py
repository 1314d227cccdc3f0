"""Many environments: `gymnasium.make_vec("vlaps/MetaDrive-c29cc37-v0", num_envs=64)`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from . import _vlaps
from .config import merged, to_json
from .env import _COUNTS, _FLAGS, _NAMES, action_space, checked_seed, observation_space

_MODES = {
    AutoresetMode.SAME_STEP: "same_step",
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.DISABLED: "disabled",
}


class MetaDriveVectorEnv(VectorEnv):
    """Many worlds in one object, stepped by `threads` threads with the same results.

    With `copy=False` the returned arrays are the object's own, and the next call writes
    them again. World k takes the places k, k + n, k + 2n in the order of seeds, so the
    episodes of a world depend on nothing but the options. To share an order of seeds
    between programs, give each its part: `seeds=range(first, last)[part::parts]`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise ValueError("a vector of environments is not rendered: render one environment")
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}: it must be at least 1")
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": [], "render_fps": 10}
        self.render_mode = None
        self.config = merged(options)
        text = to_json(self.config, _MODES[self.autoreset_mode])
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._worlds: _vlaps.Worlds | None = _vlaps.Worlds(text, num_envs, threads or cores)
        self._arrays = self._worlds.arrays()
        self._copy = copy
        self._pending = False
        self._everything = np.ones(num_envs, np.bool_)
        self.single_observation_space = observation_space(self._worlds.features)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _open(self) -> _vlaps.Worlds:
        if self._worlds is None:
            raise RuntimeError("the environments are closed: make others")
        return self._worlds

    def _out(self, name: str) -> NDArray[Any]:
        array = self._arrays[name]
        return array.copy() if self._copy else array

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode in each world, or where `options["reset_mask"]` is true.

        An integer seed N gives world k the seed N + k; a list gives each its own. Without
        a seed each world goes on in the order of seeds.
        """
        worlds = self._open()
        if seed is None:
            seeds = [-1] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            seeds = [checked_seed(int(seed) + k) for k in range(self.num_envs)]
        else:
            if len(seed) != self.num_envs:
                raise ValueError(f"{len(seed)} seeds for {self.num_envs} environments")
            seeds = [-1 if one is None else checked_seed(one) for one in seed]
        mask = (options or {}).get("reset_mask")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
                raise ValueError(f"reset_mask must be a boolean array of the shape ({self.num_envs},)")
            seeds = [one if chosen else -2 for one, chosen in zip(seeds, mask)]
        worlds.reset(seeds)
        return self._out("observation"), self._info(self._arrays["figures"], None)

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Drives all worlds for 0.1 s."""
        self._open().step(np.ascontiguousarray(actions, np.float32))
        arrays = self._arrays
        figures = arrays["figures"]
        ended = None
        if self.autoreset_mode == AutoresetMode.SAME_STEP and arrays["began"].any():
            ended = arrays["began"].copy()
        info = self._info(figures, ended)
        return (
            self._out("observation"),
            self._out("reward"),
            self._out("terminated"),
            self._out("truncated"),
            info,
        )

    def _info(self, figures: NDArray[np.float64], ended: NDArray[np.bool_] | None) -> dict[str, Any]:
        """Gymnasium's vector info: each figure as an array, and beside it its mask."""
        info: dict[str, Any] = {}
        for column, name in enumerate(_NAMES):
            values = figures[:, column]
            if name in _FLAGS:
                values = values != 0.0
            elif name in _COUNTS:
                values = values.astype(np.int64)
            elif self._copy:
                values = values.copy()
            info[name] = values
            info[f"_{name}"] = self._everything
        if ended is None:
            return info
        observations = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(ended):
            observations[index] = self._arrays["final_observation"][index].copy()
        final = dict(info)
        for key in list(final):
            if key.startswith("_"):
                final[key] = ended
        info["final_obs"], info["_final_obs"] = observations, ended
        info["final_info"], info["_final_info"] = final, ended
        return info

    def get_state(self, index: int) -> _vlaps.State:
        """The state of one world; `bytes()` of it can be stored."""
        return self._open().get_state(index)

    def set_state(self, index: int, state: _vlaps.State | bytes) -> None:
        """Puts one world into a state of a world with the same options, bit by bit."""
        self._open().set_state(index, state)

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the worlds and ends their threads."""
        self._worlds = None
