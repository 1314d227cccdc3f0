#!/usr/bin/env python3
"""A policy: steers against heading and offset in the lane, and keeps a speed.

A policy of VLAPS is a file, so that no foreign code runs in the tick. This program writes
one; `./vlaps swap lane.onnx` gives it to a running set, `./vlaps up --policy lane.onnx`
starts with it.

    target/python/bin/python examples/python/policy.py lane.onnx
"""

import sys

import numpy as np
import vlaps

HEADING, SPEED, OFFSET = 2, 3, 8  # places of the features, docs/policies.md
SPEED_MPS = 5.0


def lane_keeper():
    """One layer: 259 features to steering and pedal, through tanh."""
    weights, bias = np.zeros((2, 259), np.float32), np.zeros(2, np.float32)
    # Feature 2 is 0.5 - 0.5 sin(heading), feature 8 is 0.5 - offset / 4.5 m.
    weights[0, HEADING], weights[0, OFFSET] = 2.0, 0.6
    bias[0] = -(2.0 + 0.6) / 2
    # Feature 3 is (3.6 speed + 1) / 81.
    weights[1, SPEED] = -10.0
    bias[1] = 10.0 * (3.6 * SPEED_MPS + 1) / 81
    return [(weights, bias, "tanh")]


if __name__ == "__main__":
    path = sys.argv[1] if len(sys.argv) > 1 else "lane.onnx"
    policy = vlaps.export(lane_keeper(), path, algorithm="lane keeper")
    print(f"{path}: {policy}")
