"""The printed report of `skyfit invert`, 80 columns wide."""

from collections.abc import Iterable

import numpy as np

from ..atmosphere import BinnedAerosol, TwoModeAerosol
from ..measured import time_names
from ..retrieve import aerosol_optics, Fit, PARAMETERS
from ..retrieve.components import KINDS
from .models import in_words
from .printing import console, note, say, show, table
from .sky_report import short_times


# Characters between two columns of a table
_GAP = 2
# Largest number of rejected directions listed for one time
_MOST_NAMED = 6
# Deviation of the calibration, in sigma of its prior, beyond which the report expresses doubt
_FAR = 3.0
_UNIT = "mW m-2 sr-1 nm-1"


def print_fit(fit: Fit) -> None:
    """Print tables of the skies and their parameters, then further information, one sentence per line."""
    places = list(range(len(fit.free)))
    common = [p for p in places if fit.free[p] in fit.shared]
    own = [p for p in places if p not in common]
    _print_skies(fit)
    if common:
        _print_parameters(fit, 0, common, "all times")
    if own and not (len(fit.sky.time) > 1 and _print_compact(fit, own)):
        for t, name in enumerate(time_names(fit.sky)):
            _print_parameters(fit, t, own, name)
    for sentence in [*_open_ends(fit), *_about(fit)]:
        say(sentence)
    for sentence in [*_doubts(fit), *fit.notes]:
        note(sentence)
    for reason, count in fit.sky.masked.items():
        say(f"masked: {count} samples {reason}")


def _print_skies(fit: Fit) -> None:
    day, names = short_times(fit.sky)
    skies = table(f"{fit.sky.source}: {len(names)} {'sky' if len(names) == 1 else 'skies'}{day and f', {day}'}")
    factor, unit = (1e3, _UNIT) if fit.response is None else (1.0, "in the unit of the channels")
    error = "RMSE mW" if fit.response is None else "RMSE"
    for heading in ("time (UTC)", "zenith", "azimuth", error, "chi2", "dof", "steps"):
        skies.add_column(heading, justify="right", no_wrap=True)
    skies.add_column("result")
    for t, name in enumerate(names):
        angles = (f"{np.degrees(angle):.2f}" for angle in fit.sky.sun_at(t))
        chi_square, freedom = f"{fit.reduced_chi_square[t]:.2f}", f"{fit.degrees_of_freedom[t]:.1f}"
        skies.add_row(
            name, *angles, f"{factor * fit.rmse[t]:.2f}", chi_square, freedom, f"{fit.steps[t]}",
            fit.result[t],
        )  # fmt: skip
    show(skies)
    say(f"RMSE over all: {factor * fit.total_rmse:.2f} {unit} ({int(fit.used.sum())} samples)")


def _print_parameters(fit: Fit, t: int, places: list[int], title: str) -> None:
    values = table(title)
    told = np.isfinite(fit.jackknife_sigma[t, places]).any()
    numbers = ("value", "sigma", "by model", *(("jackknife",) if told else ()))
    for heading in ("parameter", *numbers, "unit"):
        values.add_column(heading, justify="right" if heading in numbers else "left")
    lobes = fit.effective_asymmetry(t)
    together = () if lobes is None else lobes.names
    if lobes is not None and any(fit.free[p] in together for p in places):
        shown = (f"{lobes.value:.5g}", f"{lobes.sigma:.2g}", "", "")[: len(numbers)]
        values.add_row("effective_asymmetry", *shown, "1")
    for p in places:
        if fit.free[p] in together:
            continue
        sigmas = (fit.sigma[t, p], fit.model_sigma[t, p], fit.jackknife_sigma[t, p])[: len(numbers) - 1]
        shown = (f"{fit.values[t, p]:.5g}{_marks(fit, t, p)}", *(f"{sigma:.2g}" for sigma in sigmas))
        values.add_row(fit.free[p], *shown, PARAMETERS[fit.free[p]].unit)
    show(values)
    if together:
        say("effective_asymmetry: of both lobes together")
    _explain(_marks(fit, t, p) for p in places if fit.free[p] not in together)


def _print_compact(fit: Fit, places: list[int]) -> bool:
    """Print one row per time; if that is too wide, print nothing and return False."""
    _, names = short_times(fit.sky)
    headings = [_heading(fit.free[p]) for p in places]
    rows = [[_cell(fit, t, p) for p in places] for t in range(len(names))]
    widths = [max(map(len, ("time", *names)))]
    for column, heading in enumerate(headings):
        widths.append(max(map(len, (*heading.split(), *(row[column] for row in rows)))))
    if sum(widths) + _GAP * len(widths) > console.width:
        return False
    values = table("each time")
    for heading in ("time", *headings):
        values.add_column(heading, justify="right")
    for name, row in zip(names, rows, strict=True):
        values.add_row(name, *row)
    show(values)
    _explain(_marks(fit, t, p) for t in range(len(names)) for p in places)
    return True


def _marks(fit: Fit, t: int, p: int) -> str:
    return "!" * bool(fit.at_bound[t, p]) + "?" * (not fit.determined[t, p])


def _explain(marks: Iterable[str]) -> None:
    """Print a line that explains the marks used in a table."""
    used, meaning = "".join(marks), {"!": "at its bound", "?": "not determined"}
    if used:
        say(", ".join(f"{mark} {text}" for mark, text in meaning.items() if mark in used))


def _heading(name: str) -> str:
    unit = PARAMETERS[name].unit
    return name.replace("_", " ") + ("" if unit == "1" else f", {unit}")


def _cell(fit: Fit, t: int, p: int) -> str:
    value, sigma = fit.values[t, p], fit.sigma[t, p]
    marks = _marks(fit, t, p)
    if not np.isfinite(sigma) or not 1e-6 < sigma < 1e3:
        return f"{value:.3g}\N{PLUS-MINUS SIGN}{sigma:.1g}{marks}"
    decimals = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 4))
    return f"{value:.{decimals}f}\N{PLUS-MINUS SIGN}{sigma:.{decimals}f}{marks}"


def _open_ends(fit: Fit):
    """Sentences on what the data do not determine, each once with the times it applies to."""
    (_, names), times = short_times(fit.sky), {}
    for t, sentences in enumerate(fit.undetermined):
        for sentence in sentences:
            times.setdefault(sentence, []).append(t)
    for sentence, where in times.items():
        which = "" if len(where) == len(names) else ", ".join(names[t] for t in where) + ": "
        yield f"  {which}{sentence}"
    if not times:
        yield "  all of these are determined by the data"


def _about(fit: Fit):
    known = "stated" if fit.measurement.stated(fit.sky) else "assumed"
    error = 100.0 * fit.model_error
    noise = f"noise, each sample's own {_span(fit.scale, '.2g')} times the {known} one"
    yield f"model: {in_words(fit.solver)}"
    yield f"sigma: {noise}, and a model error of {error:.2g} % (by model)"
    level, colour, pointing, *broad = fit.common.T
    yield (
        f"a direction's own errors: level {_span(100.0 * level, '.2g')} %, colour {_span(100.0 * colour, '.2g')} %, "
        f"pointing {_span(np.degrees(pointing), '.2g')} deg; a broad part of the sky's: "
        f"level {_span(100.0 * broad[0], '.2g')} %, colour {_span(100.0 * broad[1], '.2g')} %"
    )
    share = fit.error_share.mean(axis=0)
    most = ("each sample's own", *KINDS)[int(np.argmax(share))].replace("_", " ")
    spectral, angular = fit.residual_correlation.T
    yield (
        f"most of the noise: {most}, {100.0 * share.max():.0f} %; the rest correlates {_span(spectral, '.2f')} with "
        f"the next wavelength, {_span(angular, '.2f')} with the nearest direction"
    )
    yield from _haze(fit)
    yield from _calibration(fit)
    yield from _rejected(fit)
    for name, (value, sigma) in fit.priors.items():
        yield f"prior: {name} {value:.5g} +- {sigma:.2g} {PARAMETERS[name].unit}".removesuffix(" 1")
    for name, sigma in fit.smooth.items():
        logarithm = "of its logarithm " if PARAMETERS[name].log else ""
        yield f"smooth: {name}, change {logarithm}within an hour +- {sigma:.2g}"
    held = (f"{name} {value:.5g} {PARAMETERS[name].unit}".removesuffix(" 1") for name, value in fit.fixed.items())
    yield f"held fixed: {', '.join(held)}"


def _haze(fit: Fit):
    """Lines on derived optical properties of an aerosol of spheres."""
    atmosphere = fit.start.atmosphere
    if not ("aerosol" in atmosphere and isinstance(atmosphere.aerosol, TwoModeAerosol | BinnedAerosol)):
        return
    optics = aerosol_optics(fit)

    def told(name):
        value, sigma, unit = optics[name]
        return f"{_span(value, '.3f')} +- {_span(sigma, '.2g')}{'' if unit == '1' else ' ' + unit}"

    yield f"haze: Angstrom exponent 440-870 nm {told('angstrom_exponent_440_870')}"
    yield f"haze: single-scattering albedo {told('single_scattering_albedo_440')} (440 nm)"
    yield f"haze: single-scattering albedo {told('single_scattering_albedo_870')} (870 nm)"
    for mode in ("fine_", "coarse_", ""):
        yield f"haze: effective radius{mode and ', '}{mode.strip('_')} {told(f'{mode}effective_radius')}"


def _span(values: np.ndarray, form: str) -> str:
    low, high = f"{np.min(values):{form}}", f"{np.max(values):{form}}"
    return low if low == high else f"{low} to {high}"


def _calibration(fit: Fit):
    prior = fit.measurement.calibration_prior(fit.sky)
    if not prior > 0.0:
        return
    yield f"calibration: scale {_span(fit.calibration, '.3f')}, prior {prior:.2g}"


def _doubts(fit: Fit):
    prior = fit.measurement.calibration_prior(fit.sky)
    far = (np.abs(fit.calibration - 1.0) > _FAR * prior).any(axis=0)
    if prior > 0.0 and far.any():
        yield (
            f"the scale is beyond {_FAR:g} times its prior at {int(far.sum())} of {far.size} wavelengths: is the "
            "prior too narrow, or the model wrong?"
        )


def _rejected(fit: Fit):
    sky = fit.sky
    for t, name in enumerate(short_times(fit.sky)[1]):
        where = np.flatnonzero(fit.rejected[t])
        if not where.size:
            continue
        zenith, azimuth = np.degrees(sky.view_zenith[t, where]), np.degrees(sky.view_azimuth[t, where])
        shown = [f"{z:.0f} {a:.0f}" for z, a in zip(zenith[:_MOST_NAMED], azimuth[:_MOST_NAMED], strict=True)]
        more = "" if where.size <= _MOST_NAMED else f" and {where.size - _MOST_NAMED} more"
        count = "1 direction" if where.size == 1 else f"{where.size} directions"
        yield f"rejected, {name}: {count}, zenith azimuth {', '.join(shown)}{more}"
