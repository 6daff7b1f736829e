"""Eight devices, here of a CPU, find what one finds: byte for byte, in batches of any size."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import mesh_runs
import numpy as np
import pytest

from qdenv.domains.base import find_domain, make_domain
from qdenv.mesh import count_parts

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
COMPARED = ("fleet/archive.npz", "fleet/best_layout.json", "guided/best_layout.json")
COMPARED += ("guided/archive.npz", "maze/archive.npz", "garden.npz")


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> tuple[Path, Path]:
    """The same runs, made by the one device of this process and by eight of another."""
    one, eight = tmp_path_factory.mktemp("one"), tmp_path_factory.mktemp("eight")
    command = [sys.executable, str(HERE / "mesh_runs.py"), str(eight)]
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=8"
    with subprocess.Popen(
        command, env={**os.environ, "XLA_FLAGS": flags}, stdout=-1, stderr=-1, text=True
    ) as work:
        said, wrong = work.communicate(timeout=300)
    assert (said, work.returncode) == ("8\n", 0), wrong
    mesh_runs.make_runs(one)
    return one, eight


@pytest.mark.parametrize("name", COMPARED)
def test_eight_devices_find_the_same_bytes_as_one(name, folders):
    one, eight = (folder / name for folder in folders)
    assert one.read_bytes() == eight.read_bytes()
    if name.endswith("npz"):
        with np.load(one) as archive:
            assert len(archive["index"]) > 1


@pytest.mark.parametrize("name", ["fleet", "maze"])
def test_eight_devices_log_the_same_rows(name, folders):
    tables = [(folder / name / "metrics.csv").read_text() for folder in folders]
    rows = [list(csv.DictReader(table.splitlines())) for table in tables]
    assert len(rows[0]) == len(rows[1]) > 1
    for one, eight in zip(*rows, strict=True):
        assert one | {"seconds": ""} == eight | {"seconds": ""}


@pytest.mark.parametrize(
    ("layouts", "seeds", "devices", "parts", "busiest"),
    [
        (50, 5, 1, 1, 250),
        (50, 5, 8, 1, 35),  # 31.25 if a layout's runs could be anywhere
        (48, 5, 8, 1, 30),
        (1, 50, 8, 8, 7),  # all devices at work on one layout
        (2, 5, 8, 4, 2),
        (10, 5, 4, 1, 15),
        (3, 1, 8, 1, 1),
    ],
)
def test_runs_are_cut_so_that_the_busiest_device_has_the_fewest(
    layouts, seeds, devices, parts, busiest
):
    assert count_parts(layouts, seeds, devices) == parts
    assert -(-layouts * parts // devices) * -(-seeds // parts) == busiest


def test_only_what_the_devices_compute_themselves_is_shared_out(monkeypatch):
    on_host = find_domain("warehouse-even").simulator
    by_xla = make_domain(mesh_runs.FLEET.evaluation.domain).simulator
    assert by_xla.num_devices == 1
    monkeypatch.setattr("qdenv.devices.count", lambda: 8)
    assert (by_xla.num_devices, on_host.num_devices) == (8, 1)
