"""Options of the environments, with MetaDrive's names and the experiment's values."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

#: Every option with its default. `vehicle_config` and `map_config` are merged key by key.
DEFAULTS: dict[str, Any] = {
    # Episodes: `num_scenarios` seeds from `start_seed` on, or the listed `seeds`.
    "start_seed": 0,
    "num_scenarios": 1,
    "seeds": None,
    "shuffle": False,
    "order_seed": 0,
    # Road: a number of random blocks, or a sequence of block letters such as "SCrRXTO".
    "map": 3,
    "map_config": {"lane_num": 3, "lane_width": 3.5, "exit_length": 50.0},
    # Scene.
    "traffic_density": 0.06,
    "accident_prob": 0.8,
    "horizon": 1500,
    # Ends.
    "out_of_route_done": True,
    "crash_vehicle_done": False,
    "crash_object_done": False,
    # Sensor.
    "vehicle_config": {
        "lidar": {
            "num_lasers": 240,
            "distance": 50.0,
            "gaussian_noise": 0.0,
            "dropout_prob": 0.0,
        }
    },
    # Reward and cost.
    "driving_reward": 1.0,
    "speed_reward": 0.1,
    "success_reward": 10.0,
    "out_of_road_penalty": 5.0,
    "crash_vehicle_penalty": 5.0,
    "crash_object_penalty": 5.0,
    "use_lateral_reward": False,
    "out_of_road_cost": 1.0,
    "crash_vehicle_cost": 1.0,
    "crash_object_cost": 1.0,
}

_REWARD = (
    "driving_reward",
    "speed_reward",
    "success_reward",
    "out_of_road_penalty",
    "crash_vehicle_penalty",
    "crash_object_penalty",
    "use_lateral_reward",
    "out_of_road_cost",
    "crash_vehicle_cost",
    "crash_object_cost",
)


def merged(changes: dict[str, Any], defaults: dict[str, Any] = DEFAULTS) -> dict[str, Any]:
    """The defaults with these changes; an unknown option is a `ValueError` with a hint."""
    unknown = set(changes) - set(defaults)
    if unknown:
        import difflib

        name = sorted(unknown)[0]
        near = difflib.get_close_matches(name, defaults, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown option {name!r}{hint} (options: {', '.join(sorted(defaults))})")
    result = {}
    for key, default in defaults.items():
        value = changes.get(key, default)
        if isinstance(default, dict):
            if not isinstance(value, dict):
                raise ValueError(f"option {key!r} must be a dictionary, not {value!r}")
            value = merged(value, default)
        result[key] = value
    return result


def to_json(config: dict[str, Any], autoreset: str) -> str:
    """The options as the compiled module reads them; numbers out of range raise there."""
    lidar = config["vehicle_config"]["lidar"]
    road = config["map_config"]
    is_sequence = isinstance(config["map"], str)
    seeds: Iterable[int] | None = config["seeds"]
    options = {
        "world": {
            "blocks": 3 if is_sequence else int(config["map"]),
            "block_sequence": config["map"] if is_sequence else "",
            "lane_count": int(road["lane_num"]),
            "lane_width_m": float(road["lane_width"]),
            "exit_length_m": float(road["exit_length"]),
            "traffic_density": float(config["traffic_density"]),
            "accident_probability": float(config["accident_prob"]),
            "horizon_steps": int(config["horizon"]),
            "beam_count": int(lidar["num_lasers"]),
            "lidar_range_m": float(lidar["distance"]),
            "out_of_route": "ends" if config["out_of_route_done"] else "continues",
        },
        "reward": {key: config[key] for key in _REWARD},
        "crash_vehicle_done": bool(config["crash_vehicle_done"]),
        "crash_object_done": bool(config["crash_object_done"]),
        "beam_noise": float(lidar["gaussian_noise"]),
        "beam_dropout": float(lidar["dropout_prob"]),
        "seeds": {
            "first": int(config["start_seed"]),
            "count": int(config["num_scenarios"]),
            "shuffled": bool(config["shuffle"]),
            "order_seed": int(config["order_seed"]),
            "listed": [] if seeds is None else [int(seed) for seed in seeds],
        },
        "autoreset": autoreset,
    }
    return json.dumps(options)
