"""`skyfit simulate`."""

import math
from pathlib import Path
from typing import Annotated

import typer

from .known import SEA_LEVEL_PRESSURE
from .options import (
    AngstromExponent,
    AtmosphereOption,
    command,
    Context,
    GeometryName,
    GeometryOption,
    GroundAlbedo,
    HazeHeight,
    in_range,
    LineShape,
    OF_ATMOSPHERES,
    OzoneColumn,
    Place,
    PolarisedOption,
    PresetName,
    PresetOption,
    Pressure,
    refuse,
    SingleScatteringAlbedo,
    SolverOption,
    SunAzimuth,
    SunZenith,
    ToleranceOption,
)


# Options that an analytic sky does not use
_OF_SIMULATIONS = (
    *OF_ATMOSPHERES, "atmosphere", "fwhm", "solver", "preset", "geometry", "polarised", "tolerance",
)  # fmt: skip


@command("simulate", "skyfit simulate --sun-zenith 60 --turbidity 3 --out sky.nc")
def simulate(
    context: Context,
    out: Annotated[Path, typer.Option(help="file to write, .nc or .csv")],
    sun_zenith: SunZenith = None,
    sun_azimuth: SunAzimuth = None,
    time: Annotated[
        str | None, typer.Option(help="ISO, UTC: how far the sun is, and with --at where it stands")
    ] = None,
    at: Place = None,
    turbidity: Annotated[float | None, typer.Option(help="Preetham's, at 550 nm (>= 1)")] = None,
    aerosol_optical_depth: Annotated[float | None, typer.Option(help="at 550 nm, instead")] = None,
    meteorological_range: Annotated[float | None, typer.Option(help="visibility in km, instead")] = None,
    angstrom_exponent: AngstromExponent = 1.3,
    single_scattering_albedo: SingleScatteringAlbedo = 0.95,
    asymmetry: Annotated[float, typer.Option(help="of Henyey and Greenstein's phase function")] = 0.7,
    haze_height: HazeHeight = 1200.0,
    ground_albedo: GroundAlbedo = 0.1,
    ozone: OzoneColumn = 300.0,
    pressure: Pressure = SEA_LEVEL_PRESSURE,
    wavelengths: Annotated[str, typer.Option(help="nm, first:last:step or a,b,c")] = "380:780:10",
    directions: Annotated[Path | None, typer.Option(help="CSV with view_zenith, view_azimuth")] = None,
    atmosphere: AtmosphereOption = None,
    fwhm: LineShape = None,
    coefficients: Annotated[
        str | None, typer.Option(help="no solver but an analytic sky: published, extended or a coefficients.json")
    ] = None,
    solver: SolverOption = "orders",
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
    polarised: PolarisedOption = None,
    tolerance: ToleranceOption = None,
):
    """Simulate the spectral radiance of a clear sky.

    As solver.radiance(atmosphere, scene) in Python, here by OrdersOfScattering.normal(polarised=True) where no option
    says otherwise, and in float64; Python computes in the precision of its process, float32 where nobody asks for more.
    """
    import warnings

    import jax
    import numpy as np

    from ..atmosphere import describe, HenyeyGreenstein, turbidity_to_optical_depth
    from ..measured import read_directions, Sky, STATION_RANGES, write_sky
    from ..measured.station import day_of_year
    from ..measured.writing import skyfit_version
    from ..programs import keep_in
    from ..scene import Directions, hemisphere, Scene
    from ..transport import check_scene, choose, low_sun, LowSunWarning, Spherical, ThickAirWarning
    from .chosen import allowed_of, print_choice, record_of
    from .models import (
        in_words,
        kept_radiance,
        make_atmosphere,
        make_solver,
        precision,
        settings_of,
        sizes,
        turbidity_of,
        wavelengths_of,
    )
    from .printing import give, progress, say, warn
    from .sun import sun_of

    given = None if atmosphere is None else _given_atmosphere(context, atmosphere)
    haze = 1.0 if given else turbidity_of(turbidity, aerosol_optical_depth, meteorological_range, haze_height)
    analytic, lowest = (None, 90.0) if coefficients is None else _analytic_sky(context, coefficients)
    allowed = allowed_of(context, solver, tolerance, ("preset", "geometry", "polarised"))
    chosen = Spherical.normal()
    if allowed is None:
        chosen = make_solver(solver, preset, geometry, solver == "orders" if polarised is None else polarised)
    lowest = chosen.suns.largest_deg if analytic is None else lowest
    zenith, azimuth, about = sun_of(sun_zenith, sun_azimuth, time, at, pressure, lowest)
    if out.suffix not in (".nc", ".csv") or not out.absolute().parent.is_dir():
        raise ValueError(f"`--out` must be a .nc or .csv file in a folder that is there, got {out}")
    phase = HenyeyGreenstein(in_range("--asymmetry", asymmetry, -0.98, 0.98))
    air = given or make_atmosphere(
        phase, angstrom_exponent, single_scattering_albedo, haze_height, ground_albedo, ozone, pressure
    )(turbidity_to_optical_depth(haze))
    view = hemisphere(343) if directions is None else Directions(*read_directions(directions))
    spectrum = wavelengths_of(wavelengths)
    irradiance = "astm_g173" if analytic is None else "unit"
    # An analytic sky's coefficients include the solar irradiance
    day = None if time is None or analytic is not None else day_of_year(about["time"][0])
    scene = Scene.from_degrees(zenith, view, spectrum, azimuth, day, fwhm_nm=fwhm, irradiance=irradiance)
    choice = None if allowed is None else choose(air, scene, allowed)
    if choice is not None:
        chosen, air = choice.solver, choice.atmosphere
    kind = "" if analytic is not None else f"simulate, {settings_of(chosen)}"
    with progress("simulating", kind, sizes((), scene, air)):
        if analytic is None:
            keep_in(jax.config.jax_compilation_cache_dir)  # pyright: ignore[reportAttributeAccessIssue]
            # The command prints its own warnings below
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LowSunWarning)
                chosen = chosen.suited(air, scene.wavelength_nm)
                # Checked here with concrete values, because traced ones are not checked
                check_scene(chosen, air, scene)
                # Traced, droplets may be fog; the solver is suited to what they are
                warnings.simplefilter("ignore", ThickAirWarning)
                found = kept_radiance(chosen, air, scene)
            for said in (low_sun(chosen, scene.sun_zenith), chosen.doubt(air)):
                if said is not None:
                    warn(said)
            radiance, model = np.asarray(found, float), in_words(chosen)
            made_by = {"solver": settings_of(chosen), "atmosphere": describe(air)}
        else:
            radiance, model = np.asarray(analytic.radiance(haze, scene), float), type(analytic).__name__
            made_by = {"coefficients": coefficients, "turbidity": haze}
            if not analytic.valid(haze, scene.sun_zenith):
                warn("these coefficients extrapolate here")
    if choice is not None:
        made_by["choice"] = record_of(choice)
    about |= {"made_by": {"skyfit_version": skyfit_version(), "model": model, "precision": precision()} | made_by}
    low, high, _ = STATION_RANGES["pressure_pa"]
    if analytic is None and given is None:
        # A pressure outside the range of stations is recorded in `made_by` only
        about |= {"ozone_du": ozone, "pressure_pa": pressure if low <= pressure <= high else np.nan}
    sky = Sky(
        radiance=radiance[None], sigma=None, usable=np.isfinite(radiance[None]),
        view_zenith=np.asarray(view.zenith), view_azimuth=np.asarray(view.azimuth), wavelength_nm=spectrum,
        sun_zenith=np.radians([zenith]), sun_azimuth=np.radians([azimuth]), fwhm_nm=np.nan if fwhm is None else fwhm,
        sun_distance_au=1.0 if day is None else np.nan, source=out.name, **about,
    )  # fmt: skip
    write_sky(sky, out)
    say(f"{out}: {radiance.shape[0]} directions, {radiance.shape[1]} wavelengths")
    say(f"model: {model}, {precision()}")
    if choice is not None:
        print_choice(choice)
    give({
        "file": str(out), "directions": radiance.shape[0], "wavelength_nm": spectrum.tolist(),
        "sun_zenith_deg": zenith, "sun_azimuth_deg": azimuth, "made_by": about["made_by"],
    })  # fmt: skip


def _given_atmosphere(context: Context, path: Path):
    """The atmosphere of a file; raises if options are given that it replaces."""
    from .models import atmosphere_of

    refuse(
        context,
        ("turbidity", "aerosol_optical_depth", "meteorological_range", *OF_ATMOSPHERES),
        "`--atmosphere`, whose file holds it",
    )
    return atmosphere_of(path)


def _analytic_sky(context: Context, name: str):
    """The analytic sky of a name or file and its largest sun zenith angle, degrees; raises for options it replaces."""
    from .models import analytic_of

    refuse(context, _OF_SIMULATIONS, "`--coefficients`, whose atmosphere is that of their fit")
    sky = analytic_of(name, "`--coefficients` must be one of")
    return sky, math.degrees(sky.fitted_sun[1])
