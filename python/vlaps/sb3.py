"""The environments for Stable-Baselines3.

>>> from stable_baselines3 import PPO
>>> from vlaps.sb3 import VlapsVecEnv
>>> env = VlapsVecEnv(num_envs=64, start_seed=1000, num_scenarios=1000)
>>> PPO("MlpPolicy", env, n_steps=128).learn(1_000_000)
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv
except ImportError as error:
    raise ImportError("vlaps.sb3 needs Stable-Baselines3: pip install stable-baselines3") from error

from .vector import MetaDriveVectorEnv

#: The worlds that a call applies to; None: all.
Indices = None | int | Iterable[int]


class VlapsVecEnv(VecEnv):
    """A `VecEnv` of many worlds; the keywords are those of `MetaDriveVectorEnv`.

    The info of a step contains "cost" and, with a takeover rule, the keys that
    `MetaDriveVectorEnv` adds for it. The info of an episode's last step contains all
    figures of `MetaDriveVectorEnv` and the keys that Stable-Baselines3 reads:
    "terminal_observation", "TimeLimit.truncated", "is_success", and "episode" as from its
    `VecMonitor`.
    """

    def __init__(self, num_envs: int = 1, **options: Any) -> None:
        self.env = MetaDriveVectorEnv(
            num_envs, autoreset_mode=AutoresetMode.SAME_STEP, copy=True, **options
        )
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        self._begun = time.time()
        super().__init__(num_envs, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Begins an episode in each world."""
        observation, info = self.env.reset(seed=self._seeds)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self.reset_infos = [{"seed": int(seed)} for seed in info["seed"]]
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Begins a step and returns immediately."""
        self.env.send(actions)

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], list[dict[str, Any]]]:
        """Waits for the step; returns observations (of the next episode where one ended),
        rewards, dones and infos."""
        observation, reward, terminated, truncated, info = self.env.recv()
        done = terminated | truncated
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [
            {"cost": cost, "TimeLimit.truncated": False} for cost in info["cost"].tolist()
        ]
        if "driver" in info:
            for name in ("proposal", "applied", "expert", "driver", "takeover"):
                for one, value in zip(infos, info[name]):
                    one[name] = value
        for index in np.flatnonzero(done):
            infos[index] = self._end(int(index), info, bool(truncated[index]))
        return observation, reward, done, infos

    def _end(self, index: int, info: dict[str, Any], truncated: bool) -> dict[str, Any]:
        """The info of an episode's last step."""
        final = info["final_info"].items()
        ended = {name: values[index] for name, values in final if name[0] != "_"}
        ended = {
            name: value if isinstance(value, np.ndarray) else value.item()
            for name, value in ended.items()
        }
        ended["terminal_observation"] = info["final_obs"][index]
        ended["TimeLimit.truncated"] = truncated
        ended["is_success"] = ended["arrive_dest"]
        ended["episode"] = {
            "r": float(self._returns[index]),
            "l": int(self._lengths[index]),
            "t": round(time.time() - self._begun, 6),
        }
        self._returns[index], self._lengths[index] = 0.0, 0
        return ended

    def close(self) -> None:
        """Frees the worlds."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each world, with `render_mode="rgb_array"`."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute; all worlds share it."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Always raises `AttributeError`: the worlds have no separate attributes."""
        raise AttributeError(f"{attr_name}: the worlds share their options; make a new VlapsVecEnv")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls `get_state` or `set_state` of some worlds."""
        if method_name not in ("get_state", "set_state"):
            raise AttributeError(f"{method_name}: call it as .env.{method_name}, for all worlds")
        call = getattr(self.env, method_name)
        return [call(index, *method_args, **method_kwargs) for index in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """True for "Monitor", whose function is built in; false for all other wrappers."""
        is_monitor = wrapper_class.__name__ == "Monitor"
        return [is_monitor for _ in self._get_indices(indices)]
