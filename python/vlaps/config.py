"""Options of the environments: MetaDrive's names, with the experiment's values as defaults."""

from __future__ import annotations

import difflib
import json
import math
import numbers
from typing import Any

#: Every option with its default. `vehicle_config` and `map_config` are merged key by key.
DEFAULTS: dict[str, Any] = {
    # Episodes: `num_scenarios` seeds from `start_seed` on, or the listed `seeds`.
    "start_seed": 0,
    "num_scenarios": 1,
    "seeds": None,
    "shuffle": False,
    "order_seed": 0,
    # Map: the number of random blocks, or a sequence of block letters such as "SCrRXTO".
    "map": 3,
    "map_config": {"lane_num": 3, "lane_width": 3.5, "exit_length": 50.0},
    # Scene.
    "traffic_density": 0.06,
    "accident_prob": 0.8,
    "horizon": 1500,
    # Ends of an episode.
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
    """The defaults with these changes. Raises `ValueError` with a hint for an unknown option."""
    unknown = set(changes) - set(defaults)
    if unknown:
        name = sorted(unknown)[0]
        near = difflib.get_close_matches(name, defaults, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown option {name!r}{hint} (options: {', '.join(sorted(defaults))})")
    result = {}
    for key, default in defaults.items():
        value = changes.get(key, default)
        result[key] = _checked(key, value, default)
    return result


def _checked(key: str, value: Any, default: Any) -> Any:
    """Converts a value to the type of its default; the compiled module checks the ranges."""
    if isinstance(default, dict):
        if isinstance(value, dict):
            return merged(value, default)
        raise ValueError(f"option {key!r} must be a dictionary, not {value!r}")
    if key == "map" and isinstance(value, str):
        return value
    if key == "seeds":
        seeds = None if value is None else [_count(key, seed) for seed in value]
        if seeds == []:
            raise ValueError("option 'seeds' is empty: it must contain at least one seed")
        return seeds
    if isinstance(default, bool):
        if value in (True, False):
            return bool(value)
        raise ValueError(f"option {key!r} must be True or False, not {value!r}")
    if isinstance(default, int):
        return _count(key, value)
    if isinstance(value, numbers.Real) and math.isfinite(value):
        return float(value)
    raise ValueError(f"option {key!r} must be a finite number, not {value!r}")


def _count(key: str, value: Any) -> int:
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        count = int(value)
        if 0 <= count < 2**63:
            return count
    raise ValueError(f"option {key!r} must be a whole number from 0 on, not {value!r}")


def to_json(config: dict[str, Any]) -> str:
    """The options of `merged` as JSON for the compiled module."""
    lidar = config["vehicle_config"]["lidar"]
    road = config["map_config"]
    is_sequence = isinstance(config["map"], str)
    options = {
        "world": {
            "blocks": 3 if is_sequence else config["map"],
            "block_sequence": config["map"] if is_sequence else "",
            "lane_count": road["lane_num"],
            "lane_width_m": road["lane_width"],
            "exit_length_m": road["exit_length"],
            "traffic_density": config["traffic_density"],
            "accident_probability": config["accident_prob"],
            "horizon_steps": config["horizon"],
            "scanner": {"beams": lidar["num_lasers"], "range_m": lidar["distance"]},
            "out_of_route": "ends" if config["out_of_route_done"] else "continues",
        },
        "reward": {key: config[key] for key in _REWARD},
        "crash_vehicle_done": config["crash_vehicle_done"],
        "crash_object_done": config["crash_object_done"],
        "beam_noise": lidar["gaussian_noise"],
        "beam_dropout": lidar["dropout_prob"],
        "seeds": {
            "first": config["start_seed"],
            "count": config["num_scenarios"],
            "shuffled": config["shuffle"],
            "order_seed": config["order_seed"],
            "listed": config["seeds"] or [],
        },
    }
    return json.dumps(options)


def expert_json(changes: dict[str, Any] | None) -> str:
    """Changes of the experts' configuration as JSON for the compiled module."""
    if changes is None:
        return "{}"
    if not isinstance(changes, dict):
        raise ValueError(f"expert_config must be a dictionary of sections, not {changes!r}")
    return json.dumps(changes)
