"""One environment: `gymnasium.make("vlaps/MetaDrive-c29cc37-v0")`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _vlaps
from .config import merged, to_json
from .window import Window, has_display

ASSESSMENTS: list[str] = _vlaps.Worlds.assessment_names()
#: Verdicts of an assessment by their codes.
VERDICTS = ("absent", "clear", "leaves", "hits")
EXPERTS = ("idm",)


def action_space() -> gymnasium.spaces.Space[NDArray[np.float32]]:
    """Steering (positive: left) and pedal (positive: throttle), each in [-1, 1]."""
    box: Any = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    return box  # type: ignore[no-any-return]


def observation_space(features: int) -> gymnasium.spaces.Space[NDArray[np.float32]]:
    """MetaDrive's 19 numbers of car, road and route, then one for each beam, in [0, 1]."""
    box: Any = gymnasium.spaces.Box(0.0, 1.0, (features,), np.float32)
    return box  # type: ignore[no-any-return]


def checked_seed(seed: int) -> int:
    """The seed as the compiled module takes it."""
    seed = int(seed)
    if not 0 <= seed < 2**63:
        raise ValueError(f"seed {seed}: it must be between 0 and 2**63 - 1")
    return seed


def check_expert(method: str) -> None:
    """Raises `ValueError` for an expert that does not exist."""
    if method not in EXPERTS:
        raise ValueError(f"expert {method!r}: choose from {', '.join(EXPERTS)}")


def one_action(action: ArrayLike) -> list[float]:
    """Steering and pedal, rounded as a vector of environments rounds them."""
    array = np.asarray(action, np.float32)
    if array.shape != (2,):
        raise ValueError(f"action has the shape {array.shape}: it must be (2,), steering and pedal")
    numbers: list[float] = array.tolist()
    return numbers


class MetaDriveEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """MetaDrive's driving task, one car.

    Options are keywords with MetaDrive's names: see `vlaps.DEFAULTS`. Without a seed,
    `reset` begins the next episode in the order of seeds; `reset(seed=N)` begins episode
    N, which is the same on every machine, and puts the order back to its beginning. `info` holds cost, terms of the reward, route
    completion (a success has 0.98 to 0.99), contacts so far and the strict success
    (arrived, and nothing touched).

    `render_view` is "top_down" or "ego" (over the driver's seat); `render_size` is width and height in pixels.
    """

    metadata = {
        "render_modes": ["rgb_array", "human"] if has_display() else ["rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        render_mode: str | None = None,
        render_view: str = "top_down",
        render_size: tuple[int, int] = (640, 480),
        **options: Any,
    ) -> None:
        if render_mode not in (None, "rgb_array", "human"):
            raise ValueError(f"render_mode {render_mode!r}: choose from rgb_array, human")
        self.render_mode = render_mode
        self._window = Window(render_size) if render_mode == "human" else None
        self._view = (render_view, render_size)
        self.config = merged(options)
        self._world: _vlaps.World | None = _vlaps.World(to_json(self.config))
        self.action_space = action_space()
        self.observation_space = observation_space(self._world.features)

    def _open(self) -> _vlaps.World:
        if self._world is None:
            raise RuntimeError("the environment is closed: make another one")
        return self._world

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode: that of `seed`, or the next one in the order of seeds."""
        super().reset(seed=seed)
        result = self._open().reset(None if seed is None else checked_seed(seed))
        self._show()
        return result

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drives for 0.1 s."""
        steer, pedal = one_action(action)
        result = (self._world or self._open()).step(steer, pedal)
        if self._window is not None:
            self._show()
        return result

    def render(self) -> NDArray[np.uint8] | None:
        """The picture as `[height, width, 3]`; in a window, the window is renewed."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render_mode: make with render_mode="rgb_array"')
            return None
        if self._window is not None:
            self._show()
            return None
        return self._open().render(*self._view)

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self._open().render(*self._view))

    def expert(self, method: str = "idm") -> NDArray[np.float32]:
        """The action of an expert in the present state.

        "idm" is MetaDrive's own traffic driver in the place of the car. It sees the true
        state and has a memory, so ask it once in each step.
        """
        check_expert(method)
        return np.array(self._open().advise(), np.float32)

    def judge(self, action: ArrayLike) -> dict[str, Any]:
        """The assessment of an action, held for 1.5 s from the present state.

        `clearance_m`, `edge_m`: least distance to an obstacle and to the road's edge;
        `safe_s`: time until contact or exit; `progress_m` towards the next checkpoint;
        `verdict`: "clear", "leaves" or "hits"; `veto`: only the brake helps now.
        """
        numbers = self._open().judge(*one_action(action))
        measured: dict[str, Any] = dict(zip(ASSESSMENTS, numbers))
        measured["verdict"] = VERDICTS[int(measured["verdict"])]
        measured["veto"] = bool(measured["veto"])
        return measured

    def get_state(self) -> _vlaps.State:
        """The state of the episode; `bytes()` of it can be stored."""
        return self._open().get_state()

    def set_state(self, state: _vlaps.State | bytes) -> NDArray[np.float32]:
        """Goes to a state of an environment with the same options, bit by bit; returns its
        observation."""
        return self._open().set_state(state)

    def close(self) -> None:
        """Frees the world and closes the window; may be called again."""
        self._world = None
        if self._window is not None:
            self._window.close()
