"""Actions and comparisons that several tests use."""

from __future__ import annotations

from typing import Any

import numpy as np

import vlaps

#: Few beams and a short horizon: an episode takes a few milliseconds.
SHORT: dict[str, Any] = {
    "num_scenarios": 20,
    "horizon": 12,
    "vehicle_config": {"lidar": {"num_lasers": 24}},
}


def actions(count: int, steps: int, seed: int = 0) -> np.ndarray:
    """Bounded random actions that mostly go forward, `[steps, count, 2]` float32."""
    drawn = np.random.default_rng(seed).uniform(-1, 1, (steps, count, 2))
    drawn[..., 0] *= 0.3
    drawn[..., 1] = drawn[..., 1] * 0.5 + 0.5
    return drawn.astype(np.float32)


def rollout(env: vlaps.MetaDriveEnv, driven: np.ndarray) -> list[tuple[Any, ...]]:
    """What each step of one environment returns; the observation as bytes."""
    result = []
    for action in driven:
        observation, reward, terminated, truncated, info = env.step(action)
        result.append((observation.tobytes(), reward, terminated, truncated, dict(info)))
        if terminated or truncated:
            break
    return result


def turn_and_go(observations: np.ndarray) -> np.ndarray:
    """A driver as a function: keeps its heading in its lane, `[count, 2]`."""
    steer = 4.0 * (observations[:, 2] - 0.5) + 0.5 * (observations[:, 8] - 0.5)
    return np.stack([np.clip(steer, -1.0, 1.0), np.where(observations[:, 3] < 0.3, 0.4, 0.0)], axis=1)
