#!/usr/bin/env python3
"""Compares the benchmarks of two builds, alternating in one run.

    git worktree add --detach target/old REVISION && (cd target/old && cargo build --release --workspace --bins)
    bench/against.py target/old --rounds 5 --json against.json planner sim policy

In each round every benchmark runs once with each build; the order of the builds changes
from round to round. The row of a figure shows the medians of both builds and the median
over the rounds of the ratio new/old (for a rate: old/new), so that a ratio above 1 is
worse. With six rounds or more, the interval contains the median with at least 95 %
confidence; with fewer it is the whole range. Exit code 1 if a whole interval is above
1 + --bar.

A benchmark is a command of `./vlaps bench`, with options in quotes:
"latency --load none --rate 100". Needs only Python 3.10.
"""

import argparse
import json
import math
import os
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

MEASURED = re.compile(r"^(.*_)?(p50|p99|mean)(_us|_ns|_ms)?$|_per_s(_per_core)?$")
IS_RATE = re.compile(r"_per_s(_per_core)?$")
NOT_A_NAME = re.compile(r"note|outcome|version|processor")


def figures(value, path=(), within_list=False):
    """Yields the path and value of each figure of a benchmark's JSON."""
    if isinstance(value, dict):
        named = within_list * [
            f"{key}={field}" if isinstance(field, (int, float)) else str(field)
            for key, field in value.items()
            if isinstance(field, str) and not NOT_A_NAME.search(key)
            or key in ("rate_hz", "batch", "threads", "width", "height")
        ]
        path = (*path, *named)
        for key, field in value.items():
            if key == "conditions":
                continue
            if MEASURED.search(key) and isinstance(field, (int, float)):
                yield (*path, key), float(field)
            elif isinstance(field, (dict, list)):
                yield from figures(field, path if key == "rows" else (*path, key))
    elif isinstance(value, list):
        for entry in value:
            yield from figures(entry, path, True)


def run(root, benchmark, folder):
    """Runs a benchmark with the build of a checkout; returns its figures."""
    file = Path(folder) / "figures.json"
    file.unlink(missing_ok=True)
    words = benchmark.split()
    if words[0] == "latency":
        words += ["--out", str(Path(folder) / "latency"), "--fresh"]
    done = subprocess.run(
        [str(root / "vlaps"), "bench", *words, "--json", str(file)],
        env={**os.environ, "VLAPS_NO_BUILD": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )
    if done.returncode != 0 or not file.exists():
        sys.exit(f"{root}: bench {benchmark}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    return dict(figures(json.loads(file.read_text())))


def interval(ratios):
    """The narrowest pair of order statistics that contains the median with 95 % confidence."""
    ordered, count = sorted(ratios), len(ratios)
    tail, outside = 0, 0.0
    while True:
        outside += 2 * math.comb(count, tail) / 2**count
        if outside > 0.05 or 2 * tail >= count:
            break
        tail += 1
    low = max(tail - 1, 0)
    return ordered[low], ordered[count - 1 - low]


def compare(rounds):
    """A row for each figure that both builds printed in every round."""
    shared = set.intersection(*(set(side) for pair in rounds for side in pair))
    for path in sorted(shared):
        old = [pair[0][path] for pair in rounds]
        new = [pair[1][path] for pair in rounds]
        if min(old + new) <= 0:
            continue
        ratios = [a / b if IS_RATE.search(path[-1]) else b / a for a, b in zip(old, new)]
        low, high = interval(ratios)
        yield {
            "figure": " ".join(path),
            "old": statistics.median(old),
            "new": statistics.median(new),
            "ratio": statistics.median(ratios),
            "low": low,
            "high": high,
        }


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path, help="checkout whose release build is compared with this one's")
    parser.add_argument("benchmarks", nargs="+", metavar="BENCHMARK")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--bar", type=float, default=0.05, help="relative increase that counts as worse [default: 0.05]")
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error("--rounds: at least 1")
    sides = [options.old.resolve(), Path(__file__).resolve().parent.parent]
    for side in sides:
        if not (side / "target/release/vlaps-supervisor").exists():
            parser.error(f"{side}: not built: cargo build --release --workspace --bins")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for benchmark in options.benchmarks:
            rounds = []
            for turn in range(options.rounds):
                print(f"{benchmark}: round {turn + 1} of {options.rounds}", file=sys.stderr)
                pair = {}
                for side in (sides if turn % 2 == 0 else sides[::-1]):
                    pair[side] = run(side, benchmark, folder)
                rounds.append([pair[side] for side in sides])
            rows += [{"benchmark": benchmark, **row} for row in compare(rounds)]
    width = max((len(row["figure"]) for row in rows), default=0)
    for row in rows:
        row["worse"] = row["low"] > 1 + options.bar
        print(
            f"{row['benchmark'].split()[0]:8} {row['figure']:{width}} {row['old']:12.6g} "
            f"{row['new']:12.6g} {row['ratio']:6.3f} [{row['low']:.3f}, {row['high']:.3f}]"
            f"{'  worse' if row['worse'] else ''}"
        )
    if options.json:
        options.json.write_text(json.dumps({"rounds": options.rounds, "rows": rows}, indent=2) + "\n")
    return any(row["worse"] for row in rows)


if __name__ == "__main__":
    sys.exit(main())
