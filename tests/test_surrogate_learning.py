"""The surrogate learns a rule that is known, whatever a domain has, and nothing of nothing."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from search_harness import QUICK

from qdenv.surrogates.settings import SurrogateConfig
from qdenv.surrogates.surrogate import STAGES, Ring, Samples, Surrogate, errors
from qdenv.types import Encoding, InputError

pytestmark = pytest.mark.slow

KINDS = 3


def truth(rng, count, shape):
    """Make samples of a rule.

    The repair turns a 2 right of a 2 into a 0; cells that hold a 1 are used five times as often as
    others; the objective falls with the 2s and grows with the share of use in the upper half.
    """
    odds = rng.dirichlet(np.ones(KINDS), count)
    draws = rng.random((count, *shape))
    drawn = (draws[..., None] > np.cumsum(odds, axis=1)[:, None, None, :2]).sum(axis=-1)
    before = np.pad(drawn, ((0, 0), (0, 0), (1, 0)))[:, :, :-1]
    repaired = np.where((drawn == 2) & (before == 2), 0, drawn)
    visits = 1.0 + 4 * (repaired == 1)
    usage = visits / visits.sum(axis=(1, 2), keepdims=True)
    ones, twos = ((repaired == kind).mean(axis=(1, 2)) for kind in (1, 2))
    objective = 10 - 6 * twos + 4 * usage[:, : (shape[0] + 1) // 2].sum(axis=(1, 2))
    area = shape[0] * shape[1]
    numbers = np.stack([objective + 5, objective, area * ones, area * twos], axis=1)
    maps = (np.asarray(drawn, np.int8), np.asarray(repaired, np.int8), usage.astype(np.float32))
    return Samples(*(jnp.asarray(leaf) for leaf in maps), jnp.asarray(numbers, jnp.float32))


def full_ring(samples):
    count, *shape = samples.drawn.shape
    heads = samples.numbers.shape[1]
    return Ring.empty(count, tuple(shape), heads).add(samples, jnp.ones(count, bool))


def compiled(config, encoding):
    surrogate = Surrogate(config, encoding, 2)
    parts = surrogate.init, surrogate.fit, surrogate.predict
    return [jax.jit(function, compiler_options=QUICK) for function in parts]


def explained(score, samples):
    heads = [score.objective[:, None], score.result_objective[:, None], score.measures]
    valid = np.ones(len(samples.numbers), bool)
    return np.asarray(errors(np.concatenate(heads, axis=1), samples.numbers, valid)[1])


# Explained of unseen layouts over three seeds: 0.93 to 0.98 with all networks, 0.83 to 0.97 with
# the last alone, which is told nothing of the repair; 0.997 of the tiles and more.
@pytest.mark.parametrize(
    ("shape", "all_stages", "least"), [((8, 7), True, 0.85), ((9, 10), False, 0.7)]
)
def test_a_small_surrogate_explains_layouts_that_it_has_not_seen(shape, all_stages, least):
    config = SurrogateConfig(channels=8, epochs=20, minibatch=32, samples=512)
    init, fit, predict = compiled(config, Encoding(shape, KINDS, all_stages, all_stages))
    rng = np.random.default_rng(0)
    ring, unseen = full_ring(truth(rng, 512, shape)), truth(rng, 256, shape)
    untaught = init(jax.random.key(0))
    fitted, losses = fit(untaught, ring, jax.random.key(1))
    assert explained(predict(untaught, unseen.drawn)[0], unseen).max() < 0.1
    score, repaired, shares = predict(fitted, unseen.drawn)
    assert explained(score, unseen).min() > least
    assert set(losses) == set(STAGES if all_stages else STAGES[2:]) == set(fitted.learners)
    if all_stages:
        assert (repaired == unseen.repaired).mean() > 0.98
        even = jnp.abs(unseen.usage - 1 / 56).mean()
        used = shares / 56  # told in units of an even share
        assert jnp.abs(used - unseen.usage).mean() < 0.6 * even  # measured: 0.36
        np.testing.assert_allclose(used.sum(axis=(1, 2)), 1, rtol=1e-4)


@pytest.mark.parametrize(
    ("shape", "repairs", "usage", "loss"),
    [((1, 1), False, True, "mse"), ((3, 5), True, False, "kl")],
)
def test_a_surrogate_of_a_few_cells_does_without_what_a_domain_lacks(shape, repairs, usage, loss):
    config = SurrogateConfig(
        channels=4,
        blocks=0,
        epochs=2,
        minibatch=10,
        samples=16,
        usage_loss=loss,
        standardise=usage,
        weights=(1, 1, 10, 0),
    )
    init, fit, predict = compiled(config, Encoding(shape, KINDS, repairs, usage))
    untaught, samples = init(jax.random.key(0)), truth(np.random.default_rng(0), 16, shape)
    assert ("repair" in untaught.learners, "usage" in untaught.learners) == (repairs, usage)

    nothing = Ring.empty(16, shape, 4)
    same, losses = fit(untaught, nothing, jax.random.key(1))
    jax.tree.map(np.testing.assert_array_equal, same, untaught)
    assert all(float(loss) == 0 for loss in losses.values())

    fitted, losses = fit(same, full_ring(samples), jax.random.key(1))
    assert int(fitted.fits) == 1 and all(float(loss) > 0 for loss in losses.values())
    for leaf in jax.tree.leaves(fitted):
        assert np.isfinite(leaf).all()
    for name, learner in fitted.learners.items():
        old, new = (jax.tree.leaves(each.variables) for each in (untaught.learners[name], learner))
        assert any((one != other).any() for one, other in zip(old, new, strict=True)), name
    score, repaired, shares = predict(fitted, samples.drawn)
    assert score.success.all() and score.measures.shape == (16, 2)
    assert shares.any() == usage
    if not repairs:
        np.testing.assert_array_equal(repaired, samples.drawn)
    if not usage:  # numbers in their own units
        np.testing.assert_array_equal(fitted.spread, 1)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"channels": 0}, "channels"),
        ({"minibatch": 0}, "minibatch"),
        ({"blocks": -1}, "blocks"),
        ({"rate": math.nan}, "rate"),
        ({"weights": (1, -1, 1, 1)}, "weights"),
        ({"weights": (1, math.nan, 1, 1)}, "weights"),
    ],
)
def test_settings_that_learn_nothing_are_refused(settings, word):
    with pytest.raises(InputError, match=word):
        SurrogateConfig(**settings)


def test_weights_for_another_number_of_heads_are_refused():
    with pytest.raises(InputError, match="3 weights: give 4"):
        Surrogate(SurrogateConfig(weights=(1, 1, 10)), Encoding((4, 4), KINDS), 2)


def test_a_sample_is_seen_as_often_as_any_other_by_the_last_minibatch_too(monkeypatch):
    # A loss that tells which rows it was given: 7 samples in minibatches of 3, for two epochs.
    seen = []

    def loss(variables, batch):
        jax.debug.callback(lambda rows: seen.append(np.array(rows)), batch.numbers[:, 0])
        return jnp.square(variables["params"]).sum(), {}

    monkeypatch.setattr(Surrogate, "_loss", lambda *_: loss)
    numbers = jnp.arange(7.0)[:, None]
    blank = jnp.zeros((7, 1, 1))
    ring = Ring.empty(9, (1, 1), 1).add(Samples(blank, blank, blank, numbers), jnp.ones(7, bool))
    surrogate = Surrogate(SurrogateConfig(minibatch=3), Encoding((1, 1), KINDS), 0)
    params, fitted = jnp.ones(2), jax.jit(surrogate.init)(jax.random.key(0))
    learner = fitted.learners["score"]._replace(
        variables={"params": params, "batch_stats": {}}, moments=optax.adam(1e-3).init(params)
    )
    fitted = fitted._replace(learners={"score": learner})
    fit_part = jax.jit(surrogate.fit_part, static_argnums=3)
    _, value = fit_part(fitted, ring, jax.random.key(0), "score", 0, 2)
    jax.effects_barrier()
    assert len(seen) == 6 and float(value) < 2
    for epoch in (np.concatenate(seen[:3]), np.concatenate(seen[3:])):
        assert sorted(epoch[:7]) == list(range(7))
        np.testing.assert_array_equal(epoch[7:], epoch[:2])  # filled up with its first


@pytest.mark.parametrize("name", STAGES)
def test_no_network_learns_by_scatters(name):
    # XLA would take seconds to fold one of a map's size, and say so on the screen.
    surrogate = Surrogate(SurrogateConfig(samples=8), Encoding((4, 4), KINDS, True, True), 2)
    arguments = jax.eval_shape(
        lambda key: (surrogate.init(key), Ring.empty(8, (4, 4), 4), key), jax.random.key(0)
    )
    steps = str(jax.make_jaxpr(lambda *given: surrogate.fit_part(*given, name, 0, 1))(*arguments))
    assert "gather" in steps and "scatter" not in steps
