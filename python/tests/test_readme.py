"""The examples of the package's page run as they stand there, one after another."""

import os
import re
from pathlib import Path

PAGE = Path(os.environ.get("VLAPS_CHECKOUT", Path(__file__).parents[2])) / "python/README.md"


def test_the_examples_of_the_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    names = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"README.md, block {number}", "exec"), names)
    assert len(blocks) >= 9
    assert names["data"].transitions()["observations"].shape == (1000, 259)
    assert "strict success" in capsys.readouterr().out
    assert (tmp_path / "drive.png").stat().st_size > 10_000
    assert names["vlaps"].Policy.refusal("policy.onnx") is None
