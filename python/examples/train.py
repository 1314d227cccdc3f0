"""Trains a linear policy with the cross-entropy method; needs numpy alone.

    target/python/bin/python python/examples/train.py --generations 20

Each generation drives one episode with each of 64 candidates on the same seed and moves
the distribution of weights towards the best eight. Real training wants more: see
`vlaps.sb3` for PPO.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import vlaps

CANDIDATES = 64
BEST = 8
SECTORS = 16


def features(observation: np.ndarray) -> np.ndarray:
    """Car, road and route, the nearest return of each sector, and a constant."""
    beams = observation[:, 19:].reshape(len(observation), SECTORS, -1).min(axis=2)
    return np.concatenate([observation[:, :19] - 0.5, 1.0 - beams, np.ones((len(beams), 1))], axis=1)


def returns(envs: vlaps.MetaDriveVectorEnv, weights: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return and route completion of each candidate on the episode of a seed."""
    observation, info = envs.reset(seed=[seed] * envs.num_envs)
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, bool)
    while running.any():
        action = np.tanh(np.einsum("nf,nfa->na", features(observation), weights))
        observation, reward, terminated, truncated, info = envs.step(action)
        total += reward * running
        running &= ~(terminated | truncated)
    return total, info["route_completion"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--generations", type=int, default=20)
    parser.add_argument("--horizon", type=int, default=400)
    arguments = parser.parse_args()
    envs = vlaps.MetaDriveVectorEnv(CANDIDATES, autoreset_mode="Disabled", horizon=arguments.horizon)
    random = np.random.default_rng(0)
    size = (20 + SECTORS, 2)
    mean, spread = np.zeros(size), np.full(size, 0.5)
    for generation in range(arguments.generations):
        begun = time.perf_counter()
        weights = mean + spread * random.standard_normal((CANDIDATES, *size))
        total, completion = returns(envs, weights, 1000 + generation)
        best = np.argsort(total)[-BEST:]
        mean, spread = weights[best].mean(axis=0), weights[best].std(axis=0) + 0.02
        print(
            f"generation {generation}: return {total.mean():.1f}, best {total.max():.1f}, "
            f"completion {completion.mean():.2f}, {time.perf_counter() - begun:.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
