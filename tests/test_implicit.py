"""Fitted parameters have derivatives by all that went into the fit: those that fitting again shows."""

import importlib
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from made_skies import as_sky, by_hand, FREE, OWN_NOISE, SOLVER
from skies import forward_of, slow

import skyfit
from skyfit.retrieve import retrieve
from skyfit.retrieve.prepared import first_points, prepared


NM = np.arange(400.0, 681.0, 70.0)
# direction and channel of the measured sample that is moved
SAMPLE = 4, 0
# by a sample, the sun, the air that is held, what is said before, the loss
MOVES = 5


@pytest.fixture
def searched_to_the_end(monkeypatch):
    """Searches end within 0.02 sigma otherwise: that is what differences of two would show."""
    module = importlib.import_module("skyfit.retrieve.retrieve")
    monkeypatch.setattr(module, "_NEAR", 1e-8)
    # slopes that are kept near the end hold its last digits back
    monkeypatch.setattr(module, "_CLOSE", 0.0)


def far_from_the_model(times):
    """Samples that no parameters fit: what is left is a tenth of them, within the stated sigma, and smooth."""
    clean = by_hand(directions=16, wavelength_nm=NM)
    zenith = np.asarray(skyfit.hemisphere(16).zenith)
    skies = [clean * (1.0 + 0.15 * np.sin(5.0 * zenith + k)[:, None] * np.cos(NM / 90.0 + k)) for k in range(times)]
    return replace(as_sky(np.stack(skies), None, wavelength_nm=NM), sigma=0.2 * np.stack([clean] * times))


def values_of_moves(sky, loss, **question):
    """The fitted values, and what they are by Gauss-Newton, as functions of what goes into the fit."""
    measured = replace(OWN_NOISE, loss=loss, threshold=0.5)
    asked = prepared(sky, FREE, SOLVER, measurement=measured, **question)
    options = asked.options() | {"start": first_points(asked, np.arange(len(sky.radiance)))}

    def retrieved(move):
        problem, start = asked.problem, asked.start
        measured = problem.measured.at[(0, *SAMPLE)].multiply(1.0 + move[0])
        problem = eqx.tree_at(lambda p: (p.measured, p.sun_zenith), problem, (measured, problem.sun_zenith + move[1]))
        model = eqx.tree_at(lambda m: m.atmosphere.rayleigh.pressure, start, replace_fn=lambda p: p * (1.0 + move[2]))
        rows = asked.rows._replace(centre=asked.rows.centre + move[3])
        changed = {"priors": rows, "threshold": options["threshold"] * (1.0 + move[4])}
        return retrieve(problem, model, asked.names, **options | changed)

    return retrieved


@pytest.mark.parametrize("times, loss", [(1, "cauchy"), slow(1, "huber"), slow(1, "squares"), slow(2, "squares")])
def test_the_derivative_is_that_of_fitting_again(x64, searched_to_the_end, times, loss):
    """Huber's loss without a prior: how much a prior weighs follows the samples beyond the threshold, which is held."""
    question: dict = {} if loss == "huber" else {"priors": {"asymmetry": (0.6, 0.05)}}
    question |= {"shared": ("asymmetry",)} if times == 2 else {}
    retrieved = values_of_moves(far_from_the_model(times), loss, **question)

    def values(move):
        return retrieved(move).values.reshape(-1)

    nothing = jnp.zeros(MOVES)
    around, slopes = forward_of(values, MOVES, 1e-3)
    forward, expected = slopes.T, ((around[0] - around[1]) / 2e-3).T
    backward = jax.jit(jax.grad(lambda move: values(move)[0]))(nothing)
    np.testing.assert_allclose(backward, forward[0], rtol=1e-6, atol=1e-9)
    largest = np.max(np.abs(expected), axis=0)
    # a prior and a threshold tell only where there are any
    tells = np.array([True, True, True, "priors" in question, loss != "squares"])
    assert np.array_equal(largest > 0.0, tells)
    assert np.all(np.abs(forward - expected) <= 2e-3 * largest)


def test_all_but_the_values_has_no_derivative(x64):
    retrieved = values_of_moves(far_from_the_model(1), "squares")
    slopes = jax.jit(jax.jacfwd(lambda move: (retrieved(move).noise, retrieved(move).radiance)))(jnp.zeros(MOVES))
    assert all(np.all(np.asarray(slope) == 0.0) for slope in jax.tree.leaves(slopes))
