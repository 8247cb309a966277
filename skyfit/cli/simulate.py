"""`skyfit simulate`."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..analytic import AbstractAnalyticSky, ExtendedPreetham, Preetham
from ..analytic.extended import SUN_ZENITH_RANGE_DEG
from ..atmosphere import (
    HenyeyGreenstein,
    meteorological_range as meteorological_range_of,
    optical_depth_to_turbidity,
    SEA_LEVEL_PRESSURE,
    turbidity_from_range,
    turbidity_to_optical_depth,
)
from ..measured import read_directions, Sky, write_sky
from ..records import read_coefficients
from ..scene import Directions, hemisphere, Scene
from .options import (
    AngstromExponent,
    app,
    console,
    GeometryName,
    GeometryOption,
    GroundAlbedo,
    HazeHeight,
    in_range,
    LineShape,
    make_atmosphere,
    make_solver,
    notices,
    OzoneColumn,
    PolarisedOption,
    PresetName,
    PresetOption,
    Pressure,
    progress,
    SingleScatteringAlbedo,
    SolverOption,
)


# what only a simulation heeds
_OF_SIMULATIONS = (
    "angstrom_exponent", "single_scattering_albedo", "asymmetry", "haze_height", "ground_albedo", "ozone", "pressure",
    "fwhm", "solver", "preset", "geometry", "polarised",
)  # fmt: skip


def _wavelengths(text: str) -> np.ndarray:
    """Wavelengths from "first:last:step" or a list with commas, nm."""
    try:
        parts = np.array([float(part) for part in text.split(":" if ":" in text else ",")])
    except ValueError:
        parts = np.array([np.nan])
    if not np.all(np.isfinite(parts)):
        raise ValueError(f"`--wavelengths` must be first:last:step or a list in nm, got {text!r}")
    if ":" not in text:
        if np.any(np.diff(parts) <= 0.0):
            raise ValueError(f"`--wavelengths` must increase, got {text!r}")
        return parts
    if parts.size != 3 or parts[2] <= 0.0 or not 0.0 <= parts[1] - parts[0] <= 1e4 * parts[2]:
        raise ValueError(f"`--wavelengths` must be first:last:step in nm, 10000 steps at most, got {text!r}")
    return np.arange(parts[0], parts[1] + 0.5 * parts[2], parts[2])


def turbidity_of(
    turbidity: float | None, optical_depth: float | None, range_km: float | None, haze_height: float
) -> float:
    """Preetham's turbidity from the one of its measures that was given."""
    if sum(value is not None for value in (turbidity, optical_depth, range_km)) != 1:
        raise ValueError(
            "exactly one of `--turbidity`, `--aerosol-optical-depth` and `--meteorological-range` must be given"
        )
    if turbidity is not None:
        return in_range("--turbidity", turbidity, 1.0, 50.0)
    if optical_depth is not None:
        return float(optical_depth_to_turbidity(in_range("--aerosol-optical-depth", optical_depth, 0.0, 5.0)))
    assert range_km is not None
    clearest = float(meteorological_range_of(1.0)) / 1e3
    metres = 1e3 * in_range("--meteorological-range", range_km, 1.0, clearest)
    return float(turbidity_from_range(metres, haze_height))


def _analytic_sky(name: str) -> AbstractAnalyticSky:
    if name == "published":
        return Preetham.published()
    return ExtendedPreetham.shipped() if name == "extended" else read_coefficients(name)


def _refuse_what_coefficients_hold(context: typer.Context) -> None:
    for name in _OF_SIMULATIONS:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            option = name.replace("_", "-")
            raise ValueError(
                f"`--{option}` must be left out with `--coefficients`, whose atmosphere is that of their fit"
            )


@app.command()
def simulate(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="file to write, .nc or .csv")],
    sun_zenith: Annotated[float, typer.Option(help="degrees")],
    sun_azimuth: Annotated[float, typer.Option(help="degrees clockwise from north")] = 180.0,
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
    fwhm: LineShape = None,
    coefficients: Annotated[
        str | None, typer.Option(help="no solver but an analytic sky: published, extended or a coefficients.json")
    ] = None,
    solver: SolverOption = "orders",
    preset: PresetOption = PresetName.normal,
    geometry: GeometryOption = GeometryName.spherical,
    polarised: PolarisedOption = None,
):
    """Simulate the spectral radiance of a clear sky."""
    haze = turbidity_of(turbidity, aerosol_optical_depth, meteorological_range, haze_height)
    if coefficients is not None:
        _refuse_what_coefficients_hold(context)
    analytic = None if coefficients is None else _analytic_sky(coefficients)
    in_range("--sun-zenith", sun_zenith, 0.0, 90.0 if analytic is None else SUN_ZENITH_RANGE_DEG[1])
    if out.suffix not in (".nc", ".csv") or not out.absolute().parent.is_dir():
        raise ValueError(f"`--out` must be a .nc or .csv file in a folder that is there, got {out}")
    phase = HenyeyGreenstein(in_range("--asymmetry", asymmetry, -0.98, 0.98))
    atmosphere = make_atmosphere(
        phase, angstrom_exponent, single_scattering_albedo, haze_height, ground_albedo, ozone, pressure
    )(turbidity_to_optical_depth(haze))
    view = hemisphere(343) if directions is None else Directions(*read_directions(directions))
    spectrum = _wavelengths(wavelengths)
    irradiance = "astm_g173" if analytic is None else "unit"
    scene = Scene.from_degrees(sun_zenith, view, spectrum, sun_azimuth, fwhm_nm=fwhm, irradiance=irradiance)
    with progress("simulating"):
        if analytic is None:
            vector = solver == "orders" if polarised is None else polarised
            radiance = np.asarray(make_solver(solver, preset, geometry, vector).radiance(atmosphere, scene), float)
        else:
            radiance = np.asarray(analytic.radiance(haze, scene), float)
            if not analytic.valid(haze, scene.sun_zenith):
                notices.print("these coefficients extrapolate here", highlight=False)
    sky = Sky(
        radiance=radiance[None], sigma=None, usable=np.isfinite(radiance[None]),
        view_zenith=np.asarray(view.zenith), view_azimuth=np.asarray(view.azimuth), wavelength_nm=spectrum,
        sun_zenith=np.radians([sun_zenith]), sun_azimuth=np.radians([sun_azimuth]),
        time=np.array(["NaT"], "datetime64[ns]"), fwhm_nm=np.nan if fwhm is None else fwhm, altitude_m=0.0,
        source=out.name,
    )  # fmt: skip
    write_sky(sky, out)
    console.print(f"{out}: {radiance.shape[0]} directions, {radiance.shape[1]} wavelengths", highlight=False)
