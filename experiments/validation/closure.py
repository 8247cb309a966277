"""Network retrievals' own size distributions and indices through `BinnedAerosol`: do their optics come back?

    python -m experiments.validation.closure FILE.json [--out FILE.json]

Each retrieval states dV/dlnr at 22 radii, the index at four wavelengths, and the optical depth, the single scattering
albedo and the asymmetry that the network's kernels make of them. The index of each wavelength is set as it stands, so
that what differs is the kernels, the Gaussians in place of the network's straight lines between radii, the rounding of
printed numbers and, for particles that are no spheres, the shape. FILE is a list of records with `site`, `date`,
`time`, `source`, `wavelength_nm`, `aod`, `ssa`, `asymmetry`, `n`, `k`, `dvdlnr` and, where known,
`sphericity_percent` or `depolarization_ratio` (at the wavelengths): no network's data is kept here. Spheres are what
has a sphericity of 90 % or, where that is not stated, depolarises less than 1 % at the first wavelength. Each row says
too what miepython, where it is installed, makes of straight lines between the radii: what differs from that is the
network's. Writes experiments/results/closure.json.
"""

import argparse
import json
import pathlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.atmosphere import BIN_RADII


RESULT = HERE / "results" / "closure.json"
NEEDED = ("aod", "ssa", "asymmetry", "n", "k", "dvdlnr")
SPHERES_PERCENT, LEAST_DEPOLARISATION = 90.0, 0.01
TARGETS = {"ssa": 0.005, "asymmetry": 0.01}
# radii of miepython's integral, some 25 between two of the network's
FINE = np.geomspace(BIN_RADII[0], BIN_RADII[-1], 21 * 25 + 1)


@eqx.filter_jit
def optics_of(bins, n, k, wavelength_nm):
    """Optical depth, albedo and asymmetry at each wavelength, each with the index that is stated there."""

    def at(n, k, wavelength):
        haze = skyfit.BinnedAerosol(bins, refractive_index=n, absorption_index=k)
        spectrum = wavelength[None]
        moments = haze.phase.moments(2, spectrum)
        return haze.optical_depth_at(spectrum)[0], haze.single_scattering_albedo_at(spectrum)[0], moments[1].reshape(())

    return jax.vmap(at)(n, k, wavelength_nm)


def by_miepython(bins, n, k, wavelength_nm):
    """As `optics_of`, of straight lines between the radii."""
    import miepython

    volume = np.interp(np.log(FINE), np.log(BIN_RADII), bins)
    found = []
    for index, absorption, wavelength in zip(n, k, wavelength_nm, strict=True):
        size = 2.0 * np.pi * FINE / (1e-3 * wavelength)
        out, scattered, _, asymmetry = miepython.efficiencies_mx(index - 1j * absorption, size)
        # cross section of a volume of spheres, per radius
        per_volume = 0.75 * volume / FINE
        step = np.log(FINE[1] / FINE[0])
        sums = [np.trapezoid(part * per_volume, dx=step) for part in (out, scattered, scattered * asymmetry)]
        found.append((sums[0], sums[1] / sums[0], sums[2] / sums[1]))
    return np.array(found).T


def row_of(one: dict) -> dict:
    wavelength, bins, n, k = (np.asarray(one[name], float) for name in ("wavelength_nm", "dvdlnr", "n", "k"))
    haze = skyfit.BinnedAerosol.from_size_distribution(one["radius_um"], bins)
    found = np.asarray(optics_of(haze.bins, *(jnp.asarray(v) for v in (n, k, wavelength))))
    stated = np.array([one["aod"], one["ssa"], one["asymmetry"]], float)
    try:
        lines = by_miepython(bins, n, k, wavelength)
    except ImportError:
        lines = np.full_like(found, np.nan)
    sphericity = one.get("sphericity_percent")
    depolarised = one.get("depolarization_ratio")
    spheres = sphericity >= SPHERES_PERCENT if sphericity is not None and sphericity >= 0.0 else (
        depolarised is not None and 0.0 <= depolarised[0] < LEAST_DEPOLARISATION
    )  # fmt: skip

    def off(values, against):
        relative = values[0] / against[0] - 1.0
        return {
            "aod_relative": [round(float(v), 5) for v in relative],
            "ssa": [round(float(v), 5) for v in values[1] - against[1]],
            "asymmetry": [round(float(v), 5) for v in values[2] - against[2]],
        }

    known = bool(np.all((n >= 1.33) & (n <= 1.6) & (k <= 0.1)))
    return {
        "site": one["site"], "date": one["date"], "time": one["time"], "source": one["source"],
        "wavelength_nm": wavelength.tolist(), "aod_first": float(stated[0, 0]), "spheres": bool(spheres),
        "index_known": known, "off": off(found, stated), "miepython_off": off(lines, stated),
        "from_miepython": off(found, lines),
    }  # fmt: skip


def summary(rows: list[dict], which: str) -> dict:
    """Medians and largest sizes of the differences, and the share of retrievals within the targets."""
    told = {"retrievals": len(rows)}
    for name in ("aod_relative", "ssa", "asymmetry"):
        size = np.abs([row[which][name] for row in rows])
        told[name] = {"median": float(np.median(size)), "largest": float(size.max())}
        if name in TARGETS:
            told[name]["share_within"] = float(np.mean(size.max(axis=1) <= TARGETS[name]))
            told[name]["target"] = TARGETS[name]
    return told


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, default=RESULT)
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    records = [one for one in json.loads(given.file.read_text()) if all(name in one for name in NEEDED)]
    rows = [row_of(one) for one in records]
    parts = {
        "spheres": [row for row in rows if row["spheres"] and row["index_known"]],
        "others": [row for row in rows if not row["spheres"] and row["index_known"]],
    }
    told = {
        name: {which: summary(part, which) for which in ("off", "miepython_off", "from_miepython")}
        for name, part in parts.items()
        if part
    }
    record = {"summary": told, "rows": rows, **made_with(0)}
    given.out.write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()
