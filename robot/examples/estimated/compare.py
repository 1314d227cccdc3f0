#!/usr/bin/env python3
"""Drives the example on truth and on estimates, and prints a table.

  cargo build --release -p robot --example estimated
  python3 robot/examples/estimated/compare.py --episodes 10 --seed 2000

Each row is one call of ./vlaps up in lockstep with the same seeds. A run that fails is a
row, too.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = ROOT / "target/release/examples/estimated"

# Source, noise, mean delay in ms, share dropped.
ROWS = [
    ("truth", 0, 0, 0),
    ("map", 1, 0, 0),
    ("map", 2, 0, 0),
    ("map", 4, 0, 0),
    ("map", 1, 100, 0),
    ("map", 1, 200, 0),
    ("map", 1, 0, 0.2),
    ("map", 1, 0, 0.5),
    ("map", 2, 100, 0.2),
    ("map", 4, 200, 0.5),
    ("scans", 1, 0, 0),
    ("scans", 2, 100, 0.2),
    ("wheels", 1, 0, 0),
    ("wheels", 2, 100, 0.2),
    ("wheels", 4, 200, 0.5),
]
NUMBER = re.compile(r"(\w+)=([-+0-9.eE]+|NaN)")


def drive(row, arguments, folder):
    """The summary of a run, and a dictionary of numbers for each of its episodes."""
    source, noise, delay_ms, drop = row
    name = f"{source}-{noise}-{delay_ms}-{int(100 * drop)}"
    report = Path(folder) / f"{name}.json"
    command = [
        str(ROOT / "vlaps"), "up", "--world", str(PROGRAM), "--lockstep",
        "--episodes", str(arguments.episodes), "--seed", str(arguments.seed),
        "--driver", arguments.driver, "--run", name, "--json", str(report),
    ]
    environment = dict(
        os.environ, VLAPS_EGO=source, VLAPS_NOISE=str(noise),
        VLAPS_DELAY_MS=str(delay_ms), VLAPS_DROP=str(drop),
    )
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=ROOT)
    if not report.exists():
        sys.exit(f"{name}: {done.stderr}")
    logs = (ROOT / "runs" / name / "logs").glob("world*")
    lines = [line for log in logs for line in log.read_text().splitlines()]
    plain = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in lines]
    errors = [
        {key: float(value) for key, value in NUMBER.findall(line)}
        for line in plain
        if "place_rms_m" in line
    ]
    return json.loads(report.read_text()), errors


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=2000)
    parser.add_argument("--driver", default="rrt-star")
    parser.add_argument("--rows", type=int, default=len(ROWS), help="the first so many rows")
    arguments = parser.parse_args()
    print("| ego | noise | delay ms | drop | arrived | without contact | completion | ticks "
          "| place rms m | place max m | heading rms rad | speed rms m/s | pose NEES | rejected | late |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for row in ROWS[: arguments.rows]:
            summary, errors = drive(row, arguments, folder)
            episodes = summary["episodes"]
            arrived = sum(it["outcome"] == "arrived" for it in episodes)
            strict = sum(it["strict"] for it in episodes)
            mean = lambda key: statistics.fmean(it[key] for it in episodes)
            def rms(key):
                return statistics.fmean(it[key] ** 2 for it in errors) ** 0.5
            figures = ["-"] * 7
            if errors:
                taken = sum(it["applied"] + it["rejected"] for it in errors)
                figures = [
                    f"{rms('place_rms_m'):.3f}",
                    f"{max(it['place_max_m'] for it in errors):.2f}",
                    f"{rms('heading_rms_rad'):.4f}",
                    f"{rms('speed_rms_mps'):.3f}",
                    f"{statistics.fmean(it['pose_nees'] for it in errors):.2f}",
                    f"{sum(it['rejected'] for it in errors) / taken:.4f}",
                    f"{sum(it['late'] for it in errors):.0f}",
                ]
            cells = [*map(str, row), f"{arrived} of {len(episodes)}", str(strict),
                     f"{mean('completion'):.3f}", f"{mean('ticks'):.0f}", *figures]
            print("| " + " | ".join(cells) + " |", flush=True)


main()
