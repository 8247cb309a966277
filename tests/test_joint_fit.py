"""The joint fit: its reduction to seven numbers a sky is exact, and skies of a form are met by that form."""

import importlib
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import simulated_by

import skyfit
from skyfit.analytic import ExtendedPreetham, Perez
from skyfit.analytic.joint import _reduced, EXTENDED, LINEAR
from skyfit.records import write_coefficients
from skyfit.scene import angle_between


module = importlib.import_module("skyfit.analytic.refit")


def test_seven_numbers_stand_for_all_directions():
    with jax.enable_x64(True):
        view, sun = skyfit.hemisphere(60), jnp.asarray(0.9)
        gamma = angle_between(view.zenith, sun, view.azimuth)
        numbers = jnp.array([-0.9, -0.3, 6.0, -2.1, 0.3, 4000.0])
        light = 4000.0 * jnp.linspace(0.5, 3.0, 60)
        weight = jnp.where(view.zenith < 1.4, 20.0, 0.0)

        def whole(p):
            ratio = Perez.from_coefficients(p[:5]).ratio(view.zenith, gamma, sun)
            return weight * (p[5] * ratio / light - 1.0)

        def few(p):
            return _reduced(p, light, gamma, sun, view.zenith, weight)

        full, short = whole(numbers), few(numbers)
        assert short.shape == (7,)
        np.testing.assert_allclose(short @ short, full @ full, rtol=1e-12)
        jacobian, reduced = jax.jacfwd(whole)(numbers), jax.jacfwd(few)(numbers)
        np.testing.assert_allclose(reduced.T @ short, jacobian.T @ full, rtol=1e-10)
        scale = jnp.linalg.norm(jacobian, axis=0)
        off = (reduced.T @ reduced - jacobian.T @ jacobian) / scale[:, None] / scale[None]
        assert float(jnp.abs(off).max()) < 1e-12


def test_skies_of_the_extended_form_are_met(monkeypatch):
    # with less of every coefficient but the constants
    shipped = ExtendedPreetham.shipped().coefficients
    truth = ExtendedPreetham(jnp.asarray(np.where(np.indices(shipped.shape)[2:].sum(axis=0) > 0, 0.7, 1.0) * shipped))
    monkeypatch.setattr(module, "_simulate", simulated_by(truth))
    result = skyfit.refit(
        skyfit.SingleScattering(6), form="extended", directions=60, held_out=10,
        sun_zenith_deg=np.linspace(0.0, 88.0, 12), turbidity=np.geomspace(1.0, 10.0, 7),
    )  # fmt: skip
    assert set(result.result.values()) == {"successful"}
    for skies in (result.fitted, result.held_out):
        assert skies.overall["refitted"].luminance < 5e-3 and skies.overall["refitted"].chromaticity < 1e-3


def test_an_extended_fit_of_few_skies_answers_for_no_others(monkeypatch, tmp_path):
    """Where it was not fitted x + y reaches 1.5 and more."""
    monkeypatch.setattr(module, "_simulate", simulated_by(ExtendedPreetham.shipped()))
    # the range does not depend on how well the coefficients fit
    monkeypatch.setattr(module, "fit_joint", lambda shape, q, start, skies: SimpleNamespace(value=start, result=None))
    monkeypatch.setattr(module, "result_name", lambda result: "not fitted")
    result = skyfit.refit(
        skyfit.SingleScattering(6, "flat"), form="extended", directions=40, held_out=3,
        sun_zenith_deg=(20.0, 40.0, 60.0, 70.0), turbidity=(2.0, 3.0, 4.0),
    )  # fmt: skip
    write_coefficients(result, tmp_path / "narrow.json")
    for model in (result.refitted, skyfit.read_coefficients(tmp_path / "narrow.json")):
        cases = ((2.0, 20.0), (4.0, 70.0), (4.1, 60.0), (1.9, 60.0), (3.0, 19.0), (3.0, 71.0))
        assert [bool(model.valid(t, np.radians(sun))) for t, sun in cases] == [True, True, False, False, False, False]
        with pytest.raises(ValueError, match="`turbidity` must be between 2 and 4, got 8"):
            model.check_range(8.0, 1.0)
        with pytest.raises(ValueError, match="`sun_zenith` must be between 0.349066 and 1.222, got 1.5"):
            model.check_range(3.0, 1.5)


def test_the_extended_form_meets_simulated_skies():
    result = skyfit.refit(
        skyfit.OrdersOfScattering.draft(), form="extended", directions=60, held_out=12,
        sun_zenith_deg=(0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 78.0, 83.0, 87.0, 90.0, 92.0),
        turbidity=(1.0, 1.5, 2.5, 4.0, 6.5, 10.0),
    )  # fmt: skip
    assert isinstance(result.refitted, ExtendedPreetham)
    assert result.fitted.overall["refitted"].luminance < 0.04 and result.held_out.overall["refitted"].luminance < 0.06
    # published coefficients have no answer for a sun below the horizon
    below = np.degrees(result.fitted.sun_zenith) > 90.0
    assert np.all(np.isnan(result.fitted.luminance_error["published"][below]))
    assert np.all(np.isfinite(result.fitted.luminance_error["refitted"]))
    assert result.fitted.rest["refitted"].luminance > result.fitted.overall["refitted"].luminance


def test_flat_below_is_flat_for_steep_views_and_suns_only():
    view, solver = skyfit.hemisphere(40), skyfit.SingleScattering(8, "spherical")
    sun, haze = jnp.radians(jnp.array([40.0, 75.0])), jnp.array([2.0, 2.0])
    air = skyfit.Atmosphere.from_turbidity

    def simulate(flat, limit_deg):
        return np.asarray(
            module._simulate(solver, flat, air, view, jnp.radians(jnp.asarray(limit_deg, float)), sun, haze)
        )

    bent, mixed = simulate(None, 0.0), simulate(skyfit.SingleScattering(8, "flat"), 70.0)
    all_flat = simulate(skyfit.SingleScattering(8, "flat"), 90.0)
    steep = np.asarray(view.zenith) < np.radians(70.0)
    np.testing.assert_allclose(mixed[0, steep], all_flat[0, steep], rtol=1e-6)
    np.testing.assert_allclose(mixed[0, ~steep], bent[0, ~steep], rtol=1e-6)
    np.testing.assert_allclose(mixed[1], bent[1], rtol=1e-6)
    assert np.abs(all_flat[0, ~steep] / bent[0, ~steep] - 1.0).max() > 1e-3


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"form": "extended", "turbidity": (1.0, 5.0, 11.0)}, "`turbidity`"),
        ({"form": "extended", "sun_zenith_deg": (0.0, 40.0, 80.0, 93.0)}, "`sun_zenith_deg`"),
        ({"held_out": 0}, "`held_out`"),
    ],
)
def test_bad_arguments_of_the_forms_are_refused(changes, part):
    with pytest.raises(ValueError, match=part) as caught:
        skyfit.refit(skyfit.SingleScattering(6, "flat"), directions=30, **changes)
    assert "\n" not in str(caught.value)


def test_the_linear_start_is_the_published_model():
    with jax.enable_x64(True):
        published, hazes = skyfit.Preetham.published(), np.array([2.0, 6.0])
        free = LINEAR.start(0, None, None, hazes)
        value = LINEAR.bound(0, free, jnp.asarray(hazes))
        again = LINEAR.put(published, 0, value)
        # within the bounds nothing is changed
        np.testing.assert_allclose(again.distribution[0, 1:], published.distribution[0, 1:], atol=1e-9)
        assert EXTENDED.first(published).coefficients.shape == ExtendedPreetham.shipped().coefficients.shape
