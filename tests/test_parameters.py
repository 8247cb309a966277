"""The parameters by name: their bounds, their leaves, and the names that cannot be fitted."""

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st
from made_skies import as_sky, FREE, SOLVER

import skyfit
from skyfit.atmosphere import Exponential, HenyeyGreenstein, Prescribed
from skyfit.retrieve import (
    check_free,
    LOBES_FREE,
    PARAMETERS,
    PARTICLE_FREE,
    SkyModel,
    SLOW,
    start_model,
    values_of,
    with_values,
)
from skyfit.retrieve.parameters import partition, SIZE_BINS


# of the bins one stands for all
NAMES = [name for name in PARAMETERS if name not in SIZE_BINS[1:]]


@pytest.mark.parametrize("name", NAMES)
@given(share=st.floats(0.0, 1.0), free=st.floats(-200.0, 200.0))
def test_bound_and_unbound_are_inverse(name, share, free):
    parameter = PARAMETERS[name]
    low, high = parameter.lower, parameter.upper
    ends = (np.log(low), np.log(high)) if parameter.log else (low, high)
    with jax.enable_x64(True):
        nudged = ends[0] + min(max(share, 0.01), 0.99) * (ends[1] - ends[0])
        value = ends[0] + share * (ends[1] - ends[0])
        value, nudged = (np.exp(v) if parameter.log else v for v in (value, nudged))
        back = float(parameter.bound(parameter.unbound(value)))
        assert back == pytest.approx(nudged, rel=1e-9, abs=1e-9 * (high - low))
        bounded = float(parameter.bound(free))
        slack = 1e-12 * (high - low)
        assert low - slack <= bounded <= high + slack


@pytest.mark.parametrize("name", NAMES)
def test_a_value_near_its_end_is_at_the_bound(name):
    parameter = PARAMETERS[name]
    # where the search ends, 3e-4 of the range from the bound, in the default float type
    assert parameter.at_bound(float(parameter.bound(np.float32(8.0))))
    assert parameter.at_bound(float(parameter.bound(np.float32(-8.0))))
    assert not parameter.at_bound(float(parameter.bound(np.float32(-5.0))))
    assert not parameter.at_bound(float(parameter.bound(np.float32(0.0))))


@pytest.mark.parametrize("name", NAMES)
@given(share=st.floats(0.0, 1.0))
def test_a_value_that_is_set_is_read_back_and_moves_no_other(name, share):
    parameter = PARAMETERS[name]
    value = parameter.lower + share * (parameter.upper - parameter.lower)
    with jax.enable_x64(True):
        # haze of two lobes, or of spheres where the name is one of theirs
        model = start_model((name, "forward_fraction"), 9.0e4)
        changed = values_of(with_values(model, (name,), [value]), PARAMETERS)
        assert changed.pop(name) == pytest.approx(value, rel=1e-12, abs=1e-12)
        before = values_of(model, PARAMETERS)
    one = {"turbidity", "aerosol_optical_depth"}
    for other in set(changed) - (one if name in one else set()):
        assert changed[other] == before[other]


def test_the_free_leaves_are_those_that_are_named():
    model = start_model(FREE, 101325.0)
    chosen, rest = partition(model, FREE)
    assert len(jax.tree.leaves(chosen)) == 3
    assert len(jax.tree.leaves(rest)) == len(jax.tree.leaves(model)) - 3
    assert values_of(with_values(rest, FREE, [0.3, 1.0, 0.5]), FREE) == pytest.approx(
        {"aerosol_optical_depth": 0.3, "angstrom_exponent": 1.0, "asymmetry": 0.5}, rel=1e-6
    )


@pytest.mark.parametrize(
    ("free", "parts"),
    [
        ((), ["`free`", "at least one"]),
        (("haze",), ["`free`", "'haze'", "`skyfit.PARAMETERS`"]),
        (("ozone", "asymmetry", "ozone"), ["`free`", "once", "ozone, asymmetry, ozone"]),
        (("turbidity", "aerosol_optical_depth"), ["`free`", "both turbidity and aerosol_optical_depth"]),
        (("asymmetry_second",), ["`free`", "'asymmetry_second'", "does not have"]),
    ],
)
def test_names_that_cannot_be_free(free, parts):
    one_lobe = start_model((), 101325.0)
    calls = (
        lambda: check_free(free, one_lobe),
        lambda: skyfit.invert(as_sky(np.ones((40, 15))), free, SOLVER, one_lobe),
    )
    for call in calls:
        with pytest.raises(ValueError) as caught:
            call()
        assert "\n" not in str(caught.value)
        assert all(part in str(caught.value) for part in parts), caught.value


@pytest.mark.parametrize("place", ["aerosol", "ozone", "rayleigh"])
def test_an_atmosphere_without_a_constituent_has_none_of_its_parameters(place):
    model = start_model((), 101325.0)
    atmosphere = model.atmosphere.replace(**{place: None})
    name = {"aerosol": "aerosol_optical_depth", "ozone": "ozone", "rayleigh": "pressure"}[place]
    with pytest.raises(ValueError, match=f"{name}.*does not have"):
        check_free((name,), type(model)(atmosphere))
    assert name not in values_of(type(model)(atmosphere), PARAMETERS)


def test_what_is_given_per_wavelength_is_no_parameter():
    haze = Prescribed(np.array([0.2, 0.1]), Exponential(1e3), HenyeyGreenstein(0.6), 0.9)
    model = SkyModel(skyfit.Atmosphere(aerosol=haze))
    found = values_of(model, PARAMETERS)
    assert "aerosol_optical_depth" not in found and found["single_scattering_albedo"] == pytest.approx(0.9)
    with pytest.raises(ValueError, match="aerosol_optical_depth.*does not have"):
        check_free(("aerosol_optical_depth",), model)


def test_what_holds_of_a_parameter_is_told_by_it():
    assert {"ozone", "pressure", "asymmetry"} <= set(SLOW)
    assert not {"turbidity", "aerosol_optical_depth", "ground_albedo", "pointing_zenith", "pointing_azimuth"} & set(
        SLOW
    )
    lobes, spheres = start_model(LOBES_FREE, 101325.0), start_model(PARTICLE_FREE, 101325.0)
    for names, has, lacks in ((LOBES_FREE, lobes, spheres), (PARTICLE_FREE, spheres, lobes)):
        check_free(names, has)
        kind = [n for n in names if PARAMETERS[n].group]
        assert kind and not values_of(lacks, kind)
    of_instrument = [p.name for p in PARAMETERS.values() if p.of_instrument]
    assert of_instrument == ["pointing_zenith", "pointing_azimuth", "sun_zenith_offset"]
