"""One environment: `gymnasium.make("vlaps/MetaDrive-c29cc37-v0")`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _vlaps
from .config import merged, to_json

_NAMES: list[str] = _vlaps.Worlds.figure_names()
_FLAGS = frozenset(
    (
        "arrive_dest",
        "out_of_road",
        "max_step",
        "crash_vehicle",
        "crash_object",
        "crash_sidewalk",
        "strict_success",
    )
)
_COUNTS = frozenset(("episode_length", "vehicle_contacts", "object_contacts", "seed"))


def action_space() -> gymnasium.spaces.Box:
    """Steering (positive: left) and pedal (positive: throttle), each in [-1, 1]."""
    return gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)


def observation_space(features: int) -> gymnasium.spaces.Box:
    """MetaDrive's 19 numbers of car, road and route, then one for each beam, in [0, 1]."""
    return gymnasium.spaces.Box(0.0, 1.0, (features,), np.float32)


def figures_to_info(figures: NDArray[np.float64]) -> dict[str, Any]:
    """The info dictionary of one environment's figures."""
    info: dict[str, Any] = {}
    for name, value in zip(_NAMES, figures.tolist()):
        if name in _FLAGS:
            info[name] = bool(value)
        elif name in _COUNTS:
            info[name] = int(value)
        else:
            info[name] = value
    return info


class MetaDriveEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """MetaDrive's driving task, one car.

    Options are keywords with MetaDrive's names: see `vlaps.DEFAULTS`. Without a seed,
    `reset` begins the next episode in the order of seeds; `reset(seed=N)` begins episode
    N, which is the same on every machine. `info` holds cost, terms of the reward, route
    completion (a success has 0.98 to 0.99), contacts so far and the strict success
    (arrived, and nothing touched).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r}: choose from {self.metadata['render_modes']}")
        self.render_mode = render_mode
        self.config = merged(options)
        self._worlds: _vlaps.Worlds | None = _vlaps.Worlds(to_json(self.config, "disabled"), 1, 1)
        arrays = self._worlds.arrays()
        self._observation = arrays["observation"][0]
        self._reward = arrays["reward"]
        self._terminated = arrays["terminated"]
        self._truncated = arrays["truncated"]
        self._figures = arrays["figures"][0]
        self._running = False
        self._action = np.zeros((1, 2), np.float32)
        self.action_space = action_space()
        self.observation_space = observation_space(self._worlds.features)

    def _open(self) -> _vlaps.Worlds:
        if self._worlds is None:
            raise RuntimeError("the environment is closed: make another one")
        return self._worlds

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode: that of `seed`, or the next one in the order of seeds."""
        super().reset(seed=seed)
        self._open().reset([-1 if seed is None else checked_seed(seed)])
        self._running = True
        return self._observation.copy(), figures_to_info(self._figures)

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drives for 0.1 s."""
        worlds = self._open()
        if not self._running:
            raise RuntimeError("no episode runs: call reset first")
        action = np.asarray(action, np.float32)
        if action.shape != (2,):
            raise ValueError(f"action has the shape {action.shape}: it must be (2,), steering and pedal")
        self._action[0] = action
        worlds.step(self._action)
        terminated, truncated = bool(self._terminated[0]), bool(self._truncated[0])
        self._running = not (terminated or truncated)
        info = figures_to_info(self._figures)
        return self._observation.copy(), float(self._reward[0]), terminated, truncated, info

    def get_state(self) -> _vlaps.State:
        """The state of the episode; `bytes()` of it can be stored."""
        return self._open().get_state(0)

    def set_state(self, state: _vlaps.State | bytes) -> None:
        """Goes to a state of an environment with the same options, bit by bit."""
        self._open().set_state(0, state)
        self._running = True

    def close(self) -> None:
        """Frees the world; may be called again."""
        self._worlds = None


def checked_seed(seed: int) -> int:
    """The seed as the compiled module takes it."""
    seed = int(seed)
    if not 0 <= seed < 2**63:
        raise ValueError(f"seed {seed}: it must be between 0 and 2**63 - 1")
    return seed
