"""Directions too many for memory are taken piece by piece: the same light and slopes, in memory that is bounded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import COLOURS, hazy, slow, SOLVERS

import skyfit
from skyfit.transport import views


NAMES = ["single flat", "shells spherical", slow("double flat"), slow("orders spherical"), slow("sphere spherical")]


def scene_of(zenith, wavelength_nm=COLOURS):
    return skyfit.Scene(0.7, 0.3, skyfit.Directions(zenith, 0.1 + zenith), wavelength_nm, jnp.ones(len(wavelength_nm)))


@pytest.mark.parametrize("name", NAMES)
def test_the_light_of_pieces_is_that_of_all(monkeypatch, x64, name):
    """Eleven directions in three pieces of four, the last one filled up; by their zenith angles too."""

    def light():
        # a program of its own each time: the size of a piece is no argument
        def total(zenith):
            found = SOLVERS[name].radiance(hazy(), scene_of(zenith))
            return jnp.sum(jnp.cos(jnp.arange(found.size)).reshape(found.shape) * found), found

        jax.clear_caches()
        return jax.jit(jax.grad(total, has_aux=True))(jnp.linspace(0.0, 1.5, 11))

    slopes, whole = light()
    monkeypatch.setattr(views, "_AT_ONCE", 4 * len(COLOURS))
    again, pieces = light()
    np.testing.assert_allclose(pieces, whole, rtol=1e-12)
    np.testing.assert_allclose(again, slopes, rtol=1e-9, atol=1e-12)
    assert whole.shape == (11, 4)


@pytest.mark.parametrize("name", NAMES)
def test_a_million_directions_take_less_than_two_gibibytes(name):
    """Of the compiled program: nothing is run."""
    zenith = jnp.zeros(1_000_000)
    for wavelength_nm in (np.array([550.0]), np.linspace(400.0, 700.0, 16)):
        program = jax.jit(lambda z, nm=wavelength_nm: SOLVERS[name].radiance(hazy(), scene_of(z, nm)))
        memory = program.lower(zenith).compile().memory_analysis()
        assert memory.temp_size_in_bytes + memory.output_size_in_bytes < 2 * 2**30
