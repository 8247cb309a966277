"""The report of `skyfit sensitivity`: a record for a file, and its printed form, 80 columns wide."""

from collections.abc import Mapping

import numpy as np

from ..measured import Sky, time_names
from ..retrieve import PARAMETERS
from ..retrieve.result import is_determined
from ..scene import Directions
from .printing import say, show, table


def prior_sigmas(names: tuple[str, ...], given: Mapping[str, tuple[float, float] | None]) -> np.ndarray:
    """Prior sigma of each name: as given by the user, else by climatology as in `invert`, else infinite."""
    strange = [name for name in given if name not in names]
    if strange:
        raise ValueError(f"`--prior` must name free parameters ({', '.join(names)}), got {strange[0]!r}")
    known = [given.get(name, PARAMETERS[name].climatology) for name in names]
    return np.array([np.inf if one is None else one[1] for one in known])


def record_of(
    sky: Sky, sun: list[float], spectrum, relative: float, names: tuple[str, ...], values, covariance, prior_sigma,
    after: Directions, sigma_after,
) -> dict:  # fmt: skip
    """All results as names and numbers for JSON; infinite sigmas become null."""
    sigma = np.sqrt(np.diagonal(covariance))
    finite = np.where(np.isfinite(sigma) & (sigma > 0.0), sigma, 1.0)
    correlation = np.where(np.eye(len(names)) > 0.0, 1.0, covariance / finite[:, None] / finite)
    determined = is_determined(names, values, sigma)
    places = np.degrees(after.zenith), np.degrees(after.azimuth)
    return {
        "scan": sky.source, "time": time_names(sky)[0], "sun_zenith": sun[0], "sun_azimuth": sun[1],
        "wavelength_nm": [float(one) for one in spectrum], "relative_noise": relative,
        "directions": int(sky.usable[0].any(axis=1).sum()),
        "parameters": {
            name: {
                "value": float(values[p]), "unit": PARAMETERS[name].unit, "sigma": _number(sigma[p]),
                "prior_sigma": _number(prior_sigma[p]), "determined": bool(determined[p]),
            }
            for p, name in enumerate(names)
        },
        "correlation": correlation.tolist(),
        "next": [
            {
                "view_zenith": float(zenith), "view_azimuth": float(azimuth) % 360.0,
                "sigma": {name: _number(row[p]) for p, name in enumerate(names)},
            }
            for zenith, azimuth, row in zip(*places, sigma_after, strict=True)
        ],
    }  # fmt: skip


def _number(value) -> float | None:
    return float(value) if np.isfinite(value) else None


def print_sensitivity(record: dict) -> None:
    """Print the parameters with their sigma after the scan and after the chosen directions, then these directions."""
    following = record["next"]
    title = f"{record['scan']}, sun zenith {record['sun_zenith']:.1f} degrees, {record['directions']} directions"
    rows = table(f"{title}, {len(record['wavelength_nm'])} wavelengths with {record['relative_noise']:.1%} noise")
    for head in ("parameter", "value", "sigma", f"with {len(following)} more", "unit"):
        rows.add_column(head, justify="right" if head in ("value", "sigma") or head.startswith("with") else "left")
    for name, one in record["parameters"].items():
        later = following[-1]["sigma"][name]
        sigmas = ("open" if sigma is None else f"{sigma:.3g}" for sigma in (one["sigma"], later))
        rows.add_row(name, f"{one['value']:.4g}{'' if one['determined'] else '?'}", *sigmas, one["unit"])
    show(rows)
    if not all(one["determined"] for one in record["parameters"].values()):
        say("? not determined")
    places = ", ".join(f"{one['view_zenith']:.0f}/{one['view_azimuth']:.0f}" for one in following)
    say(f"next, zenith angle/azimuth in degrees: {places}")
