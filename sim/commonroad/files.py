"""Scenario files of CommonRoad: where they are, and those that can be driven."""

import atexit
import logging
import os
import re
import sys
import warnings
from pathlib import Path

# Imported first by the programs of this world: the modules of all worlds in Python.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "foreign"))

# One thread: beside the set there is no core for more, and the arrays are small.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# commonroad-io warns of each old word in a file.
warnings.simplefilter("ignore")
logging.getLogger("commonroad").setLevel(logging.ERROR)
logging.disable(logging.WARNING)
# The checker's bindings report on stderr, after all else, which objects Python has not freed.
atexit.register(lambda: os.dup2(os.open(os.devnull, os.O_WRONLY), 2))

from commonroad.common.file_reader import CommonRoadFileReader
from problem import Problem, Unusable

#: Names another folder of scenarios, or one file.
SCENARIOS_VARIABLE = "VLAPS_COMMONROAD_SCENARIOS"
#: Where `./vlaps setup commonroad` writes the folder of the checkout.
RECORD = Path(sys.prefix) / "checkout.txt"
#: A scenario's name as CommonRoad gives them: country, map, numbers. Other files in the
#: checkout test the reader.
NAME = re.compile(r"[A-Z]{3}_.+\.xml")
#: All are read at the start, which takes up to half a second for each.
FILES_MAX = 50


def _folder() -> Path:
    """The folder or file of the environment variable, or the checkout."""
    if named := os.environ.get(SCENARIOS_VARIABLE):
        if not Path(named).exists():
            raise ImportError(f"{named}: no such file or folder; {SCENARIOS_VARIABLE} names CommonRoad scenarios")
        return Path(named).resolve()
    found = Path(RECORD.read_text().strip()) if RECORD.is_file() else None
    if found is None or not found.is_dir():
        raise ImportError(f"{found or RECORD}: no checkout of commonroad-io; run ./vlaps setup commonroad --checkout DIR")
    return found


def scenario_files(folder: Path) -> list[Path]:
    """The scenarios of a folder by name, each name once; or the one file."""
    if folder.is_file():
        return [folder]
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*.xml")):
        if NAME.fullmatch(path.name):
            found.setdefault(path.name, path)
    if not found:
        raise ImportError(f"{folder}: no CommonRoad scenario, such as USA_Lanker-1_1_T-1.xml, in it")
    if len(found) > FILES_MAX:
        raise ImportError(f"{folder}: {len(found)} scenarios; {SCENARIOS_VARIABLE} names a folder with up to {FILES_MAX}")
    return [found[name] for name in sorted(found)]


def read(path: Path) -> list[Problem]:
    """The planning problems of a file, by number. `Unusable` says why there are none."""
    try:
        scenario, problems = CommonRoadFileReader(str(path)).open()
    except Exception as error:  # The reader raises whatever its parser meets.
        first = (str(error).splitlines() or [""])[0]
        raise Unusable(f"not a CommonRoad scenario ({type(error).__name__}: {first})") from None
    numbers = sorted(problems.planning_problem_dict)
    if not numbers:
        raise Unusable("it has no planning problem")
    found, reasons = [], []
    for number in numbers:
        try:
            problem = problems.planning_problem_dict[number]
            found.append(Problem(f"{path.stem}, problem {number}", scenario, problem))
        except Unusable as error:
            reasons.append(f"problem {number}: {error}")
    if not found:
        raise Unusable(reasons[0])
    return found


def problems() -> list[Problem]:
    """All planning problems that can be driven, by name. What cannot is logged."""
    folder = _folder()
    found, reasons = [], []
    for path in scenario_files(folder):
        try:
            found += read(path)
        except Unusable as error:
            reasons.append(f"{path.name}: {error}")
            print(f"not used: {path.name}: {error}", flush=True)
    if not found:
        raise ImportError(f"{folder}: no scenario that can be driven: {reasons[0]}")
    return found
