"""The Python of the README runs, one block after the other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iga.pictures.plot import can_draw

README = Path(__file__).resolve().parents[1] / "README.md"


def test_python_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        lines = [line for line in block.splitlines() if ".plot(" not in line or can_draw()]
        exec("\n".join(lines), names)
    error, probed = capsys.readouterr().out.split(maxsplit=1)
    assert float(error) < 1e-2
    assert abs(float(probed.strip("[] \n")) - np.sin(0.2) * np.cos(0.2) * np.exp(0.15)) < 1e-2
    K: Any = names["K"]
    u: Any = names["u"]
    assert abs(K - K.T).max() < 1e-14 * abs(K).max()
    # -2 Laplace u + |x|^2 u = 1 on the unit ball, u = 0 outside: a little less than (1 - |x|^2) / 12.
    assert 0.95 / 12 < u.max() < 1.01 / 12
    assert not can_draw() or (tmp_path / "heat.png").stat().st_size > 10_000
