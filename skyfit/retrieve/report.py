"""Join the estimates of all times to a `Fit`: values in the user's order, the fitted sky, sentences."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np

from ..measured import Sky
from ..measured.quality.plausibility import at_time, doubts, poor_fit
from ..numerics import as_float
from ..numerics.least_squares import result_name
from .parameters import PARAMETERS, with_values
from .prepared import Prepared
from .result import Fit, in_words, is_determined, LOBES, outliers
from .sampling import scale_at
from .uncertainty import Estimate


# number of its sigmas beyond which a direct beam contradicts the sky
_FAR_BEAM = 3.0
# least number of wavelengths that distinguish a power law of the wavelength from other laws
_TELLING = 4
_WORDS = ("result", "undetermined", "doubt")


def fit_of(
    asked: Prepared, groups: Sequence[np.ndarray], parts: Sequence[Estimate], spreads: Sequence[np.ndarray] = ()
) -> Fit:
    """Join the estimates of all groups of times to one `Fit`; `spreads`: jackknife sigma of each group, or none."""
    sky = asked.sky
    rows: list[dict] = [{} for _ in sky.time]
    for number, (group, part) in enumerate(zip(groups, jax.device_get(list(parts)), strict=True)):
        for index, t in enumerate(group):
            rows[t] = _row(asked, int(t), index, part, spreads[number] if spreads else None)
    stack: dict[str, Any] = {key: np.stack([row[key] for row in rows]) for key in rows[0] if key not in _WORDS}
    words: dict[str, Any] = {key: tuple(row[key] for row in rows) for key in _WORDS}
    # a lamp in the view does not make the rest of the fit poor
    out = outliers(stack["weight"])
    judged = sky, stack["model"], asked.sampling.used & ~out[..., None]
    beyond = [f"{at_time(sky, t)}{said}" for t, said in enumerate(words.pop("doubt")) if said]
    notes = (
        *asked.sampling.notes, *_days_together(asked), *_left_out(sky, out),
        *_of_the_beam(asked, stack["beam_residual"]), *_of_the_degree(asked, stack.pop("degree_rms")),
        *doubts(*judged, stack.pop("kept_chi_square")), *beyond,
    )  # fmt: skip
    pairs = zip(words["result"], poor_fit(*judged), strict=True)
    words["result"] = tuple("poor_fit" if poor and name == "successful" else name for name, poor in pairs)
    return Fit(
        sky=sky, solver=asked.solver, free=asked.free, shared=asked.shared, used=asked.sampling.used,
        start=asked.start, fwhm_nm=asked.sampling.fwhm_nm, measurement=asked.measurement, priors=asked.priors,
        smooth=asked.smooth, response=asked.sampling.response, fitted_nm=sky.wavelength_nm[asked.chosen],
        notes=notes, **stack, **words,
    )  # fmt: skip


def _left_out(sky: Sky, out: np.ndarray) -> Iterator[str]:
    """Yield notes on how many directions of each time the loss rejects and the verdict leaves out."""
    for t, count in enumerate(out.sum(axis=1).tolist()):
        if count:
            known = int(np.isfinite(sky.view_zenith[t]).sum())
            yield f"{at_time(sky, t)}{count} of {known} directions rejected, the verdict is of the others"


def _days_together(asked: Prepared) -> Iterator[str]:
    """Yield a note if several days share parameters."""
    days = np.unique(asked.sky.time[~np.isnat(asked.sky.time)].astype("datetime64[D]"))
    if days.size > 1 and asked.shared:
        yield f"{days.size} days share one {', '.join(asked.shared)}"


def _of_the_beam(asked: Prepared, residual: np.ndarray) -> Iterator[str]:
    """Yield notes where the direct beam contradicts the sky."""
    beam = asked.problem.beside
    for t, row in enumerate(residual):
        if beam is None or not (np.abs(row) > _FAR_BEAM).any():
            continue
        worst = int(np.nanargmax(np.abs(row)))
        name = f"{asked.sky.wavelength_nm[asked.chosen[worst]]:g} nm"
        depth = asked.problem.direct_is_depth
        what = "optical depth" if depth else "direct beam"
        yield (
            f"{at_time(asked.sky, t)}the {what} measured at {name} is {abs(row[worst]):.2g} of its sigmas from that of "
            f"the fit: sky and beam contradict each other"
        )
        held = np.isfinite(row)
        if depth and _as_of_air(asked, held, np.asarray(beam[t, : row.size], float)[held]):
            name = at_time(asked.sky, t)
            yield f"{name}without what air has it goes with the wavelength as a haze's: is it the total one?"


def _of_the_degree(asked: Prepared, rms: np.ndarray) -> Iterator[str]:
    """Yield notes on how far the measured polarisation is from that of the fit."""
    for t in np.flatnonzero(np.isfinite(rms)):
        name = at_time(asked.sky, int(t))
        yield f"{name}degree of polarisation: model minus measurement {rms[t]:.2g} of its sigmas (rms)"


def _as_of_air(asked: Prepared, held: np.ndarray, depth: np.ndarray) -> bool:
    """Whether optical depth at `held` wavelengths is nearer a power law once that of the air is subtracted."""
    wavelength = asked.sky.wavelength_nm[asked.chosen[held]]
    air = np.asarray(asked.start.atmosphere.rayleigh.optical_depth_at(as_float(wavelength)), float)
    if held.sum() < _TELLING or np.any(depth <= air):
        return False
    line = np.stack([np.ones_like(wavelength), np.log(wavelength)], axis=1)
    total, haze = (np.sum((v - line @ np.linalg.lstsq(line, v)[0]) ** 2) for v in (np.log(depth), np.log(depth - air)))
    return bool(haze < 0.5 * total)


def _kept_share(residual: np.ndarray, inverse_sigma: np.ndarray, weight: np.ndarray) -> float:
    """Chi-square per sample without outliers over that of all samples; arguments are `[direction, wavelength]`."""
    used = inverse_sigma > 0.0
    kept = used & ~outliers(weight)[:, None]
    square = (np.where(used, residual, 0.0) * inverse_sigma) ** 2
    whole = square.sum() / max(used.sum(), 1)
    return float(square[kept].sum() / max(kept.sum(), 1) / whole) if whole > 0.0 else 1.0


def _row(asked: Prepared, t: int, index: int, part: Estimate, spread: np.ndarray | None) -> dict:
    free, order = asked.free, asked.order
    found, change = described_time(free, asked.shared, order, part.values[index], part.noise[index], part.model[index])
    result = result_name(part.result) if bool(part.finite) else "failed"
    calibration = np.asarray(part.calibration, float)
    fitted = with_values(asked.start, free, as_float(found["values"]))
    reading = asked.sampling.readings(asked.solver, fitted, t)
    wavelength = asked.sky.wavelength_nm
    reading = reading * scale_at(wavelength, wavelength[asked.chosen], calibration)[None]
    used = asked.sampling.used[t]
    error = (reading - asked.sky.radiance[t])[used]
    weight = np.ones((used.shape[0], asked.chosen.size))
    held = np.asarray(asked.problem.weight[t]).any(axis=1)
    place = asked.places[t][held]
    weight[place] = np.asarray(part.weight[index], float)[held]
    inverse_sigma = np.zeros_like(weight)
    inverse_sigma[place] = np.asarray(asked.problem.weight[t], float)[held]
    weight = np.where(used[:, asked.chosen], weight, np.nan)
    kept_share = _kept_share((reading - asked.sky.radiance[t])[:, asked.chosen], inverse_sigma, weight)
    gain = np.zeros((len(order), *weight.shape))
    gain[:, place] = np.einsum("pq,qdw->pdw", change, np.asarray(part.gain[index], float)[order][:, held])
    triangle = np.asarray(part.triangle[index], float)[:, order] @ np.abs(change).T
    return found | {
        "jackknife_sigma": np.full(len(free), np.nan) if spread is None else np.abs(change) @ spread[index][order],
        "model": reading,
        "rmse": float(np.sqrt(np.mean(error**2))),
        "reduced_chi_square": float(part.chi_square[index]),
        "scale": float(part.scale[index]),
        "common": np.asarray(part.common[index], float),
        "error_share": np.asarray(part.error_share[index], float),
        "widening": float(part.widening[index]),
        "residual_correlation": np.asarray(part.residual_correlation[index], float),
        "beam_residual": _beam_residual(asked, t, index, part),
        "degree_rms": _degree_rms(asked, t, index, part),
        "degrees_of_freedom": float(part.freedom[index]),
        "kept_chi_square": kept_share * float(part.chi_square[index]),
        "weight": weight,
        "gain": gain,
        "calibration": calibration,
        "calibration_sigma": np.asarray(part.calibration_sigma, float),
        "steps": int(part.steps),
        "cost": float(part.cost),
        "result": result,
        "undetermined": in_words(free, found, triangle, asked.priors),
        "doubt": asked.solver.doubt(fitted.atmosphere),
    }


def _beam_residual(asked: Prepared, t: int, index: int, part: Estimate) -> np.ndarray:
    """Model minus measured direct beam over its sigma, `[fitted wavelength]`, NaN where none was measured."""
    if not asked.problem.has_beam:
        return np.full(asked.chosen.size, np.nan)
    return _beside_residual(asked, t, index, part)[: asked.chosen.size]


def _degree_rms(asked: Prepared, t: int, index: int, part: Estimate) -> float:
    """The root mean square residual of the degree of polarisation over its sigma, NaN where none is measured."""
    first = asked.chosen.size if asked.problem.has_beam else 0
    residual = _beside_residual(asked, t, index, part)[first:] if asked.problem.has_degree else np.empty(0)
    known = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _beside_residual(asked: Prepared, t: int, index: int, part: Estimate) -> np.ndarray:
    """Residuals over their sigma of the measurements besides the radiance, NaN where nothing was measured."""
    values, weight = (np.asarray(v, float) for v in (asked.problem.beside, asked.problem.beside_weight))
    off = np.asarray(part.beside, float)[index] - values[t]
    return np.where(weight[t] > 0.0, off * weight[t], np.nan)


def described_time(
    free: tuple[str, ...], shared: tuple[str, ...], order: np.ndarray, values, noise, model
) -> tuple[dict, np.ndarray]:
    """Describe the parameters of one time from an estimate, in the order in which the user named them.

    **Arguments:** `order`, the index of each free name in the arrays; `values`, covariances `noise` and `model`.
    **Returns:** values, sigma, covariance, model_sigma, at_bound, determined; the change that orders the lobes.
    """
    values, change = _ordered_lobes(free, shared, np.asarray(values, float)[order])
    noise, model = (_turned(change, np.asarray(v, float)[np.ix_(order, order)]) for v in (noise, model))
    covariance = noise + np.where(np.isfinite(noise), model, 0.0)
    sigma = np.sqrt(np.diag(covariance))
    found = {
        "values": values,
        "sigma": sigma,
        "covariance": covariance,
        "model_sigma": np.sqrt(np.diag(model)),
        "at_bound": np.array([PARAMETERS[n].at_bound(v) for n, v in zip(free, values, strict=True)]),
        "determined": is_determined(free, values, sigma),
    }
    return found, change


def _ordered_lobes(free: tuple[str, ...], shared: tuple[str, ...], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The values with the narrower lobe first, which keeps the phase function, and the matrix of that change."""
    change = np.eye(len(free))
    phase = set(free) & {*LOBES, "forward_fraction_slope"}
    # if only some parameters of the lobes are shared, the lobes cannot change places at single times
    if not set(LOBES) <= phase or phase & set(shared) not in (set(), phase):
        return values, change
    first, second, share = (free.index(name) for name in LOBES)
    if not values[first] < values[second]:
        return values, change
    change[[first, second]] = change[[second, first]]
    change[share] *= -1.0
    if "forward_fraction_slope" in free:
        change[free.index("forward_fraction_slope")] *= -1.0
    ordered = change @ values
    ordered[share] += 1.0
    return ordered, change


def _turned(change: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The covariance after a signed permutation; infinite variances stay infinite, and NaN stays NaN."""
    known = ~np.isinf(covariance)
    turned = change @ np.where(known, covariance, 0.0) @ change.T
    return np.where(np.abs(change) @ (~known).astype(float) @ np.abs(change).T > 0.0, np.inf, turned)
