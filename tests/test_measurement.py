"""What is known of a measurement: losses, noise, calibration, spectral responses, errors of the model."""

from dataclasses import fields, replace
from types import SimpleNamespace

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from made_skies import as_sky, by_hand, FREE, SOLVER

import skyfit
from skyfit.retrieve.loss import robust
from skyfit.retrieve.model_error import error_shapes


LOSSES = ("squares", "huber", "cauchy")
RESIDUALS = np.concatenate([-np.logspace(3, -6, 40), [0.0], np.logspace(-6, 3, 40)])


# losses


@pytest.mark.parametrize("threshold", [0.7, 3.0])
@pytest.mark.parametrize("loss", LOSSES)
def test_the_square_of_a_robust_residual_is_scipys_loss(x64, loss, threshold):
    """The cost of one residual: half its loss, by `scipy.optimize.least_squares` started where it may not move."""
    name = {"squares": "linear"}.get(loss, loss)
    after = robust(jnp.asarray(RESIDUALS), loss, threshold)
    for residual, value in zip(RESIDUALS, np.asarray(after.value), strict=True):
        at = scipy.optimize.least_squares(
            lambda _, r=residual: np.array([r]), [0.0], jac=lambda _: np.zeros((1, 1)), loss=name, f_scale=threshold
        )
        assert value**2 == pytest.approx(2.0 * at.cost, rel=1e-9, abs=1e-30)
        assert np.sign(value) == np.sign(residual)


@pytest.mark.parametrize("loss", LOSSES)
def test_slope_and_weight_are_those_of_the_loss(x64, loss):
    residual = RESIDUALS[np.abs(np.abs(RESIDUALS) - 3.0) > 0.1]
    after = robust(jnp.asarray(residual), loss, 3.0)
    step = 1e-6 * np.maximum(np.abs(residual), 1e-3)
    ends = [np.asarray(robust(jnp.asarray(residual + sign * step), loss, 3.0).value) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(after.slope, (ends[0] - ends[1]) / (2.0 * step), rtol=1e-5)
    # reweighted least squares has the gradient of half the loss
    np.testing.assert_allclose(after.weight * residual, after.value * after.slope, rtol=1e-10)
    assert np.all((np.asarray(after.weight) > 0.0) & (np.asarray(after.weight) <= 1.0))


@pytest.mark.parametrize("loss", LOSSES)
def test_losses_are_finite_with_their_gradients_in_both_precisions(loss):
    extreme = np.array([0.0, 1e-30, -1e-12, 3.0, -3.0, 1e12, -1e15])
    for x64 in (False, True):
        with jax.enable_x64(x64):
            residual = jnp.asarray(extreme, float)
            for part in robust(residual, loss, 3.0):
                assert np.all(np.isfinite(part))
            slopes = jax.vmap(jax.grad(lambda r: robust(r, loss, 3.0).value))(residual)
            np.testing.assert_allclose(slopes, robust(residual, loss, 3.0).slope, rtol=1e-4, atol=1e-6)


# noise


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"relative": -0.1}, "`relative` must be between 0 and 1, got -0.1"),
        ({"floor": 2.0}, "`floor` must be between 0 and 1, got 2"),
        ({"calibration": np.nan}, "`calibration` must be between 0 and 1, got nan"),
        ({"model_error": np.inf}, "`model_error` must be between 0 and 1, got inf"),
        ({"field_of_view": 5.0}, "`field_of_view` must be between 0 and 0.5, got 5"),
        ({"threshold": 0.0}, "`threshold` must be between 0.5 and 1000, got 0"),
        ({"relative": 0.0}, "`relative` and `floor` must not both be 0"),
        ({"relative": 0.0, "floor": 0.0}, "`relative` and `floor` must not both be 0"),
        ({"floor": 0.0}, "`relative` and `floor` must not both be 0"),
    ],
)
def test_what_no_measurement_is_like(change, said):
    with pytest.raises(ValueError, match=said) as caught:
        skyfit.NoiseModel(**change)
    assert "\n" not in str(caught.value)


def test_a_loss_that_nobody_knows_is_refused():
    # by the class itself, where no type checker stands before it
    known = {field.name: getattr(skyfit.NoiseModel(), field.name) for field in fields(skyfit.NoiseModel)}
    with pytest.raises(ValueError, match="`loss` must be .*got 'tukey'"):
        skyfit.NoiseModel.__post_init__(SimpleNamespace(**(known | {"loss": "tukey"})))


def two_times(sigma=True):
    random = np.random.default_rng(0)
    sky = as_sky(random.uniform(0.05, 0.2, (2, 40, 15)))
    usable = sky.usable.copy()
    usable[0, 3], usable[1, :, 2] = False, False
    return replace(sky, usable=usable, sigma=sky.sigma if sigma else None)


def test_the_files_sigma_counts_unless_another_noise_is_given():
    sky = two_times()
    used = sky.usable
    np.testing.assert_array_equal(skyfit.NoiseModel().sigma(sky, used), np.where(used, sky.sigma, 1.0))
    given = skyfit.NoiseModel(relative=0.05).sigma(sky, used)
    np.testing.assert_allclose(given, np.where(used, 0.05 * sky.radiance, 1.0), rtol=1e-12)


@pytest.mark.parametrize(("relative", "floor"), [(0.03, None), (None, 0.1), (0.03, 0.1)])
def test_noise_is_a_share_of_the_sample_and_of_the_times_median(relative, floor):
    sky = two_times(sigma=False)
    got = skyfit.NoiseModel(relative=relative, floor=floor).sigma(sky, sky.usable)
    for t in range(2):
        used = sky.usable[t]
        level = (floor or 0.0) * np.median(sky.radiance[t][used])
        expected = np.sqrt(((relative or 0.0) * sky.radiance[t]) ** 2 + level**2)
        np.testing.assert_allclose(got[t][used], expected[used], rtol=1e-12)
        assert np.all(got[t][~used] == 1.0)


def test_noise_that_nobody_told_is_assumed_and_a_dark_sample_is_never_exact():
    sky = two_times(sigma=False)
    assumed = skyfit.NoiseModel().sigma(sky, sky.usable)
    given = skyfit.NoiseModel(relative=0.02, floor=0.05).sigma(sky, sky.usable)
    np.testing.assert_array_equal(assumed, given)
    dark = sky.radiance.copy()
    dark[0, 0, 0] = 0.0
    got = skyfit.NoiseModel(relative=0.02).sigma(replace(sky, radiance=dark), sky.usable)
    assert np.all(got > 0.0) and got[0, 0, 0] >= 1e-7


def test_the_calibration_is_exact_where_the_noise_is_known():
    told, silent = two_times(), two_times(sigma=False)
    assert skyfit.NoiseModel().calibration_prior(told) == 0.0
    assert skyfit.NoiseModel().calibration_prior(silent) == 0.01
    assert skyfit.NoiseModel(relative=0.02).calibration_prior(silent) == 0.0
    assert skyfit.NoiseModel(floor=0.02).calibration_prior(silent) == 0.0
    for sky in (told, silent):
        assert skyfit.NoiseModel(calibration=0.03).calibration_prior(sky) == 0.03
        assert skyfit.NoiseModel(calibration=0.0).calibration_prior(sky) == 0.0


# errors of the model


def test_errors_of_the_model_are_smooth_and_of_size_one():
    cosine, airmass = np.linspace(-1.0, 1.0, 41), 1.0 / np.cos(np.radians(np.linspace(0.0, 87.0, 41)))
    for wavelength in (np.linspace(330.0, 1050.0, 25), np.array([550.0]), np.array([549.0, 551.0])):
        shapes = np.asarray(error_shapes(jnp.asarray(airmass), jnp.asarray(cosine), jnp.asarray(wavelength)))
        assert shapes.shape == (7, 41, wavelength.size)
        assert np.all(np.abs(shapes) <= 1.0 + 1e-5)
        assert np.all(np.abs(np.diff(shapes, axis=1)) < 0.6)
    # no shape is a combination of the others
    random = np.random.default_rng(0)
    cosine, airmass = random.uniform(-1.0, 1.0, 60), 1.0 / np.cos(random.uniform(0.0, 1.5, 60))
    wide = np.asarray(error_shapes(jnp.asarray(airmass), jnp.asarray(cosine), jnp.linspace(400.0, 800.0, 9)))
    assert np.linalg.cond(wide.reshape(7, -1)) < 10.0


# responses


def test_the_xyz_of_a_spectrum_is_that_of_colour_science():
    response = skyfit.Response.xyz()
    spectrum = 0.1 * (response.wavelength_nm / 500.0) ** -2.5
    # straight lines between the samples, and level beyond them
    fine = colour.SpectralShape(360, 830, 1)
    between = np.interp(fine.wavelengths, response.wavelength_nm, spectrum)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(fine)
    # colour-science gives hundredths for k of its own
    x, y, z = 100.0 * colour.sd_to_XYZ(
        colour.SpectralDistribution(between, fine.wavelengths), observer, colour.sd_ones(fine), k=683.0,
        method="Integration",
    )  # fmt: skip
    np.testing.assert_allclose(response.weight @ spectrum, [x, y, z], rtol=1e-4)
    assert response.names == ("X", "Y", "Z") and np.all(np.diff(response.centre_nm) < 0.0)


def test_linear_srgb_is_the_matrix_of_the_standard_times_xyz():
    xyz, rgb = skyfit.Response.xyz(), skyfit.Response.linear_srgb()
    spectrum = 0.1 * (xyz.wavelength_nm / 500.0) ** -2.5
    expected = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB @ (xyz.weight @ spectrum)
    np.testing.assert_allclose(rgb.weight @ spectrum, expected, rtol=2e-3)
    assert rgb.names == ("R", "G", "B") and np.all(np.diff(rgb.centre_nm) < 0.0)


@pytest.mark.parametrize(
    ("wavelength", "weight", "said"),
    [
        ([400.0, 500.0], [[1.0, 1.0, 1.0]], r"`weight` must be \[channel, wavelength\]"),
        ([500.0, 400.0], [[1.0, 1.0]], "`wavelength_nm` increase"),
        ([400.0, 500.0], [[1.0, np.nan]], "`weight` must be between -1e.30 and 1e.30, got nan"),
        ([400.0, 5000.0], [[1.0, 1.0]], "between 300 and 1100 nm"),
        ([400.0, 500.0], [[1.0, 1.0], [0.0, 0.0]], "`weight` must not be 0 everywhere in a channel"),
    ],
)
def test_responses_that_are_refused(wavelength, weight, said):
    with pytest.raises(ValueError, match=said):
        skyfit.Response(np.array(wavelength), np.array(weight))


def test_a_response_with_other_channels_than_the_sky_is_refused():
    with pytest.raises(ValueError, match="`response` must have a channel for each of the sky's 15 wavelengths, got 3"):
        skyfit.invert(as_sky(by_hand()), FREE, SOLVER, response=skyfit.Response.xyz())
