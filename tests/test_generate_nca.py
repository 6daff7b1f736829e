"""The automaton against a plain-numpy oracle, its flat parameters, canvases and frames."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.special import expit

from qdenv.domains.base import find_domain
from qdenv.generators import Canvas, NcaConfig, choose_tiles
from qdenv.grid import draw, inside_frame
from qdenv.nca import NCA, make_automaton, nca, round_weights, seed_canvas
from qdenv.types import InputError


def oracle_step(layers: list[tuple[np.ndarray, np.ndarray]], cells: np.ndarray) -> np.ndarray:
    """Apply one step with explicit loops over cells; kernels are [k, k, in, out]."""
    for number, (kernel, bias) in enumerate(layers):
        reach = kernel.shape[0] // 2
        padded = np.pad(cells, ((reach, reach), (reach, reach), (0, 0)))
        rows, cols = cells.shape[:2]
        out = np.zeros((rows, cols, kernel.shape[3]))
        for row in range(rows):
            for col in range(cols):
                window = padded[row : row + kernel.shape[0], col : col + kernel.shape[1]]
                out[row, col] = np.einsum("ijk,ijko->o", window, kernel) + bias
        last = number == len(layers) - 1
        cells = 1 / (1 + np.exp(-out)) if last else np.maximum(out, 0)
    return cells


@pytest.mark.parametrize("kernel_sizes", [(3, 3, 3), (3, 1, 1), (5, 3)])
def test_step_agrees_with_oracle(kernel_sizes):
    size, grow = make_automaton(3, kernel_sizes, hidden=4)
    flat = np.asarray(jax.random.normal(jax.random.key(0), (size,))) * 0.5
    shapes = NCA(3, kernel_sizes, 4).init(jax.random.key(1), jnp.zeros((1, 1, 3)))
    variables = ravel_pytree(shapes)[1](jnp.asarray(flat))["params"]
    layers = [
        (np.asarray(layer["kernel"], np.float64), np.asarray(layer["bias"], np.float64))
        for _, layer in sorted(variables.items())
    ]
    cells = np.random.default_rng(0).random((5, 6, 3)).astype(np.float32)
    expected = oracle_step(layers, oracle_step(layers, cells.astype(np.float64)))
    np.testing.assert_allclose(grow(flat, cells, 2), expected, atol=2e-6)


def whole_number_step(layers: list[dict[str, np.ndarray]], cells: np.ndarray, scale: int):
    """Apply one step of an exact automaton in whole numbers: outputs in 1024ths, int64."""
    fraction = 1024  # of what comes in
    for number, layer in enumerate(layers):
        kernel = np.round(layer["kernel"] * 512).astype(np.int64)
        bias = np.round(layer["bias"] * 512 * fraction).astype(np.int64)
        np.testing.assert_array_equal(bias, layer["bias"] * 512 * fraction)
        reach = kernel.shape[0] // 2
        padded = np.pad(cells, ((reach, reach), (reach, reach), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape[:2], (0, 1))
        sums = np.einsum("hwijk,jkio->hwo", windows, kernel) + bias
        assert abs(sums).max() <= 2**24
        if number == len(layers) - 1:
            sums *= scale
        # Half a unit is rounded to the even one: a 32nd, or a 128th before the sigmoid.
        last = number == len(layers) - 1
        unit = 512 * fraction // (128 if last else 32)
        fine, rest = np.divmod(sums, unit)
        fine += (rest * 2 > unit) | ((rest * 2 == unit) & (fine % 2 == 1))
        if not last:
            cells, fraction = np.clip(fine, 0, 511), 32
        else:
            values = 1024 / (1 + np.exp(-np.clip(fine, -1024, 1023) / 128))
            cells = np.round(values).astype(np.int64)
    return cells


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel_sizes", "sigma"), [((3, 3, 3), 0.2), ((3, 3, 3), 1.4), ((3, 1, 1), 1.0)]
)
def test_an_exact_automaton_computes_in_whole_numbers(kernel_sizes, sigma):
    size, grow = make_automaton(3, kernel_sizes, hidden=32, exact=True)
    rng = np.random.default_rng(3)
    flat = rng.normal(0, sigma, size).astype(np.float32)
    shapes = NCA(3, kernel_sizes, 32).init(jax.random.key(1), jnp.zeros((1, 1, 3)))
    variables, scale = round_weights(ravel_pytree(shapes)[1](jnp.asarray(flat)))
    assert scale == {0.2: 1, 1.0: 8, 1.4: 256}[sigma]
    layers = [
        {name: np.asarray(part, np.float64) for name, part in layer.items()}
        for _, layer in sorted(variables["params"].items())
    ]
    cells = seed_canvas(("ee", "@@"), 8, 9, ".@e")
    expected = cells.astype(np.int64) * 1024
    for _ in range(20):
        expected = whole_number_step(layers, expected, int(scale))
    np.testing.assert_array_equal(np.asarray(grow(flat, cells, 20)) * 1024, expected)


def test_the_order_of_sums_does_not_matter_to_an_exact_automaton():
    rng, order = np.random.default_rng(5), np.random.default_rng(6).permutation(32)
    shapes = NCA(3).init(jax.random.key(1), jnp.zeros((1, 1, 3)))
    flat, unravel = ravel_pytree(shapes)
    solution = rng.normal(0, 0.3, flat.size).astype(np.float32)
    layers = unravel(jnp.asarray(solution))["params"]
    # The same automaton, its hidden channels in another order.
    layers["Conv_0"] = {
        "bias": layers["Conv_0"]["bias"][order],
        "kernel": layers["Conv_0"]["kernel"][..., order],
    }
    layers["Conv_1"]["kernel"] = layers["Conv_1"]["kernel"][:, :, order]
    other = np.asarray(ravel_pytree({"params": layers})[0])
    start, same = seed_canvas(("ee", "@@", "ee"), 33, 32, ".@e"), {}
    for exact in (False, True):
        grow = make_automaton(3, exact=exact)[1]
        one, two = (np.asarray(grow(weights, start, 50)) for weights in (solution, other))
        same[exact] = bool((one == two).all())
    assert same == {False: False, True: True}


@pytest.mark.parametrize(
    ("kinds", "kernel_sizes", "size"),
    [(3, (3, 3, 3), 11_011), (3, (3, 1, 1), 2_051), (5, (3, 1, 1), 2_693), (2, (3, 1, 1), 1_730)],
)
def test_published_parameter_counts(kinds, kernel_sizes, size):
    assert make_automaton(kinds, kernel_sizes)[0] == size


@pytest.mark.parametrize("wrap", [jax.jit, lambda function: function], ids=["jit", "plain"])
def test_one_cell_grown_by_hand(wrap):
    # One layer of 1 x 1: sigmoid(x W + b) twice; b = (0, 1) and W swaps the two channels.
    _, grow = make_automaton(2, (1,))
    flat = jnp.array([0, 1, 0, 1, 1, 0], jnp.float32)
    start = np.zeros((1, 1, 2), np.float32)
    grown = wrap(lambda one: grow(one, start, 2))(flat)

    expected = expit([expit(1), expit(0) + 1])
    np.testing.assert_allclose(grown, np.reshape(expected, (1, 1, 2)), rtol=1e-6)


def test_solutions_of_a_wrong_length_are_refused_while_tracing():
    generator = nca(NcaConfig(), Canvas(1, 1, ".@", ("@",)))
    with pytest.raises(AssertionError):
        generator.grow(jnp.zeros((3, 5)), 2)


def test_growth_continues_where_it_stopped():
    size, grow = make_automaton(3, (3, 1), hidden=4)
    flat = jax.random.normal(jax.random.key(1), (size,))
    start = seed_canvas(("e",), 5, 5, ".@e")
    np.testing.assert_array_equal(grow(flat, start, 0), start)
    halfway = grow(flat, start, 2)
    np.testing.assert_allclose(grow(flat, halfway, 3), grow(flat, start, 5), atol=1e-6)


def test_a_solution_grows_alike_in_any_company():
    generator = nca(NcaConfig(hidden=8), Canvas(9, 8, ".@e", ("ee", "@@")))
    flat = jax.random.normal(jax.random.key(2), (6, generator.size)) * 0.3
    grow = jax.jit(lambda some: generator.grow(some, 20))
    together = np.asarray(grow(flat))
    alone = np.concatenate([grow(flat[index : index + 1]) for index in range(6)])
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize(
    ("name", "corner"), [("warehouse-even", (15, 15)), ("manufacturing", (15, 16))]
)
def test_seed_blocks_sit_where_the_paper_puts_them(name, corner):
    domain, (top, left) = find_domain(name), corner
    rows, cols = 33 - 2 * domain.margin[0], 36 - 2 * domain.margin[1]
    expected = np.full((rows, cols), ".")
    block = np.array([list(row) for row in domain.seed_block])
    expected[top : top + block.shape[0], left : left + block.shape[1]] = block
    canvas = seed_canvas(domain.seed_block, rows, cols, domain.generated)
    drawn = draw(choose_tiles(canvas), domain.generated)
    assert drawn == ["".join(row) for row in expected]


def test_warehouse_frame_is_drawn_around_the_generated_area():
    domain = find_domain("warehouse-even")
    tiles = np.full((7, 3), 1, np.int8)
    layout = np.asarray(domain.frame(tiles))
    assert draw(layout, domain.tiles) == [
        "..@@@..",
        "w.@@@.w",
        "..@@@..",
        "..@@@..",
        "w.@@@.w",
        "..@@@..",
        "..@@@..",
    ]
    np.testing.assert_array_equal(inside_frame(layout, domain.margin), tiles)


def test_bad_architectures_and_canvases_are_refused():
    with pytest.raises(InputError, match="odd"):
        NcaConfig(kernel_sizes=(3, 2))
    with pytest.raises(InputError, match="too small by 1 x 0 "):
        seed_canvas(("ee", "@@"), 1, 5, ".@e")
