"""The study of guidance at a toy size, on a floor of our own in place of the published ones."""

import json
from typing import get_args

import pytest
from small_warehouse import ROWS

from experiments import guidance
from qdenv.generators import Base
from qdenv.io.records import read_rows
from qdenv.types import InputError

pytestmark = pytest.mark.slow


def test_a_case_is_simulated_under_each_guidance(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "guidance"
    folder.mkdir()
    (folder / "toy.json").write_text(json.dumps({"layout": ROWS}))
    fleet = guidance.replace(guidance.PIBT, agents=8, timesteps=50)
    case = guidance.Case("published-floor", "toy", fleet, {"none": 0.5})
    monkeypatch.setitem(guidance.CASES, "toy", case)
    monkeypatch.setattr(guidance, "FOUND", tmp_path)
    with pytest.raises(InputError, match="QDENV_STUDY_DATA does not name"):
        monkeypatch.delenv("QDENV_STUDY_DATA", raising=False)
        guidance.main(("toy",), "4,8", 2, tmp_path / "rows.csv")
    monkeypatch.setenv("QDENV_STUDY_DATA", str(tmp_path))
    guidance.main(("toy",), "4,8", 2, tmp_path / "rows.csv")
    rows = list(read_rows(tmp_path / "rows.csv"))
    assert [row["layout"] for row in rows] == [
        f"toy/{name}" for name in get_args(Base) for _ in range(2)
    ]
    assert all(float(row["mean_of_all"]) > 0 for row in rows)
    assert "| toy | crisscross | 8 |" in capsys.readouterr().out
