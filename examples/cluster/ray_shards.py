"""Parts of an evaluation, a training, a sweep or a regression as tasks of a Ray cluster.

Each task runs one part of `./vlaps` on a node, with the checkout and the folder of --out at
the same path on all nodes. Needs the package ray:

    python examples/cluster/ray_shards.py --shards 8 -- eval --driver mpc --episodes 8000 --out runs/mpc

A task that dies with its node is run again by Ray, and its part continues. To evaluate a
driver that is written in Python, `vlaps.evaluate(driver, seeds, ray=True)` needs no shards.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

import ray

ROOT = Path(__file__).resolve().parents[2]
#: What is built is used, on every node the same.
ENVIRONMENT = {"VLAPS_NO_BUILD": "1"}
#: Exit code of a wrong command line: the same in every part, so that no further part begins.
USAGE = 2


def part(words: list[str], number: int, of: int, root: str, folder: str) -> tuple[int, int, str]:
    """Runs one part; its number, its exit code, and the end of its output."""
    command = [f"{root}/vlaps", *words, "--shard", f"{number}/{of}"]
    environment = {**os.environ, **ENVIRONMENT}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return number, done.returncode, (done.stdout + done.stderr)[-1000:]


def report(words: list[str]) -> int:
    """Merges the parts; its exit code says whether all are there."""
    out = words[words.index("--out") + 1]
    command = [f"{ROOT}/vlaps", words[0], "--out", out, "--report"]
    return subprocess.run(command, env={**os.environ, **ENVIRONMENT}).returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shards", type=int, default=8, help="number of parts")
    parser.add_argument("--cpus", type=int, default=2, help="cores for each part")
    parser.add_argument("words", nargs="+", help="a command of ./vlaps with --out, after --")
    arguments = parser.parse_args()
    words = arguments.words
    if "--out" not in words[:-1]:
        parser.error("the command needs --out DIR, a folder that all nodes see")

    ray.init(ignore_reinit_error=True)
    run = ray.remote(part).options(num_cpus=arguments.cpus, max_retries=3)
    count, here = arguments.shards, str(Path.cwd())
    open_tasks = [run.remote(words, number, count, str(ROOT), here) for number in range(1, count + 1)]
    while open_tasks:
        [ended], open_tasks = ray.wait(open_tasks)
        number, code, text = ray.get(ended)
        print(f"shard {number}/{count}: exit code {code}", file=sys.stderr)
        if code != 0:
            print(text, file=sys.stderr)
        if code == USAGE:
            for task in open_tasks:
                ray.cancel(task)
            return USAGE
    return report(words)


if __name__ == "__main__":
    sys.exit(main())
