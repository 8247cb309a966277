"""Writes the phase functions and scattering efficiencies of water droplets of data/ by Mie theory."""

from pathlib import Path

import miepython
import numpy as np


DATA = Path(__file__).resolve().parents[2] / "data"
WAVELENGTH = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 700.0])
# Hale & Querry 1973, Appl. Opt. 12, 555, Table I, real part at these wavelengths; k < 4e-8, taken as 0
INDEX = np.array([1.339, 1.337, 1.335, 1.333, 1.332, 1.331])
# median radius in micrometres, geometric standard deviation of the lognormal number distribution
KINDS = {"wet_haze": (0.3, 1.6), "fog": (4.5, 1.4)}
# degrees: dense where the diffraction peak and the glory are
ANGLE = np.unique(
    np.concatenate(
        [
            [0.0],
            np.geomspace(0.1, 10.0, 41),
            np.arange(10.0, 130.0, 2.5),
            np.arange(130.0, 160.0, 1.0),
            np.arange(160.0, 176.0, 0.5),
            np.arange(176.0, 180.01, 0.25),
        ]
    ).round(3)
)


def mixture(kind, wavelength, index, angle=ANGLE, radii=800):
    """Phase function sr^-1 at the angles, efficiency Q and asymmetry of a kind of droplets.

    Means over the distribution of geometric cross sections, midpoints in ln r over 4.5 standard deviations.
    """
    median, spread = KINDS[kind]
    width = np.log(spread)
    # weights r^2 n(r): the centre moves by 2 sigma^2
    offset = (np.arange(radii) + 0.5) / radii * 9.0 - 4.5
    radius = median * np.exp(2.0 * width**2 + width * offset)
    weight = np.exp(-0.5 * offset**2)
    weight /= weight.sum()
    size = 2.0 * np.pi * radius / (wavelength * 1e-3)
    cosine, phase = np.cos(np.radians(angle)), np.zeros(len(angle))
    _, efficiency, _, asymmetry = miepython.efficiencies_mx(np.full(radii, complex(index)), size)
    for x, q, w in zip(size, efficiency, weight, strict=True):
        phase += w * q * miepython.i_unpolarized(complex(index), x, cosine, norm="one")
    total = weight @ efficiency
    return phase / total, total, weight @ (efficiency * asymmetry) / total


def write(name, header, columns):
    common = (
        "# source: Mie theory for spheres of water, miepython " + miepython.__version__ + " (MIT licence)",
        "# refractive index: Hale & Querry 1973, Appl. Opt. 12, 555, Table I; absorption (k < 4e-8) left out",
        "# lognormal number distributions, median radius and geometric standard deviation:",
        *(f"#   {kind}: {median} micrometres, {spread}" for kind, (median, spread) in KINDS.items()),
        "# made by experiments/tables/make_droplet_table.py; licence: that of this project",
    )
    rows = zip(*columns.values(), strict=True)
    lines = [*common, *header, ",".join(columns), *(",".join(f"{v:.6g}" for v in row) for row in rows)]
    (DATA / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def main():
    phases = {"angle_deg": ANGLE}
    means = {"wavelength_nm": WAVELENGTH, "refractive_index": INDEX}
    for kind in KINDS:
        results = [mixture(kind, *pair) for pair in zip(WAVELENGTH, INDEX, strict=True)]
        for wavelength, (phase, _, _) in zip(WAVELENGTH, results, strict=True):
            phases[f"{kind}_{wavelength:g}nm"] = np.log(phase)
        means[f"{kind}_efficiency"] = np.array([q for _, q, _ in results])
        means[f"{kind}_asymmetry"] = np.array([g for _, _, g in results])
    write(
        "droplets.csv",
        (
            "# columns: angle_deg, scattering angle; KIND_WAVELENGTH, natural logarithm of the phase function in sr-1,",
            "# whose integral over the sphere is 1",
        ),
        phases,
    )
    write(
        "droplet_efficiencies.csv",
        ("# columns: efficiency, scattering over geometric cross section; asymmetry, mean cosine; dimensionless",),
        means,
    )


if __name__ == "__main__":
    main()
