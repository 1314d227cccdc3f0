"""A learning curve as a picture, without a plotting library."""

from __future__ import annotations

import time
from pathlib import Path

WIDTH, HEIGHT, LEFT, BOTTOM = 640, 320, 50, 40
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9")


class Curve:
    """Values in [0, 1] over steps; every new point is printed and drawn into an SVG file."""

    def __init__(self, path: str, title: str) -> None:
        self.path, self.title = Path(path), title
        self.points: dict[str, list[tuple[int, float]]] = {}

    def add(self, step: int, **values: float) -> None:
        """Adds a point to each named line."""
        for name, value in values.items():
            self.points.setdefault(name, []).append((step, value))
        shown = ", ".join(f"{name} {value:.3f}" for name, value in values.items())
        print(f"step {step}: {shown}, {time.process_time():.0f} s of processor time", flush=True)
        self.path.write_text(self.svg())

    def svg(self) -> str:
        """The picture."""
        last = max(step for line in self.points.values() for step, _ in line) or 1
        at = lambda step, value: (  # noqa: E731
            f"{LEFT + (WIDTH - LEFT - 10) * step / last:.1f},"
            f"{HEIGHT - BOTTOM - (HEIGHT - BOTTOM - 30) * min(max(value, 0.0), 1.0):.1f}"
        )
        text = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
            f'font-size="12"><rect width="100%" height="100%" fill="white"/><text x="{LEFT}" y="18">{self.title}</text>'
        ]
        for value in (0.0, 0.5, 1.0):
            y = at(0, value).split(",")[1]
            text.append(f'<path d="M{at(0, value)} L{at(last, value)}" stroke="#ccc"/><text x="15" y="{y}">{value}</text>')
        text.append(f'<text x="{WIDTH - 130}" y="{HEIGHT - 8}">{last} steps</text>')
        for k, (name, line) in enumerate(self.points.items()):
            colour = COLOURS[k % len(COLOURS)]
            path = " L".join(at(step, value) for step, value in line)
            text.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
            text.append(f'<text x="{LEFT + 90 * k}" y="{HEIGHT - 8}" fill="{colour}">{name}</text>')
        return "".join(text) + "</svg>\n"
