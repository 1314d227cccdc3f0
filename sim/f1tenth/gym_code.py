"""The simulator of the F1TENTH gym, from the checkout that `./vlaps setup f1tenth` was given.

Its files are read where they are. The package itself is not loaded, because its first line
needs gym 0.19, which current Python packages cannot be installed beside.
"""

import importlib.util
import os
import sys
import types
from pathlib import Path

# Imported first by the programs of this world: the modules of all worlds in Python.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "foreign"))

# Nothing is written into the checkout: no byte code, and none of numba's machine code.
sys.pycache_prefix = str(Path(sys.prefix) / "pycache")
os.environ["NUMBA_CACHE_DIR"] = str(Path(sys.prefix) / "numba")
# One thread: beside the set there is no core for more, and the arrays are small.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

#: Where `./vlaps setup f1tenth` writes the folder of the checkout.
RECORD = Path(sys.prefix) / "checkout.txt"


def _checkout() -> Path:
    found = Path(RECORD.read_text().strip()) if RECORD.is_file() else None
    if found is None or not (found / "gym" / "f110_gym").is_dir():
        raise ImportError(f"{found or RECORD}: no checkout of the F1TENTH gym; run ./vlaps setup f1tenth --checkout DIR")
    return found


#: The folder of the checkout.
CHECKOUT = _checkout()


def _as_package(name: str, folder: Path) -> None:
    package = types.ModuleType(name)
    package.__path__ = [str(folder)]
    sys.modules[name] = package


_as_package("f110_gym", CHECKOUT / "gym" / "f110_gym")
_as_package("f110_gym.envs", CHECKOUT / "gym" / "f110_gym" / "envs")

from f110_gym.envs.base_classes import Integrator, Simulator
from f110_gym.envs.laser_models import ScanSimulator2D

__all__ = ["CHECKOUT", "Integrator", "ScanSimulator2D", "Simulator", "example_driver"]


def example_driver() -> types.ModuleType:
    """The gym's example, `examples/waypoint_follow.py`. What it imports to open a window and
    to make an environment is replaced by empty modules."""
    for name in ("gym", "pyglet", "pyglet.gl"):
        sys.modules.setdefault(name, types.ModuleType(name))
    sys.modules["pyglet.gl"].GL_POINTS = 0
    path = CHECKOUT / "examples" / "waypoint_follow.py"
    described = importlib.util.spec_from_file_location("waypoint_follow", path)
    module = importlib.util.module_from_spec(described)
    # Numba keeps machine code by the module's name.
    sys.modules["waypoint_follow"] = module
    described.loader.exec_module(module)
    return module
