"""Options of the environments: MetaDrive's names, with the experiment's values as defaults."""

from __future__ import annotations

import difflib
import json
import math
import numbers
from collections.abc import Iterable
from typing import Any, TypeGuard

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

#: The most that the compiled module reads.
_MOST = 2**63 - 1
#: The least and the most of whole numbers, as the compiled module has them; others may be 0.
_RANGES = {
    "num_scenarios": (1, _MOST),
    "horizon": (1, _MOST),
    "num_lasers": (0, 2048),
    "lane_num": (1, 5),
    "map": (1, 256),
}
#: Other libraries' names of options.
_ALIASES = {"max_episode_steps": "horizon"}

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
        hint = _hint(name, defaults)
        raise ValueError(f"unknown option {name!r}{hint} (options: {', '.join(sorted(defaults))})")
    result = {}
    for key, default in defaults.items():
        value = changes.get(key, default)
        result[key] = _checked(key, value, default)
    return result


def _hint(name: str, defaults: dict[str, Any]) -> str:
    """What an unknown option was probably meant to be."""
    if name in DEFAULTS["map_config"]:
        return f"; did you mean map_config={{{name!r}: ...}}?"
    if name in DEFAULTS["vehicle_config"]["lidar"]:
        return f"; did you mean vehicle_config={{'lidar': {{{name!r}: ...}}}}?"
    near = difflib.get_close_matches(_ALIASES.get(name, name), defaults, n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _checked(key: str, value: Any, default: Any) -> Any:
    """Converts a value to the type of its default; the compiled module checks the ranges."""
    if isinstance(default, dict):
        if isinstance(value, dict):
            return merged(value, default)
        raise ValueError(f"option {key!r} must be a dictionary, not {value!r}")
    if key == "map" and isinstance(value, str):
        return value
    if key == "map" and not is_whole(value):
        raise TypeError(f"map = {value!r}: it must be a number of blocks, or letters such as 'SCrRXTO'")
    if key == "seeds":
        seeds = None if value is None else [whole("seeds", seed) for seed in listed(key, value)]
        if seeds == []:
            raise ValueError("seeds is empty: it must contain at least one seed")
        return seeds
    if isinstance(default, bool):
        if value in (True, False):
            return bool(value)
        raise ValueError(f"option {key!r} must be True or False, not {value!r}")
    if isinstance(default, int):
        return whole(key, value, *_RANGES.get(key, (0, _MOST)))
    if isinstance(value, numbers.Real) and math.isfinite(value):
        return float(value)
    raise ValueError(f"option {key!r} must be a finite number, not {value!r}")


def is_whole(value: Any) -> TypeGuard[int]:
    """Whether a value is a whole number, Python's or NumPy's; booleans are none."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def whole(name: str, value: Any, least: int = 0, most: int = _MOST) -> int:
    """Checks that a value is a whole number in this range."""
    if not is_whole(value):
        raise TypeError(f"{name} = {value!r}: it must be a whole number")
    if not least <= value <= most:
        end = "2**63 - 1" if most == _MOST else most
        raise ValueError(f"{name} = {value}: it must be between {least} and {end}")
    return int(value)


def listed(name: str, value: Any) -> list[Any]:
    """The elements of a sequence, array or iterator."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} = {value!r}: pass a sequence, such as range(1000, 1200)")
    return list(value)


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
        raise TypeError(f"expert_config must be a dictionary of sections, not {changes!r}")
    _check_values("expert_config", changes)
    return json.dumps(changes)


def _check_values(place: str, value: Any) -> None:
    """Checks that JSON has a form for the value; the compiled module checks the keys."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_values(f"{place}[{key!r}]", inner)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            _check_values(f"{place}[{index}]", inner)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{place} = {value}: it must be finite")
    elif not isinstance(value, (bool, int, float, str)):
        raise TypeError(f"{place} = {value!r}: it must be a number, text, list or dictionary of Python")
