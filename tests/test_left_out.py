"""What a fit leaves out: directions that are outliers, samples near the sun, times that cannot be fitted."""

from dataclasses import replace

import numpy as np
import pytest
from made_skies import as_sky, by_hand, FREE, HAZE, SOLVER

import skyfit
from skyfit.cli.asked import times_of
from skyfit.measured import mask_sun
from skyfit.retrieve.result import outliers


CAUCHY = skyfit.NoiseModel(loss="cauchy")


@pytest.fixture(scope="module")
def clean():
    return as_sky(by_hand(), noise=None)


def with_lamps(sky, count, factor=8.0):
    radiance = sky.radiance.copy()
    radiance[0, :count] *= factor
    return replace(sky, radiance=radiance)


@pytest.mark.parametrize("measurement", [CAUCHY, skyfit.NoiseModel()], ids=["cauchy", "huber"])
def test_a_lamp_in_one_direction_is_rejected_and_noted_and_the_fit_successful(clean, measurement):
    fit = skyfit.invert(with_lamps(clean, 1), FREE, SOLVER, measurement=measurement)
    assert fit.result == ("successful",) and np.flatnonzero(fit.rejected[0]).tolist() == [0]
    np.testing.assert_allclose(fit.values[0], list(HAZE.values()), rtol=0.05)
    assert "1 of 40 directions rejected, the verdict is of the others" in fit.notes
    assert not any("poor fit" in note or "times their sigma" in note for note in fit.notes)
    # chi-square is of all samples, as it says
    assert fit.reduced_chi_square[0] > 10.0


def test_many_skies_judge_alike(clean):
    for count, result in ((1, "successful"), (12, "poor_fit")):
        fits = skyfit.fit_many(with_lamps(clean, count, 30.0), FREE, solver=SOLVER, measurement=CAUCHY)
        assert list(fits.result) == [result]


def test_lamps_in_many_directions_are_no_outliers(clean):
    fit = skyfit.invert(with_lamps(clean, 12), FREE, SOLVER, measurement=CAUCHY)
    assert fit.result == ("poor_fit",) and any("poor fit" in note for note in fit.notes)
    assert not any("the verdict is of the others" in note for note in fit.notes)


def test_outliers_are_a_fifth_of_the_directions_at_most():
    weight = np.ones((3, 10, 2))
    weight[0, :2], weight[1, :3] = 0.1, 0.1
    weight[2, 5:], weight[2, 0] = np.nan, 0.1
    assert outliers(weight).sum(axis=1).tolist() == [2, 0, 1]


@pytest.mark.parametrize("moving", [False, True], ids=["one sun", "a sun for each wavelength"])
def test_samples_near_the_sun_are_masked_and_counted(clean, moving):
    sky = clean
    if moving:
        shape = 1, sky.wavelength_nm.size
        sky = replace(sky, sun_zenith=np.linspace(0.85, 0.95, shape[1])[None], sun_azimuth=np.full(shape, 1.0))
    expected = []
    for w in range(sky.wavelength_nm.size):
        zenith, azimuth = (v[0, w] if v.ndim == 2 else v[0] for v in (sky.sun_zenith, sky.sun_azimuth))
        sun = np.asarray(skyfit.unit_vectors(zenith, azimuth))
        view = np.asarray(skyfit.unit_vectors(sky.view_zenith[0], sky.view_azimuth[0]))
        axis = int(np.flatnonzero(np.array(view.shape) == 3)[0])
        expected.append(np.degrees(np.arccos(np.tensordot(sun, view, (0, axis)))) < 25.0)
    masked = mask_sun(sky, np.radians(25.0))
    np.testing.assert_array_equal(~masked.usable[0], np.array(expected).T)
    assert masked.masked == {"within 25 degrees of the sun": np.sum(expected)} and np.sum(expected) > 0
    assert mask_sun(sky, 0.0).masked == {} and mask_sun(sky, 0.0).usable.all()
    with pytest.raises(ValueError, match="`angle` must be between 0 and pi"):
        mask_sun(sky, 10.0)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"sun_zenith": np.array([0.9, 1.6, 0.9])}, "the sun is at or below the horizon"),
        ({"usable": np.array([True, False, True])}, "no usable sample"),
    ],
)
def test_a_time_that_cannot_be_fitted_is_named_and_the_others_fitted(change, why):
    sky = as_sky(np.stack([by_hand()] * 3), noise=None)
    change = {k: np.broadcast_to(v[:, None, None], sky.usable.shape) if k == "usable" else v for k, v in change.items()}
    fit = skyfit.invert(replace(sky, **change), FREE, SOLVER)
    assert fit.values.shape == (2, 3) and fit.sky.time.tolist() == sky.time[[0, 2]].tolist()
    assert f"2025-10-05T12:30:00Z not fitted: {why}" in fit.notes
    np.testing.assert_allclose(fit.values, [list(HAZE.values())] * 2, rtol=5e-3)
    with pytest.raises(ValueError, match="`sky` "):
        skyfit.invert(replace(sky, **change).at(1), FREE, SOLVER)


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("1..3", [0, 1, 2]), ("2..3", [1, 2]), ("2", [1]), ("..2", [0, 1]), ("3..", [2, 3]), ("..", [0, 1, 2, 3]),
        ("4..9", [3]), ("2025-10-05T12:30Z..2025-10-05T13:00Z", [1, 2]), ("2025-10-05T12:31..", [2, 3]),
        ("2025-10-05", [0, 1, 2, 3]), ("2025-10-05T13:00", [2]), ("2..2025-10-05T13:00:00", [1, 2]),
        ("2025-10-05T14:30+02:00..", [1, 2, 3]),
    ],
)  # fmt: skip
def test_times_are_chosen_by_number_or_moment(text, chosen):
    sky = as_sky(np.ones((4, 5, 15)))
    assert times_of(text, sky).tolist() == chosen
    part = sky.at_times(chosen)
    assert part.time.tolist() == sky.time[chosen].tolist() and part.radiance.shape == (len(chosen), 5, 15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("5..", "one of the file's 4 times"),
        ("3..2", "2025-10-05T12:00:00Z to"),
        ("noon..", "a number from 1"),
    ],
)
def test_times_that_are_none_are_refused(text, said):
    with pytest.raises(ValueError, match=said):
        times_of(text, as_sky(np.ones((4, 5, 15))))


def test_reasons_stay_when_times_are_chosen():
    sky = as_sky(np.stack([by_hand()] * 3), noise=None)
    masked = mask_sun(sky, np.radians(25.0))
    (near,) = masked.masked.values()
    assert near % 3 == 0 and masked.at_times([0, 2]).masked == {"within 25 degrees of the sun": 2 * near // 3}
    # what a user masks besides has no reason
    usable = masked.usable.copy()
    usable[1, np.flatnonzero(usable[1, :, 0])[0]] = False
    again = replace(masked, usable=usable).at_times([1, 2])
    assert again.masked == {"within 25 degrees of the sun": 2 * near // 3, "suspect": 15}
    assert again.at(0).masked == {"within 25 degrees of the sun": near // 3, "suspect": 15}
    assert again.at(1).masked == {"within 25 degrees of the sun": near // 3}
    assert mask_sun(masked, np.radians(25.0)) is masked
