"""Named constituents in an order: many of them, their gases, and the block of names and numbers in a file."""

import copy
import inspect
import json
import pickle
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skies import unit_scene, views

import skyfit
from skyfit.analytic import Sunlight
from skyfit.atmosphere import (
    AbstractConstituent,
    AbstractPhase,
    AbstractProfile,
    Aerosol,
    Atmosphere,
    CONSTITUENTS,
    CornetteShanks,
    describe,
    Droplets,
    Exponential,
    from_description,
    Gas,
    Ground,
    HenyeyGreenstein,
    Layered,
    Levels,
    MOLECULES_PER_DOBSON,
    Ozone,
    OzoneLayer,
    PHASES,
    Prescribed,
    PROFILES,
    Rayleigh,
    RayleighPhase,
    Tabulated,
    TwoModeAerosol,
    TwoTermHenyeyGreenstein,
)
from skyfit.scene import relative_airmass
from skyfit.tables import read_table
from skyfit.transport import OrdersOfScattering, Shells, SingleScattering


COLOURS = np.array([430.0, 550.0, 610.0])
# made up: nm, and cm^2 a molecule of a gas that absorbs in the blue as nitrogen dioxide does
NO2_NM = [300.0, 400.0, 440.0, 500.0, 600.0, 700.0]
NO2_CM2 = [1e-19, 6e-19, 5e-19, 2e-19, 2e-20, 0.0]


def no2(column=0.5) -> Gas:
    return Gas.from_cross_section(column, NO2_NM, NO2_CM2, Exponential(2000.0))


def aloft(depth=0.02) -> Aerosol:
    return Aerosol(depth, 0.8, profile=Layered([0.0, 15e3, 20e3], [0.0, 1.0]))


def crowded() -> Atmosphere:
    """Not in the order of the alphabet, and none where a dictionary would put it."""
    return Atmosphere(aerosol=Aerosol(0.1), stratosphere=aloft(), no2=no2(), dust=TwoModeAerosol(0.05))


NAMES = ("rayleigh", "aerosol", "ozone", "stratosphere", "no2", "dust")


def by_file(atmosphere):
    return from_description(json.loads(json.dumps(describe(atmosphere))))


def first_of_batch(atmosphere):
    two = jax.tree.map(lambda leaf: jnp.stack([leaf, 2.0 * leaf]), atmosphere)
    return jax.tree.map(lambda leaf: leaf[0], jax.vmap(lambda a: a)(two))


def by_halves(atmosphere):
    chosen = jax.tree.map(lambda _: False, atmosphere)
    chosen = eqx.tree_at(lambda a: [a.stratosphere.optical_depth, a.no2.column], chosen, [True, True])
    return eqx.combine(*eqx.partition(atmosphere, chosen))


WAYS = {
    "jit": jax.jit(lambda a: a),
    "vmap": first_of_batch,
    "partition": by_halves,
    "flatten": lambda a: jax.tree.unflatten(jax.tree.structure(a), jax.tree.leaves(a)),
    "a file": by_file,
    "pickle": lambda a: pickle.loads(pickle.dumps(a)),
    "copy": copy.deepcopy,
    "replaced by itself": lambda a: a.replace(stratosphere=a.stratosphere),
}


@pytest.mark.parametrize("way", WAYS)
def test_order_and_equality_survive(way):
    atmosphere = crowded()
    again = WAYS[way](atmosphere)
    assert again.names == NAMES and bool(eqx.tree_equal(again, atmosphere))
    assert [type(c) for c in again.constituents] == [type(c) for c in atmosphere.constituents]
    assert jax.tree.structure(again) == jax.tree.structure(atmosphere)


def test_a_gradient_has_the_names_of_its_atmosphere():
    scene = unit_scene(50.0, views([30.0], [20.0]), COLOURS)
    slope = jax.grad(lambda a: SingleScattering(8, "flat").radiance(a, scene).sum())(crowded())
    assert slope.names == NAMES and all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slope))
    assert float(slope.no2.column) < 0.0 < float(slope.aerosol.optical_depth)


def test_a_constituent_is_read_by_its_name():
    atmosphere = crowded()
    for name, constituent in zip(atmosphere.names, atmosphere.constituents, strict=True):
        assert atmosphere[name] is constituent is getattr(atmosphere, name) and name in atmosphere
    assert "fog" not in atmosphere
    with pytest.raises(AttributeError, match=f"no `fog`, only {', '.join(NAMES)}"):
        _ = atmosphere.fog
    with pytest.raises(KeyError, match="no `fog`, only rayleigh"):
        atmosphere["fog"]
    with pytest.raises(AttributeError, match="only its ground"):
        _ = Atmosphere(None, None, None).rayleigh


def test_a_leaf_is_set_also_where_a_half_has_none():
    chosen = eqx.tree_at(lambda a: a.no2.column, jax.tree.map(lambda _: False, crowded()), True)
    _, rest = eqx.partition(crowded(), chosen)
    assert rest.no2.column is None
    filled = eqx.tree_at(lambda a: a.no2.column, rest, jnp.asarray(2.0), is_leaf=lambda x: x is None)
    assert float(filled.no2.column) == 2.0 and filled.names == NAMES
    moved = eqx.tree_at(lambda a: a.aerosol.optical_depth, crowded(), jnp.asarray(0.4))
    assert float(moved.aerosol.optical_depth) == pytest.approx(0.4)
    assert moved.stratosphere.optical_depth == crowded().stratosphere.optical_depth


def test_one_is_replaced_added_or_left_out():
    changed = crowded().replace(ozone=None, aerosol=Aerosol(0.3), fog=Droplets.fog(), ground=Ground(0.5))
    assert changed.names == ("rayleigh", "aerosol", "stratosphere", "no2", "dust", "fog")
    assert float(changed.aerosol.optical_depth) == pytest.approx(0.3) and float(changed.ground.albedo) == 0.5
    assert crowded().names == NAMES and float(crowded().ground.albedo) == pytest.approx(0.1)
    # the familiar ones have their places also when they come later
    assert Atmosphere(None, fog=Droplets.fog()).replace(rayleigh=Rayleigh()).names == ("rayleigh", "ozone", "fog")


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"replace": Aerosol(0.1)}, "`replace` must be another name"),
        ({"names": Aerosol(0.1)}, "`names` must be another name"),
        ({"_fog": Aerosol(0.1)}, "`_fog` must be another name"),
        ({"wet haze": Aerosol(0.1)}, "`wet haze` must be another name"),
    ],
)
def test_a_name_that_means_something_else_is_refused(parts, told):
    with pytest.raises(ValueError, match=told):
        Atmosphere(**parts)


# what physics says is one and the same: (parts, merged)
SAME = {
    "three hazes": (
        {"aerosol": Aerosol(0.1), "second": Aerosol(0.06), "third": Aerosol(0.04)},
        {"aerosol": Aerosol(0.2)},
    ),
    "two gases": (
        {"aerosol": Aerosol(0.1), "no2": no2(2.0), "more_no2": no2(3.0)},
        {"aerosol": Aerosol(0.1), "no2": no2(5.0)},
    ),
    "ozone in two": ({"ozone": Ozone(100.0), "o3": Ozone(200.0)}, {"ozone": Ozone(300.0)}),
    "another order": (
        {"haze": Aerosol(0.1), "gas": no2(), "air": Rayleigh(), "rayleigh": None},
        {"aerosol": Aerosol(0.1), "no2": no2()},
    ),
}


@pytest.mark.parametrize("case", SAME)
def test_constituents_of_one_kind_add_up(x64, case):
    scene = unit_scene(60.0, views([20.0, 75.0], [10.0, 160.0]), COLOURS)
    as_float64 = [jax.tree.map(lambda leaf: jnp.asarray(leaf, float), parts) for parts in SAME[case]]
    # the levels of all orders are at steps of the scatterers' mean column: another haze moves them
    moved = 3e-3 if case == "three hazes" else 1e-6
    # 1e-6: what stands above is of float32
    for solver, tolerance in ((SingleScattering(8, "flat"), 1e-6), (OrdersOfScattering.draft("flat"), moved)):
        several, one = (solver.radiance(Atmosphere(**parts), scene) for parts in as_float64)
        np.testing.assert_allclose(several, one, rtol=tolerance)
    # and with the gases a sky of another colour
    assert not np.allclose(one, solver.radiance(Atmosphere(None, Aerosol(0.1), None), scene), rtol=0.05)


def test_air_is_what_is_named_so():
    """One object under two names is air under one of them only."""
    scene = unit_scene(60.0, views([20.0, 75.0], [10.0, 160.0]), COLOURS)
    air, twin = Rayleigh(), Rayleigh()
    for solver, call in (
        (Shells(blue_sky="constant"), lambda s, a: s.radiance(a, scene)),
        (Shells(geometry="flat", low_sun=True), lambda s, a: s.path(a, scene, jnp.full(4, 5e3)).inscatter),
    ):
        same, equal = (call(solver, Atmosphere(air, haze)) for haze in (air, twin))
        np.testing.assert_array_equal(same, equal)
        assert not np.allclose(same, call(solver, Atmosphere(air)), rtol=0.05)


def test_without_ozone_there_is_no_ozone_in_the_program():
    scene, rows = (
        unit_scene(60.0, views([20.0], [10.0]), COLOURS),
        len(read_table("spectrl2_absorption.csv")["ozone_absorption"]),
    )

    def program(atmosphere):
        return str(jax.make_jaxpr(lambda a: SingleScattering(8, "flat").radiance(a, scene))(atmosphere))

    table = f"f32[{rows}]"
    with_ozone, without = (
        program(Atmosphere(aerosol=Aerosol(0.1))),
        program(Atmosphere(None, Aerosol(0.1), None, no2=no2())),
    )
    assert table in with_ozone and table not in without
    assert len(program(Atmosphere(ozone=None))) < len(program(Atmosphere()))


# --- gases


@pytest.mark.parametrize("polarised", [False, True])
def test_the_optics_of_a_sky_are_worked_out_once(polarised):
    asked = []

    class Counted(Aerosol):
        def optical_depth_at(self, wavelength_nm):
            asked.append(wavelength_nm.shape)
            return super().optical_depth_at(wavelength_nm)

    atmosphere = Atmosphere(air=Rayleigh(), haze=Counted(0.2))
    solver = OrdersOfScattering.draft(polarised=polarised)
    sky = jax.eval_shape(lambda a: solver.radiance(a, unit_scene(0.5, views([20.0], [10.0]), COLOURS)), atmosphere)
    assert sky.shape == (1, 3)
    assert asked == [(3,)]


def test_a_gas_is_its_table_times_its_column():
    found = no2(0.5).optical_depth_at(jnp.array([400.0, 420.0, 700.0, 900.0]))
    per_dobson = np.array([6e-19, 5.5e-19, 0.0, 0.0]) * 2.6868e16
    np.testing.assert_allclose(found, 0.5 * per_dobson, rtol=2e-5)
    molecules = Gas(1e16, NO2_NM, NO2_CM2, Exponential(2000.0), unit="molecules cm-2")
    same = no2(1e16 / MOLECULES_PER_DOBSON)
    np.testing.assert_allclose(molecules.optical_depth_at(COLOURS), same.optical_depth_at(COLOURS), rtol=1e-5)
    assert (no2().unit, molecules.unit, Ozone().unit) == ("DU", "molecules cm-2", "DU")
    for gas in (no2(), Ozone()):
        assert gas.phase is None and not np.any(gas.single_scattering_albedo_at(jnp.asarray(COLOURS)))
    slope = jax.grad(lambda g: g.optical_depth_at(jnp.array([400.0]))[0])(no2())
    np.testing.assert_allclose(slope.absorption_per_unit, [0.0, 0.5, 0.0, 0.0, 0.0, 0.0], atol=1e-6)
    with pytest.raises(ValueError, match="`absorption_per_unit` must be given at `table_wavelength_nm`"):
        Gas.from_cross_section(1.0, NO2_NM, NO2_CM2[:3], Exponential(2000.0))


def test_sunlight_has_the_atmospheres_ozone(x64):
    nm = np.array([310.0, 450.0, 600.0, 605.0, 760.0, 900.0])
    papers = Ozone(350.0, table="preetham").optical_depth_at(jnp.asarray(nm))
    beam = Sunlight(2.0, ozone=350.0 * 1e-5).factors(0.8, nm).ozone
    np.testing.assert_allclose(-np.log(beam), papers * relative_airmass(jnp.asarray(0.8)), rtol=1e-9, atol=1e-15)
    # Preetham 1999, Table 2, per metre; between the rows of Bird & Riordan there is less
    assert float(papers[2]) == pytest.approx(12.5 * 350.0 * 1e-5, rel=1e-12)
    np.testing.assert_allclose(Ozone(350.0).optical_depth_at(jnp.asarray(nm)), papers, rtol=0.08)


# --- the block of a file

PARTS = {
    "paper air": Rayleigh(9e4, RayleighPhase(0.0), formula="paper"),
    "haze": Aerosol(0.123, 0.9, phase=TwoTermHenyeyGreenstein(0.8, -0.4, 0.85), profile=Levels.elterman_1968()),
    "spheres": TwoModeAerosol(0.2, refractive_index=1.45),
    "bins of spheres": skyfit.BinnedAerosol(np.full(22, 0.01), absorption_index_exponent=1.0),
    "their phase": Aerosol(0.2, phase=TwoModeAerosol(0.2).phase),
    "fog": Droplets.fog(0.01, 50.0),
    "gas": no2(),
    "ozone": Ozone(310.0, OzoneLayer(22e3), "preetham"),
    "given": Prescribed(np.array([0.1, 0.2]), aloft().profile, CornetteShanks(0.6), np.array([0.9, 0.8])),
    "given absorber": Prescribed(np.array([0.1, 0.2]), Exponential(1e3)),
    "table": Aerosol(0.1, phase=Tabulated.bullrich(), profile=Levels.us_standard_1976()),
    "matrix": Aerosol(0.1, phase=Tabulated([0.0, 3.0], [550.0], [[1.0], [0.5]], 0.3, [[[-0.3], [0.0]]] * 3)),
}  # fmt: skip


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("name", PARTS)
def test_every_kind_comes_back_from_its_block(name, wide):
    with jax.enable_x64(wide):
        part = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), PARTS[name])
        atmosphere = Atmosphere(None, None, None, Ground(np.array([0.1, 0.3])), part=part)
        again = by_file(atmosphere)
        assert bool(eqx.tree_equal(again, atmosphere)) and again.names == ("part",)
        assert all(leaf.dtype == jnp.result_type(float) for leaf in jax.tree.leaves(again))


def concrete(base) -> set[type]:
    below = {c for kind in base.__subclasses__() for c in concrete(kind)}
    return below | ({base} if not inspect.isabstract(base) and base.__module__.startswith("skyfit.") else set())


@pytest.mark.parametrize(
    ("base", "registry"), [(AbstractConstituent, CONSTITUENTS), (AbstractPhase, PHASES), (AbstractProfile, PROFILES)]
)
def test_the_registries_hold_every_class(base, registry):
    assert concrete(base) == set(registry.values())


def test_a_block_is_short_and_its_numbers_are_those_that_were_given():
    block = describe(Atmosphere(aerosol=Aerosol(0.1)))
    assert block["constituents"]["aerosol"] == {
        "kind": "Aerosol", "optical_depth": 0.1, "angstrom_exponent": 1.3, "single_scattering_albedo": 0.95,
        "single_scattering_albedo_slope": 0.0,
        "phase": {"kind": "HenyeyGreenstein", "asymmetry": 0.7, "polarisation": 0.25},
        "profile": {"kind": "Exponential", "scale_height": 1200.0}, "angstrom_curvature": 0.0,
    }  # fmt: skip
    assert block["ground"] == {"albedo": 0.1, "albedo_slope": 0.0, "red_edge": 0.0}


def test_what_a_block_by_hand_leaves_out_is_as_usual():
    text = """
        [constituents.rayleigh]
        kind = "Rayleigh"
        pressure = 95000
        [constituents.dust]
        kind = "Aerosol"
        optical_depth = 0.3
        phase = {kind = "CornetteShanks", asymmetry = 0.8}
        profile = {kind = "Layered", edges = [0, 2000, 5000], fraction = [0.2, 0.8]}
        [ground]
        albedo = 0.3
    """
    dust = Aerosol(0.3, phase=CornetteShanks(0.8), profile=Layered([0.0, 2e3, 5e3], [0.2, 0.8]))
    assert from_description(tomllib.loads(text)) == Atmosphere(Rayleigh(95e3), None, None, Ground(0.3), dust=dust)
    assert from_description({}) == Atmosphere()
    assert from_description({"constituents": {}}) == Atmosphere(None, None, None)


def part(**block):
    return {"constituents": {"x": block}}


def one(**fields):
    return part(**({"kind": "Aerosol", "optical_depth": 0.1} | fields))


TABLE = {"kind": "Tabulated", "angle": [0, 1], "table_wavelength_nm": [500, 600], "log_value": [[1, 2], [1, 3]]}
GAS = {"column": 1, "table_wavelength_nm": [500], "absorption_per_unit": [0.1], "profile": {"kind": "OzoneLayer"}}


BAD = {
    "a key more": ({"air": 1}, r"`air`: expected only constituents, ground"),
    "no kind": (part(), r"`X\.kind`: expected one of Rayleigh, .*found none"),
    "kind": (one(kind="Haze"), r"`X\.kind`: expected one of Rayleigh, .*found 'Haze'"),
    "kind that is none": (one(kind=[]), r"`X\.kind`"),
    "a class of one's own": (one(kind="mine.Haze"), r"`X\.kind`.*'mine\.Haze', which only the program that made it"),
    "no depth": (
        {"constituents": {"x": {"kind": "Aerosol"}}},
        r"`X\.optical_depth`: expected, found none",
    ),
    "a flag": (one(optical_depth=True), r"`X\.optical_depth`: expected a number, found True"),
    "nan": (one(optical_depth=float("nan")), r"`X\.optical_depth`: expected a number, found nan"),
    "too large": (one(optical_depth=10**400), r"`X\.optical_depth`: expected a number"),
    "a list": (one(optical_depth=[0.1]), r"`X\.optical_depth`: expected a number, found \[0\.1\]"),
    "a field more": (one(height=3.0), r"`X\.height`: expected only kind, optical_depth"),
    "a setting": (
        part(kind="Rayleigh", formula="x"),
        r'`X\.formula`: expected "bodhaine" or',
    ),
    "a unit": (part(kind="Gas", unit=3, **GAS), r"`X\.unit`: expected str, found 3"),
    "no block": (one(profile=3.0), r"`X\.profile`: expected a block, found 3\.0"),
    "another class": (
        one(profile={"kind": "HenyeyGreenstein"}),
        r"`X\.profile\.kind`: expected one of E",
    ),
    "no list": (one(profile={"kind": "Layered", "edges": 0.0}), r"`X\.profile\.edges`: expected a list, found 0\.0"),
    "ragged": (
        one(phase=TABLE | {"log_value": [[1, 2], [1]]}),
        r"`X\.phase\.log_value\[1\]`: expected 2 numbers, found 1",
    ),
    "two lengths": (
        one(phase=TABLE | {"table_wavelength_nm": [500]}),
        r"`X\.phase\.log_value`: expected as many numbers as in `.*table_wavelength_nm`, 1, found 2",
    ),
    "the class's own word": (
        one(profile={"kind": "Layered", "edges": [0.0, 1.0], "fraction": [0.1, 0.2]}),
        r"`X\.profile`: `edges` must have one entry more",
    ),
    "a word for a name": (
        {"constituents": {"a b": {"kind": "Rayleigh"}}},
        r"`constituents`: `a b` must be another",
    ),
    "ground inside": ({"constituents": {"ground": {"kind": "Rayleigh"}}}, r"`constituents\.ground`: expected beside"),
    "ground": ({"ground": {"albedo": [[0.1]]}}, r"`ground\.albedo\[0\]`: expected a number, found \[0\.1\]"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_block_is_refused_in_a_line_that_names_the_key(case):
    block, told = BAD[case]
    with pytest.raises(ValueError, match="^key " + told.replace("X", r"constituents\.x")) as caught:
        from_description(block)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"^key `site\."):
        from_description(block, "site")


def test_a_user_may_name_any_number_of_them():
    many = Atmosphere(**{f"layer_{i}": Aerosol(0.01 * i, phase=HenyeyGreenstein(0.5)) for i in range(1, 9)})
    assert many.names[2:] == tuple(f"layer_{i}" for i in range(1, 9))
    depth = sum(float(c.optical_depth_at(jnp.array([550.0]))[0]) for c in many.constituents[2:])
    assert depth == pytest.approx(0.36, rel=1e-5) and skyfit.Gas is Gas
