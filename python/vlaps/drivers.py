"""Drivers: experts by name, policy files, functions, models."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .env import EXPERTS
from .policy import Policy, torch_driver
from .vector import MetaDriveVectorEnv

#: Actions `[worlds, 2]` of all worlds for their observations `[worlds, features]`.
Drive = Callable[[MetaDriveVectorEnv, NDArray[np.float32]], NDArray[np.float32]]


def loaded(driver: Any) -> Any:
    """Reads a driver that is a policy file; returns others unchanged."""
    if isinstance(driver, os.PathLike) or isinstance(driver, str) and driver.endswith(".onnx"):
        return Policy(driver)
    return driver


def name_of(driver: Any) -> str:
    """The name of a driver in tables."""
    if isinstance(driver, (str, os.PathLike)):
        return os.fspath(driver)
    return getattr(driver, "__name__", type(driver).__name__)


def _answer(actions: Any, worlds: int) -> NDArray[np.float32]:
    """Checks the shape of a driver's answer."""
    if actions is None:
        raise TypeError("the driver returned None: it must return actions [count, 2]")
    array = np.asarray(actions, np.float32)
    if array.shape != (worlds, 2):
        raise ValueError(f"the driver's actions have the shape {array.shape}: it must be ({worlds}, 2)")
    return array


def driving(driver: Any) -> Drive:
    """A driver as a function.

    The driver is the name of an expert, a `Policy` or its file, a function from
    observations to actions, a torch module, or a model of Stable-Baselines3.
    """
    driver = loaded(driver)
    if isinstance(driver, str):
        if driver not in EXPERTS:
            raise ValueError(f"driver {driver!r}: choose from {', '.join(EXPERTS)}, or FILE.onnx")
        return lambda envs, _: envs.expert(driver)
    if hasattr(driver, "predict"):
        return lambda _, seen: _answer(driver.predict(seen, deterministic=True)[0], len(seen))
    if hasattr(driver, "named_parameters"):
        answer = torch_driver(driver)
        return lambda _, seen: answer(seen)
    if callable(driver):
        return lambda _, seen: _answer(driver(seen), len(seen))
    raise TypeError(f"a {type(driver).__name__} cannot drive: pass a name, a policy or a function")
