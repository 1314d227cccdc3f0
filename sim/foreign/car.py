"""The car of a run: size, limits and scanner, from its settings."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: The vehicle file that names every key: other files give only what differs.
DEFAULT_FILE = ROOT / "vehicles" / "metadrive.toml"

#: A number of the configuration by its key, such as `vehicle.length_m`.
Setting = Callable[[str], float]


@dataclass(frozen=True)
class Car:
    """The section `vehicle`."""

    length_m: float
    width_m: float
    wheelbase_m: float
    max_steer_deg: float
    max_accel_mps2: float
    max_brake_mps2: float
    max_speed_mps: float
    delay_ms: float

    @classmethod
    def of(cls, setting: Setting) -> "Car":
        """The car that the settings describe."""
        return cls(*(setting(f"vehicle.{field.name}") for field in fields(cls)))

    @property
    def max_steer_rad(self) -> float:
        return math.radians(self.max_steer_deg)

    @property
    def turning_radius_m(self) -> float:
        """Radius of the tightest turn, at the middle of the rear axle."""
        return self.wheelbase_m / math.tan(self.max_steer_rad)


@dataclass(frozen=True)
class Scanner:
    """The section `scanner`."""

    beams: float
    field_of_view_deg: float
    range_m: float
    x_m: float
    y_m: float
    heading_deg: float
    drop_probability: float

    @classmethod
    def of(cls, setting: Setting) -> "Scanner":
        """The scanner that the settings describe."""
        return cls(*(setting(f"scanner.{field.name}") for field in fields(cls)))

    @property
    def field_of_view_rad(self) -> float:
        """Angle from the first beam to the last; the full circle from 2 pi on."""
        return math.tau if self.field_of_view_deg >= 360 else math.radians(self.field_of_view_deg)


def settings_of(path: Path) -> Setting:
    """The settings of a vehicle file, for programs outside a run."""
    tables = [tomllib.loads(file.read_text()) for file in (DEFAULT_FILE, path)]

    def setting(key: str) -> float:
        section, name = key.split(".")
        found = [table[section][name] for table in tables if name in table.get(section, {})]
        return float(found[-1])

    return setting
