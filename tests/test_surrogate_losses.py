"""What the surrogate makes small and what it reports, against numpy and scipy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import log_softmax, softmax
from scipy.stats import entropy
from search_harness import QUICK

from qdenv.surrogates.networks import MapPredictor
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.surrogates.surrogate import Ring, Samples, Surrogate, _scale, errors, usage_loss
from qdenv.types import Encoding

usage_loss, scale = jax.jit(usage_loss, static_argnums=2), jax.jit(_scale)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def slope_of(logits, usage):
    return np.asarray(jax.jit(jax.grad(lambda row: usage_loss(row, usage, "kl")))(logits))


@functools.cache
def first_losses(weights):
    """Fit a surrogate for one step to six samples: untrained, samples, losses of that step."""
    rng = np.random.default_rng(0)
    config = SurrogateConfig(
        channels=4, blocks=1, epochs=1, minibatch=6, samples=6, standardise=False, weights=weights
    )
    surrogate = Surrogate(config, Encoding((4, 5), 3, repairs=True), 1)
    drawn, repaired = rng.integers(0, 3, (2, 6, 4, 5)).astype(np.int8)
    samples = Samples(
        *map(jnp.asarray, (drawn, repaired, np.zeros(drawn.shape))), jnp.zeros((6, 3))
    )
    samples = samples._replace(numbers=jnp.asarray(rng.normal(size=(6, 3)), jnp.float32))
    fitted = jax.jit(surrogate.init, compiler_options=QUICK)(jax.random.key(0))
    ring = Ring.empty(6, (4, 5), 3).add(samples, jnp.ones(6, bool))
    fit = jax.jit(surrogate.fit_part, static_argnums=3, compiler_options=QUICK)
    losses = {
        name: float(fit(fitted, ring, jax.random.key(1), name, 0, 1)[1])
        for name in ("repair", "score")
    }
    predict = jax.jit(surrogate.predict, compiler_options=QUICK)
    return fitted, samples, losses, predict(fitted, samples.drawn)[0]


@pytest.mark.slow
def test_the_loss_of_maps_is_the_mean_cross_entropy_of_their_tiles():
    fitted, samples, losses, _ = first_losses(())
    network, variables = MapPredictor(4, 1, 3), fitted.learners["repair"].variables
    logits, _ = network.apply(
        variables, jax.nn.one_hot(samples.drawn, 3), True, mutable=["batch_stats"]
    )
    tiles = np.asarray(samples.repaired)[..., None].astype(int)
    likelihoods = np.take_along_axis(log_softmax(logits, axis=-1), tiles, -1)
    np.testing.assert_allclose(losses["repair"], -likelihoods.mean(), rtol=1e-5)


def used(rng, shape):
    """Draw usage maps in which most cells are never used, each of sum 1."""
    visits = rng.poisson(0.5, shape).astype(np.float64)
    visits[:, 0, 0] = 1
    return (visits / visits.sum(axis=(1, 2), keepdims=True)).astype(np.float32)


def test_the_loss_of_usage_is_the_divergence_from_the_true_distribution(rng):
    logits = rng.normal(size=(3, 4, 5)).astype(np.float32)
    usage = used(rng, (3, 4, 5))
    expected = [
        entropy(share.ravel(), softmax(row.ravel()))
        for share, row in zip(usage, logits, strict=True)
    ]
    np.testing.assert_allclose(usage_loss(logits, usage, "kl"), np.mean(expected), rtol=1e-5)
    perfect = np.log(np.maximum(usage, 1e-12))
    assert abs(float(usage_loss(perfect, usage, "kl"))) < 1e-6
    slope = slope_of(logits, usage)
    wrong = softmax(logits.reshape(3, -1), axis=-1).reshape(logits.shape) - usage
    np.testing.assert_allclose(slope, wrong / 3, atol=1e-6)  # cells that nobody uses count too


def test_the_loss_of_usage_as_numbers_is_their_squared_error_in_units_of_an_even_share(rng):
    numbers = rng.normal(size=(3, 4, 5)).astype(np.float32)
    usage = used(rng, (3, 4, 5))
    expected = np.square(numbers - usage * 20).mean()
    np.testing.assert_allclose(usage_loss(numbers, usage, "mse"), expected, rtol=1e-5)


@pytest.mark.parametrize("kind", ["kl", "mse"])
def test_usage_kept_in_half_the_bits_gives_the_same_loss_within_a_thousandth(rng, kind):
    # 401 x 401 cells: an even share is 6e-6, below the smallest normal number of float16.
    usage = used(rng, (1, 401, 401))
    logits = rng.normal(size=usage.shape).astype(np.float32)
    exact = float(usage_loss(logits, usage, kind))
    assert abs(float(usage_loss(logits, usage.astype(np.float16), kind)) / exact - 1) < 1e-3


def test_a_map_that_nobody_used_says_nothing(rng):
    logits = rng.normal(size=(2, 3, 3)).astype(np.float32)
    nobody = np.zeros_like(logits)
    assert float(usage_loss(logits, nobody, "kl")) == 0
    assert not slope_of(logits, nobody).any()


@pytest.mark.slow
@pytest.mark.parametrize("weights", [(), (1, 2, 10)])
def test_the_loss_of_scores_weighs_its_numbers(weights):
    # Of a map this small no layer normalises: as while it learns.
    _, samples, losses, score = first_losses(weights)
    predicted = np.column_stack([score.objective, score.result_objective, score.measures])
    squared = np.square(predicted - samples.numbers) * np.array(weights or (1, 1, 1))
    np.testing.assert_allclose(losses["score"], squared.mean(), rtol=1e-5)


def ring_of(numbers, size):
    blank = jnp.zeros((len(numbers), 1, 1))
    batch = Samples(blank, blank, blank, jnp.asarray(numbers))
    return Ring.empty(size, (1, 1), numbers.shape[1]).add(batch, jnp.ones(len(numbers), bool))


@pytest.mark.parametrize("size", [30, 50, 20])  # full, with room, overwritten
def test_numbers_are_standardised_by_the_samples_that_are_kept(rng, size):
    # Throughputs, counts and a share: four orders of magnitude apart.
    numbers = rng.normal((5, 240, 1e-2), (1, 30, 1e-3), (30, 3)).astype(np.float32)
    centre, spread = scale(ring_of(numbers, size))
    kept = numbers[-size:].astype(np.float64)
    np.testing.assert_allclose(centre, kept.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(spread, kept.std(axis=0), rtol=1e-4)


def test_a_number_that_never_varies_keeps_its_unit(rng):
    rare = rng.normal(size=20_000) * 1e-7
    numbers = np.column_stack([np.full(20_000, 0.1), np.full(20_000, 240.7), rare])
    numbers = numbers.astype(np.float32)
    centre, spread = scale(ring_of(numbers, 20_000))
    np.testing.assert_allclose(centre, numbers.mean(axis=0, dtype=float), rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(spread[:2], 1)
    np.testing.assert_allclose(spread[2], numbers[:, 2].std(), rtol=1e-4)  # small, but it varies


def test_no_samples_standardise_nothing():
    centre, spread = scale(Ring.empty(4, (1, 1), 3))
    np.testing.assert_array_equal(centre, 0)
    np.testing.assert_array_equal(spread, 1)


def test_errors_are_those_of_the_rows_that_count(rng):
    truth = rng.normal(3, 2, (12, 3)).astype(np.float32)
    truth[:, 2] = 240.7  # never varies, and is no short binary number
    predicted = truth + rng.normal(0, 0.5, truth.shape).astype(np.float32)
    valid = np.arange(12) % 4 > 0
    truth[~valid], predicted[0] = np.nan, np.inf
    rmse, r2 = jax.jit(errors)(predicted, truth, valid)
    t, p = truth[valid].astype(float), predicted[valid].astype(float)
    squared = np.square(t - p)
    np.testing.assert_allclose(rmse, np.sqrt(squared.mean(axis=0)), rtol=1e-5)
    explained = 1 - squared[:, :2].sum(axis=0) / np.square(t - t.mean(axis=0))[:, :2].sum(axis=0)
    np.testing.assert_allclose(r2[:2], explained, rtol=1e-4)
    assert r2[2] == 0 and explained.min() > 0.5
