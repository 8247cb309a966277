"""The solver that `choose` finds for an error, what it says, and the bound of `estimate_error`."""

import json
import re
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import skyfit
from skyfit import choose, OrdersOfScattering, SingleScattering, Spherical
from skyfit.tables import read_arrays, read_table
from skyfit.transport.choose import candidates_of, streams_of
from skyfit.transport.estimate import bound_of, estimate_error, picked, refinement
from skyfit.transport.work import seconds


AIR = skyfit.Atmosphere.from_turbidity(3.0)
COLOURS = np.array([400.0, 600.0, 800.0])


def scene(sun=40.0, colours=COLOURS, edge=75.0, **more):
    return skyfit.Scene.from_degrees(sun, skyfit.hemisphere(60, np.radians(edge)), colours, **more)


def test_a_smaller_tolerance_takes_longer_and_is_kept():
    found = [choose(AIR, scene(), tolerance) for tolerance in (0.3, 0.1, 0.03, 0.01)]
    assert all(choice.met and choice.known for choice in found)
    assert all(
        choice.expected_error <= tolerance for choice, tolerance in zip(found, (0.3, 0.1, 0.03, 0.01), strict=True)
    )
    took = [choice.seconds for choice in found]
    assert took == sorted(took) and took[0] < took[-1]


def test_the_median_asks_for_less_than_the_maximum():
    largest, middle = (choose(AIR, scene(), 0.01, of=of) for of in ("maximum", "median"))
    assert middle.seconds < largest.seconds and middle.reasons[0].startswith("median over 60 directions")


def test_what_no_solver_meets_is_said():
    choice = choose(AIR, scene(), 1e-4)
    assert not choice.met and choice.expected_error > 1e-4
    assert choice.reasons[-1].startswith("no solver stays under 0.01 %: the nearest may be")
    assert isinstance(choice.solver, OrdersOfScattering) and choice.solver.polarised


@pytest.mark.parametrize("sun, height", [(93.0, None), (40.0, 5e3)])
def test_twilight_and_observers_aloft_are_left_to_the_sphere(sun, height):
    choice = choose(AIR, scene(sun, height=height), 0.5)
    assert isinstance(choice.solver, Spherical) and not choice.known
    assert any("Spherical" in reason for reason in choice.reasons)


def test_constituents_that_change_nothing_are_left_out():
    weak = skyfit.Atmosphere.from_turbidity(3.0).replace(
        volcano=skyfit.Aerosol(1e-7),
        ozone=skyfit.Ozone(300.0),
        no2=skyfit.Gas(1e-9, [300.0, 1100.0], [1.0, 1.0], skyfit.Exponential(1e3)),
    )
    choice = choose(weak, scene(), 0.03)
    assert choice.atmosphere.names == ("rayleigh", "aerosol", "ozone")
    assert any(reason.startswith("volcano changes nothing above") for reason in choice.reasons)
    # near 345 nm and beyond 900 nm ozone absorbs next to nothing
    assert "ozone" not in choose(AIR, scene(colours=np.array([950.0, 1000.0])), 0.03).atmosphere
    assert "ozone" in choose(AIR, scene(colours=np.array([600.0])), 0.01).atmosphere


def lowered(solver, atmosphere, colours=COLOURS):
    """The operations of the lowered program and the shapes of its arrays, with how often each stands there."""
    here = scene(colours=colours)
    text = jax.jit(lambda air: solver.radiance(air, here)).lower(atmosphere).as_text()
    return tuple(Counter(re.findall(form, text)) for form in (r"stablehlo\.(\w+)", r"tensor<([\dx]+)xf"))


def test_a_constituent_that_is_left_out_leaves_no_trace():
    infrared = np.array([950.0, 1000.0])
    choice = choose(AIR, scene(colours=infrared), 0.03)
    less, more = (lowered(choice.solver, air, infrared) for air in (choice.atmosphere, AIR))
    assert "ozone" not in choice.atmosphere and all(less[0][name] <= more[0][name] for name in less[0])
    table = str(read_table("spectrl2_absorption.csv")["wavelength_nm"].size)
    assert less[1][table] == 0 < more[1][table]
    # without haze the modes go too that air has none of
    clear = AIR.replace(aerosol=skyfit.Aerosol(1e-7))
    choice = choose(clear, scene(), 0.03)
    less, more = (lowered(choice.solver, air) for air in (choice.atmosphere, clear))
    modes = choice.solver.modes
    assert "aerosol" not in choice.atmosphere and all(less[0][name] <= more[0][name] for name in less[0])
    assert not any(str(modes) in shape.split("x") for shape in less[1])
    assert any(str(modes) in shape.split("x") for shape in more[1])


def test_orders_that_are_left_out_leave_no_trace():
    once = choose(AIR, scene(), 1.0).solver
    less, more = (lowered(solver, AIR)[0] for solver in (once, streams_of("6 streams", once.geometry, False, 0)))
    assert isinstance(once, SingleScattering) and less["while"] == 0 < more["while"]
    assert all(less[name] <= more[name] for name in less)


@pytest.mark.slow
def test_polarisation_and_curved_paths_that_are_left_out_leave_no_trace():
    flat, whole, round_ = (
        streams_of("6 streams", *kind, 0) for kind in (("flat", False), ("flat", True), ("spherical", False))
    )
    assert {flat, whole} <= {*candidates_of(AIR, scene(colours=np.linspace(400.0, 800.0, 81)))}
    less, polarised, bent = (lowered(solver, AIR)[0] for solver in (flat, whole, round_))
    assert less["while"] < polarised["while"] and less["dot_general"] < polarised["dot_general"]
    assert less["sqrt"] < bent["sqrt"] and less["dot_general"] < bent["dot_general"]
    for more in (polarised, bent):
        # how functions are cut is no work; on a flat Earth the edges of layers are sorted
        work = set(less) - {"return", "sort"}
        assert sum(less.values()) < sum(more.values()) and all(less[name] <= more[name] for name in work)


def test_a_dark_scene_needs_no_solver():
    choice = choose(skyfit.Atmosphere(None), scene(), 0.01)
    assert isinstance(choice.solver, SingleScattering) and choice.expected_error == 0.0
    down = skyfit.Scene.from_degrees(40.0, skyfit.Directions.from_degrees(120.0, 0.0), COLOURS)
    assert choose(AIR, down, 0.01).expected_error == 0.0


def test_more_than_the_model_of_errors_knows_is_flagged():
    for air, colours in ((skyfit.Atmosphere.from_optical_depth(20.0), COLOURS), (AIR, np.array([320.0, 500.0]))):
        choice = choose(air, scene(colours=colours), 0.1)
        assert not choice.known and any("beyond what the errors were fitted to" in reason for reason in choice.reasons)


def test_traced_values_and_wrong_arguments_are_refused():
    for call in (
        lambda t: choose(skyfit.Atmosphere.from_turbidity(t), scene(), 0.1).expected_error,
        lambda t: choose(AIR, scene(t), 0.1).expected_error,
        lambda t: estimate_error(SingleScattering(), skyfit.Atmosphere.from_turbidity(t), scene()).bound,
    ):
        with pytest.raises(ValueError, match="outside of jit, vmap and grad"):
            jax.jit(call)(2.0)
    for tolerance in (0.0, -1.0, 1.5, float("nan")):
        with pytest.raises(ValueError, match="`tolerance` must be above 0"):
            choose(AIR, scene(), tolerance)
    with pytest.raises(ValueError, match="sun_zenith"):
        choose(AIR, scene(120.0), 0.1)
    with pytest.raises(ValueError, match="`directions` must be at least 4"):
        estimate_error(SingleScattering(), AIR, scene(), directions=2)


def test_counted_time_grows_with_what_is_asked_for():
    few, many = scene(), skyfit.Scene.from_degrees(40.0, skyfit.hemisphere(2000), np.arange(380.0, 781.0, 10.0))
    orders = OrdersOfScattering
    ladder = [SingleScattering.normal(), orders.draft(), orders.normal(), orders.normal(polarised=True), orders.fine()]
    for here in (few, many):
        took = [seconds(solver, AIR, here) for solver in ladder]
        assert took == sorted(took)
    assert all(seconds(solver, AIR, few) < seconds(solver, AIR, many) for solver in ladder)
    with pytest.raises(ValueError, match="whose work is counted"):
        seconds(skyfit.Uniform(), AIR, few)


def test_what_is_solved_anew_has_the_lowest_views_and_those_next_to_the_sun():
    here = scene(edge=90.0)
    views, colours = picked(AIR, here, 8, 2)
    assert views.size <= 8 and colours.tolist() == [0, 2]
    zenith = np.asarray(here.view.zenith)
    assert {*np.argsort(zenith)[-2:]} <= {*views} and np.argmin(zenith) in views
    apart = skyfit.scene.angle_between(here.view.zenith, here.sun_zenith, here.view.azimuth - here.sun_azimuth)
    assert int(np.argmin(apart)) in views
    given = AIR.replace(haze=skyfit.Prescribed([0.1, 0.1, 0.1], skyfit.Exponential(1e3)))
    assert picked(given, here, 8, 2)[1].tolist() == [0, 1, 2]


def test_the_refined_solver_is_finer():
    for name in ("draft", "normal", "fine"):
        solver = getattr(OrdersOfScattering, name)()
        finer = refinement(solver, scene())
        assert finer.streams > solver.streams and finer.levels > solver.levels and finer.polarised
    assert isinstance(refinement(SingleScattering(), scene(95.0)), Spherical)
    bound, largest = bound_of(np.array([[1.0, 0.0, 2.2]]), np.array([[1.0, 0.0, 2.0]]))
    assert largest == pytest.approx(0.1) and bound > largest


@pytest.mark.slow
def test_chosen_solvers_are_within_the_tolerance_of_scenes_of_the_finest(x64):
    # of other scenes than the model of errors was fitted to: experiments/tables/make_error_model.py
    shipped = read_arrays("choose_scenes.npz")
    rows = zip(*(shipped[name] for name in ("values", "zenith", "azimuth", "wavelength", "radiance")), strict=True)
    within, kinds = [], set()
    for values, zenith, azimuth, wavelength, right in rows:
        sun, depth, asymmetry, albedo, ground, height, ozone, exponent, pressure = values
        haze = skyfit.Aerosol(
            depth, exponent, albedo, phase=skyfit.HenyeyGreenstein(asymmetry), profile=skyfit.Exponential(height)
        )
        air = skyfit.Atmosphere(skyfit.Rayleigh(pressure), haze, skyfit.Ozone(ozone), skyfit.Ground(ground))
        here = skyfit.Scene.from_degrees(sun, skyfit.Directions(zenith, azimuth), wavelength, irradiance="unit")
        choice = choose(air, here, 0.05)
        if (
            isinstance(choice.solver, OrdersOfScattering)
            and choice.solver.streams == 6
            and len(choice.atmosphere.names) == 3
        ):
            kinds.add(choice.solver)
            found = np.asarray(choice.solver.radiance(choice.atmosphere, here))
            within.append(bool(np.abs(found / right - 1.0).max() <= 0.05))
    assert len(within) >= 6 and all(within)


@pytest.mark.slow
def test_the_estimate_is_a_bound(x64):
    here = scene(colours=np.array([450.0, 700.0]))
    estimate = estimate_error(OrdersOfScattering.draft(polarised=True), AIR, here)
    right = np.asarray(OrdersOfScattering.fine(polarised=True).radiance(AIR, here))
    off = np.abs(np.asarray(OrdersOfScattering.draft(polarised=True).radiance(AIR, here)) / right - 1.0).max()
    assert off <= estimate.bound <= 10.0 * off


def test_the_command_takes_a_tolerance(skyfit_command, tmp_path):
    asked = "simulate --sun-zenith 60 --turbidity 2 --wavelengths 500,600 --out sky.csv".split()
    done = skyfit_command(*asked, "--tolerance", "100%", cwd=tmp_path)
    assert "SingleScattering" in done.stdout and "one order" in done.stdout and "error to expect" in done.stdout
    (line,) = [row for row in (tmp_path / "sky.csv").read_text().splitlines() if row.startswith("# made_by: ")]
    choice = json.loads(line.removeprefix("# made_by: "))["choice"]
    assert choice["tolerance"] == 1.0 and choice["met"] and len(choice["reasons"]) > 3
    for more, said in (
        (["--tolerance", "none"], "`--tolerance` must be a share of the radiance"),
        (["--tolerance", "1%", "--preset", "fine"], "`--preset` must be left out with `--tolerance`"),
        (["--solver", "auto"], "must come with `--tolerance`"),
    ):
        wrong = skyfit_command(*asked, *more, cwd=tmp_path, check=False)
        assert wrong.returncode == 2 and said in wrong.stderr


@pytest.mark.parametrize(
    "asked",
    ["render --sun-zenith 60 --out a.png", "refit --out a", "invert {sample} --out a"],
    ids=["render", "refit", "invert"],
)
def test_every_command_takes_the_same_tolerance(skyfit_command, tmp_path, checkout, asked):
    words = asked.format(sample=checkout / "data" / "skies" / "sample.nc").split()
    for more, said in (
        (["--solver", "auto"], "must come with `--tolerance`"),
        (["--tolerance", "5%", "--preset", "fine"], "`--preset` must be left out with `--tolerance`"),
    ):
        wrong = skyfit_command(*words, *more, cwd=tmp_path, check=False)
        assert wrong.returncode == 2 and said in wrong.stderr and not list(tmp_path.iterdir())


def test_one_solver_is_chosen_for_all_skies_with_all_constituents(checkout):
    from skyfit.cli.chosen import scenes_of
    from skyfit.transport.choose import choose_for_all

    clear = AIR.replace(aerosol=skyfit.Aerosol(1e-7))
    assert "aerosol" not in choose(clear, scene(), 0.1).atmosphere
    assert choose_for_all([(clear, scene())], 0.1).atmosphere.names == clear.names
    easy, hard = (clear, scene(edge=40.0)), (AIR, scene(60.0, edge=89.0))
    both, each = choose_for_all([easy, hard], 0.1), [choose_for_all([sky], 0.1) for sky in (easy, hard)]
    # the one whose own choice is cheaper may not do for the other, but what does for both does for each
    assert both.met and both.expected_error <= 0.1
    assert both.seconds >= sum(choice.seconds for choice in each) > 0.0
    # under a sun that only the sphere knows its error is told for noon too, where another would be chosen
    low = (AIR, scene(95.0))
    sphere = choose_for_all([easy, low], 0.5)
    assert isinstance(sphere.solver, Spherical)
    alone = [choose_for_all([low], 0.5).expected_error, choose_for_all([(AIR, scene(20.0)), low], 0.5).expected_error]
    assert alone[1] >= alone[0]
    measured = skyfit.read(checkout / "data" / "skies" / "sample.nc")
    (seen,) = scenes_of(measured, AIR, None)
    assert seen.view.zenith.shape == measured.view_zenith[0].shape
    assert seen.wavelength_nm.shape == measured.wavelength_nm.shape


@pytest.mark.slow
def test_the_error_to_expect_is_the_model_error_of_a_fit(skyfit_command, tmp_path, checkout):
    sample = checkout / "data" / "skies" / "sample.nc"
    asked = "--free aerosol_optical_depth --out fit --tolerance 100%".split()
    done = skyfit_command("invert", sample, *asked, cwd=tmp_path, check=False)
    assert done.returncode == 0 and "SingleScattering" in done.stdout and "error to expect" in done.stdout
    kept = json.loads((tmp_path / "fit" / "fit.json").read_text())
    expected = float(re.search(r"error to expect: ([\d.e+-]+) %", done.stdout)[1])
    assert 100.0 * kept["measurement"]["model_error"] == pytest.approx(expected, rel=0.06)
    assert kept["choice"]["tolerance"] == 1.0 and kept["choice"]["met"] and len(kept["choice"]["reasons"]) > 3
    assert skyfit.load(tmp_path / "fit" / "fit.json").solver.geometry == kept["geometry"]


def test_numbers_that_decide_are_finite_in_hard_scenes():
    from skyfit.transport.deciding import deciding

    views = skyfit.Directions(jnp.asarray([0.0, 0.5, np.pi / 2, 0.5]), jnp.asarray([0.0, 0.0, 0.0, 3.0]))
    for air in (AIR, skyfit.Atmosphere.from_optical_depth(50.0), skyfit.Atmosphere.from_optical_depth(0.0)):
        for sun in (0.0, 0.5, np.pi / 2, 1.8):
            here = skyfit.Scene(sun, 0.0, views, COLOURS, np.ones(3))
            assert all(bool(np.all(np.isfinite(value))) for value in deciding(air, here))
