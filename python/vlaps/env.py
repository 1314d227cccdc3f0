"""One environment: `gymnasium.make("vlaps/MetaDrive-c29cc37-v0")`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _vlaps
from .config import expert_json, is_whole, merged, to_json, whole
from .takeover import Takeover, driver_names
from .window import Window, has_display

ASSESSMENTS: list[str] = _vlaps.Worlds.assessment_names()
#: Verdicts of an assessment by their codes.
VERDICTS = ("absent", "clear", "leaves", "hits")
#: The experts: MetaDrive's traffic driver, and the stack's planner and controller, named by
#: the planning method.
EXPERTS = ("idm", "rrt-star", "informed", "kinodynamic", "mpc")
VIEWS = ("top_down", "ego")
#: Most pixels of a picture's side.
_SIDE_MAX_PX = 8192


def action_space() -> gymnasium.spaces.Space[NDArray[np.float32]]:
    """Steering (positive: left) and pedal (positive: throttle), each in [-1, 1]."""
    box: Any = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    return box  # type: ignore[no-any-return]


def observation_space(features: int) -> gymnasium.spaces.Space[NDArray[np.float32]]:
    """MetaDrive's 19 numbers of car, road and route, then one per lidar beam, in [0, 1]."""
    box: Any = gymnasium.spaces.Box(0.0, 1.0, (features,), np.float32)
    return box  # type: ignore[no-any-return]


def checked_view(view: str, size: Sequence[int]) -> tuple[str, tuple[int, int]]:
    """Checks `render_view` and `render_size`."""
    if view not in VIEWS:
        raise ValueError(f"render_view {view!r}: choose from {', '.join(VIEWS)}")
    is_pair = isinstance(size, Sequence) and len(size) == 2 and all(map(is_whole, size))
    if not is_pair or not all(1 <= side <= _SIDE_MAX_PX for side in size):
        raise ValueError(
            f"render_size = {size!r}: it must be width and height, whole numbers between 1 and "
            f"{_SIDE_MAX_PX} pixels"
        )
    return view, (int(size[0]), int(size[1]))


def check_expert(method: str) -> None:
    """Raises `ValueError` for an expert that does not exist."""
    if method not in EXPERTS:
        raise ValueError(f"expert {method!r}: choose from {', '.join(EXPERTS)}")


def one_action(action: ArrayLike) -> list[float]:
    """Steering and pedal, rounded to float32 as in a vector of environments."""
    if action is None:
        raise TypeError("action is None: pass [steering, pedal]")
    array = np.asarray(action, np.float32)
    if array.shape != (2,):
        raise ValueError(f"action has the shape {array.shape}: it must be (2,), steering and pedal")
    numbers: list[float] = array.tolist()
    return numbers


class MetaDriveEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """MetaDrive's driving task, one car.

    Options are keywords with MetaDrive's names: see `vlaps.DEFAULTS`. Without a seed,
    `reset` begins the next episode in the order of seeds; `reset(seed=N)` begins episode
    N, which is the same on every machine, and restarts the order of seeds. `info` contains
    the cost, the terms of the reward, the route completion (a success has 0.98 to 0.99),
    the contacts so far and the strict success (arrived without any contact).

    `expert_config` changes the configuration of the experts, section by section, as in
    `{"mpc": {"speed_mps": 5.0}}`. `takeover` is the rule by which an expert drives instead
    of the proposal: see `vlaps.Takeover`.

    `render_view` is "top_down" or "ego" (from the driver's seat); `render_size` is width and
    height in pixels.
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
        takeover: Takeover | str | None = None,
        expert_config: dict[str, Any] | None = None,
        **options: Any,
    ) -> None:
        if render_mode not in (None, "rgb_array", "human"):
            raise ValueError(f"render_mode {render_mode!r}: choose from rgb_array, human")
        self.render_mode = render_mode
        self._view = checked_view(render_view, render_size)
        self._window = Window(self._view[1]) if render_mode == "human" else None
        self.config = merged(options)
        self._takeover = Takeover.of(takeover)
        self._world: _vlaps.World | None = _vlaps.World(
            to_json(self.config), expert_json(expert_config)
        )
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
        seed = None if seed is None else whole("seed", seed)
        super().reset(seed=seed)
        result = self._open().reset(seed)
        self._show()
        return result

    def step(
        self, action: ArrayLike, takeover: bool | None = None
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drives for 0.1 s.

        `takeover` says whether the expert drives; it replaces the environment's rule for
        this step. With a rule or with `takeover`, `info` also contains "proposal",
        "applied", "expert" (NaN if it was not asked), "driver" and "takeover".
        """
        steer, pedal = one_action(action)
        world = self._world or self._open()
        if takeover is None and self._takeover is None:
            result = world.step(steer, pedal)
        else:
            result = self._step_with_expert(world, (steer, pedal), takeover)
        if self._window is not None:
            self._show()
        return result

    def _step_with_expert(
        self, world: _vlaps.World, proposal: tuple[float, float], wanted: bool | None
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        if not isinstance(wanted, (bool, np.bool_, type(None))):
            raise ValueError(f"takeover must be True, False or None, not {wanted!r}")
        marks = None if wanted is None else np.array([wanted], np.bool_)
        rule = self._takeover or Takeover()
        decided = rule.decide(
            np.array([proposal], np.float32),
            np.ones(1, np.bool_),
            marks,
            lambda method, _: np.array([world.advise(method)], np.float32),
            lambda _: np.array([world.judge(*proposal)]),
        )
        result = world.step(*decided.applied[0].tolist())
        info = result[4]
        info["proposal"], info["applied"] = decided.proposal[0], decided.applied[0]
        info["expert"], info["takeover"] = decided.expert[0], bool(decided.taken[0])
        info["driver"] = str(driver_names(decided.taken)[0])
        return result

    def render(self) -> NDArray[np.uint8] | None:
        """The picture as `[height, width, 3]`; with a window, updates it and returns None."""
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

        "idm" is MetaDrive's traffic driver, applied to the ego car. It sees the true state
        and has memory, so ask it once per step. "rrt-star", "informed", "kinodynamic" and
        "mpc" are planner and controller of the stack with that planning method. They see
        the observation (without noise) and have no memory: the same state always has the
        same answer.
        """
        check_expert(method)
        return np.array(self._open().advise(method), np.float32)

    def judge(self, action: ArrayLike) -> dict[str, Any]:
        """The assessment of an action, held for 1.5 s from the present state.

        `clearance_m`, `edge_m`: smallest distance to an obstacle and to the road's edge;
        `safe_s`: time until a contact or until the car leaves the road; `progress_m`:
        progress towards the next checkpoint; `verdict`: "clear", "leaves" or "hits";
        `veto`: the safety check forbids the action.
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
        """Restores a state of an environment with the same options, bit by bit; returns its
        observation."""
        return self._open().set_state(state)

    def close(self) -> None:
        """Frees the world and closes the window; further calls do nothing."""
        self._world = None
        if self._window is not None:
            self._window.close()
