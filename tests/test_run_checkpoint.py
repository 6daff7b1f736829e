"""Checkpoints: bit for bit, no second copy, one line for another search's."""

import tracemalloc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from search_harness import DIM, EXTRAS, GRID, iterate

from qdenv.io.arrays import PIECE
from qdenv.run.checkpoint import load_newest, save_checkpoint
from qdenv.search.base import Problem, growing
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.search.map_elites import MapElitesConfig
from qdenv.search.registry import make_algorithm
from qdenv.types import InputError, Measure

pytestmark = pytest.mark.slow

SEARCHES = {
    "cma_mae": CmaMaeConfig(emitters=2, batch=6),
    "map_elites": MapElitesConfig(emitters=2, batch=6, sigma_iso=0.3),
}


def test_every_bit_comes_back(tmp_path):
    floats = np.array([[0.0, 0], [-0.0, 0], [np.nan, 0], [0, -np.inf], [0, 0]], np.float32)
    state = {
        "floats": floats,
        "nothing": np.zeros((4, 2), np.int8),
        "number": np.float32(-0.0),
        "truth": np.array([False, True]),
        "key": jax.random.key(3),
    }
    blank = jax.tree.map(jnp.zeros_like, {**state, "key": jnp.zeros(())}) | {
        "key": jax.random.key(0)
    }
    save_checkpoint(tmp_path, 7, state, {})
    with np.load(tmp_path / "checkpoints" / "000007.npz") as file:
        assert file["0.changed"].tolist() == [1, 2, 3]
    iteration, again = load_newest(tmp_path, blank, {})
    assert iteration == 7
    assert (jax.random.key_data(again.pop("key")) == jax.random.key_data(state.pop("key"))).all()
    for name, values in state.items():
        assert np.asarray(again[name]).tobytes() == values.tobytes(), name
        assert again[name].dtype == values.dtype


def test_writing_copies_pieces_and_never_a_whole_array(tmp_path):
    big = np.ones((4096, 4 * PIECE // 4096), np.float32)  # 16 pieces
    big[5] = 0
    tracemalloc.start()
    save_checkpoint(tmp_path, 1, {"big": big}, {})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert big.nbytes == 16 * PIECE and peak < 3 * PIECE
    np.testing.assert_array_equal(load_newest(tmp_path, {"big": big}, {})[1]["big"], big)


def test_a_checkpoint_of_another_search_is_refused_in_one_line(tmp_path):
    make = lambda config, dim, grid: growing(make_algorithm(config, Problem(dim, grid, EXTRAS)))  # noqa: E731
    search = make(SEARCHES["cma_mae"], DIM, GRID)
    save_checkpoint(tmp_path, 1, iterate(search, search.init(jax.random.key(0))), {})
    coarse = (Measure("x", -1, 1, 4), GRID[1])
    for config, dim, grid in (
        (SEARCHES["map_elites"], DIM, GRID),
        (SEARCHES["cma_mae"], DIM + 1, GRID),
        (SEARCHES["cma_mae"], DIM, coarse),
    ):
        other = make(config, dim, grid).init(jax.random.key(0))
        with pytest.raises(InputError, match="another configuration"):
            load_newest(tmp_path, other, {})
