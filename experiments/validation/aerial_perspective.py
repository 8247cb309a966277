"""Aerial perspective against adaptive quadrature of Preetham's eq. 9, beside the paper's own closed form.

    python -m experiments.validation.aerial_perspective [--rays 2000]

The paper's form is eq. 10 where |alpha s cos(theta)| is small and the cubic of A.4 elsewhere, with the signs, H_1 and
derivatives in v that it must have (as printed it gives transmittances above 1). Errors are those of each
constituent's integral alone, in per cent.
"""

import argparse
import json
import platform
import statistics
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import scipy
from scipy.integrate import quad

import skyfit
from skyfit.atmosphere import bodhaine_optical_depth, Exponential, HenyeyGreenstein, Prescribed


matplotlib.use("Agg")
import matplotlib.pyplot as plt


RESULTS = Path(__file__).resolve().parents[1] / "results"
# m, of air and haze: A.4 of the paper for haze
SCALE = np.array([8000.0, 1200.0])
BANDS = np.array([400.0, 550.0, 700.0])
# where the paper's |alpha s cos(theta)| << 1 begins
SWITCH = 0.01
SOLVERS = {name: getattr(skyfit.AerialPerspective, name)() for name in ("draft", "normal", "fine")}


def coefficients(turbidity):
    """Of air and haze at the ground, m^-1, `[ray, constituent, wavelength]`."""
    air = bodhaine_optical_depth(BANDS)
    haze = bodhaine_optical_depth(550.0) * (BANDS / 550.0) ** -1.3
    return np.stack([air + 0.0 * turbidity[:, None], (turbidity[:, None] - 1.0) * haze], axis=1) / SCALE[None, :, None]


def draw_rays(count, seed=0):
    """Turbidity 1-10, eye 0-8 km, any view, 10 m to 150 km or the ground; a third of each on values of note."""
    random = np.random.default_rng(seed)

    def mixed(notable, anywhere):
        return np.where(random.random(count) < 1 / 3, random.choice(notable, count), anywhere)

    turbidity = mixed([1.0, 1.01, 2.0, 6.0, 10.0], random.uniform(1.0, 10.0, count))
    height = mixed([0.0, 2.0, 100.0, 8000.0], random.uniform(0.0, 8000.0, count))
    grazing = random.choice([-1.0, 1.0], count) * 10.0 ** random.uniform(-5.0, -1.0, count)
    anywhere = np.where(random.random(count) < 0.5, grazing, random.uniform(-1.0, 1.0, count))
    cosine = mixed([0.0, 1e-12, -1e-12, 1e-3, -1e-3, 1.0, -1.0], anywhere)
    distance = mixed([1.5e5], 10.0 ** random.uniform(1.0, np.log10(1.5e5), count))
    down = cosine < -1e-7
    distance = np.where(down, np.minimum(distance, height / np.where(down, -cosine, 1.0)), distance)
    rays = np.stack([turbidity, height, cosine, distance])
    return rays[:, distance > 1.0]


def exact(rays):
    """Eq. 9 by scipy's adaptive rule, `[ray, constituent, wavelength]`."""
    found = np.zeros((rays.shape[1], 2, BANDS.size))
    for ray, beta, out in zip(rays.T, coefficients(rays[0]), found, strict=True):
        _, height, cosine, distance = ray

        def integrand(x, i, w, height=height, cosine=cosine, beta=beta):
            slope = x * cosine / SCALE
            mean = np.where(np.abs(slope) < 1e-9, 1.0, -np.expm1(-slope) / np.where(slope == 0.0, 1.0, slope))
            column = np.exp(-height / SCALE) * x * mean
            return np.exp(-(height + x * cosine) / SCALE[i] - column @ beta[:, w])

        breaks = distance * np.array([0.0, 1e-3, 1e-2, 0.05, 0.2, 0.5, 1.0])
        for i, w in np.ndindex(2, BANDS.size):
            out[i, w] = sum(
                quad(integrand, a, b, (i, w), epsabs=1e-300, epsrel=1e-9, limit=200)[0]
                for a, b in zip(breaks, breaks[1:], strict=False)
            )
    return found


def ours(solver, rays, double):
    """`[ray, constituent, wavelength]` in float64 or float32."""

    def one(beta, height, zenith, distance):
        parts = [Prescribed(b * h, Exponential(h), HenyeyGreenstein(0.0)) for b, h in zip(beta, SCALE, strict=True)]
        scene = skyfit.Scene(1.0, 0.0, skyfit.Directions(zenith[None], jnp.zeros(1)), BANDS, np.ones(3), height)
        atmosphere, rate = skyfit.Atmosphere(*parts, None), jnp.where(beta > 0.0, beta, 1.0)
        sources = [jnp.eye(2)[i][:, None, None] / rate[:, None] for i in range(2)]
        return jnp.stack([solver.path(atmosphere, scene, distance[None], s).inscatter[0] for s in sources])

    with jax.enable_x64(double):
        zenith = np.pi / 2.0 - np.arcsin(rays[2])
        arrays = [jnp.asarray(v, float) for v in (coefficients(rays[0]), rays[1], zenith, rays[3])]
        return np.asarray(jax.jit(jax.vmap(one))(*arrays), float)


def papers(rays, dtype):
    """The paper's closed forms in numpy, every operation in `dtype`; the same layout."""
    _, height, cosine, distance = (v.astype(dtype)[:, None] for v in rays)
    beta, alpha = coefficients(rays[0]).astype(dtype), (1.0 / SCALE).astype(dtype)
    found = np.zeros(beta.shape, dtype)
    for i, j in ((0, 1), (1, 0)):
        first, second = beta[:, i], beta[:, j]
        start, other = np.exp(-alpha[i] * height), np.exp(-alpha[j] * height)
        end = np.exp(-alpha[i] * (height + distance * cosine))
        other_end = np.exp(-alpha[j] * (height + distance * cosine))
        with np.errstate(all="ignore"):
            # eq. 10
            rate = alpha[i] * cosine + first * start + second * other
            near = start * (1 - np.exp(-rate * distance)) / rate
            # A.4: the cubic through f and df/dv at both ends
            k, k_other = first / (alpha[i] * cosine), second / (alpha[j] * cosine)
            f_end = np.exp(-k_other * (other - other_end))
            slope = second * other / (alpha[i] * cosine * start)
            slope_end = second * other_end * f_end / (alpha[i] * cosine * end)
            span = end - start
            chord = (f_end - 1) / span
            cube = (slope + slope_end - 2 * chord) / span**2
            square = (3 * chord - 2 * slope - slope_end) / span
            g = (1 + 0 * slope, slope, 2 * square, 6 * cube)
            g_end = (f_end, slope_end, 2 * square + 6 * cube * span, 6 * cube)
            inside = [d[0] / k - d[1] / k**2 + d[2] / k**3 - d[3] / k**4 for d in (g, g_end)]
            far = -(np.exp(-k * (start - end)) * inside[1] - inside[0]) / (alpha[i] * cosine)
        small = np.abs(distance * cosine) * np.max(alpha) < SWITCH
        found[:, i] = np.where(small, near, far)
    return found.astype(float)


def summary(found, expected, counted):
    """Errors in per cent; what is no number counts as an error beyond all."""
    error = 100.0 * np.abs(found / np.where(counted, expected, 1.0) - 1.0)
    error = np.where(np.isfinite(error), error, np.inf)[counted]
    rounded = [float(f"{v:.3g}") for v in (np.max(error), np.quantile(error, 0.99), np.median(error))]
    rows = dict(zip(("max_percent", "p99_percent", "median_percent"), rounded, strict=True))
    rows = {key: value if np.isfinite(value) else "not finite" for key, value in rows.items()}
    return rows | {"share_over_half_percent": float(f"{np.mean(error > 0.5):.4g}")}


def microseconds(wavelengths, rays=2000):
    """Per ray, medians of 9 after compilation, float32."""
    random = np.random.default_rng(0)
    nm = np.linspace(400.0, 700.0, wavelengths)
    view = skyfit.Directions(np.arccos(random.uniform(-0.3, 0.5, rays)), random.uniform(0.0, 6.0, rays))
    scene = skyfit.Scene.from_degrees(60.0, view, nm, height=1500.0)
    distance = jnp.asarray(10.0 ** random.uniform(2.0, 5.0, rays), float)
    source, atmosphere = jnp.ones((2, rays, wavelengths)), skyfit.Atmosphere.from_turbidity(3.0)
    rows = {}
    for name, solver in SOLVERS.items():
        times = []
        for _ in range(10):
            begin = time.perf_counter()
            jax.block_until_ready(solver.path(atmosphere, scene, distance, source))
            times.append(time.perf_counter() - begin)
        rows[name] = float(f"{statistics.median(times[1:]) / rays * 1e6:.3g}")
    return rows


def ward_larson():
    """Fig. 8: luminance of the air before black objects, level, T = 6, sun 6 degrees high in the west."""
    nm = np.arange(380.0, 781.0, 20.0)
    atmosphere, sky = skyfit.Atmosphere.from_turbidity(6.0), skyfit.OrdersOfScattering.normal()
    rows = []
    for name, azimuth in (("west, toward the sun", 270.0), ("north", 0.0), ("east", 90.0)):
        view = skyfit.Directions.from_degrees([90.0, 0.0], azimuth)
        scene = skyfit.Scene.from_degrees(84.0, view, nm, sun_azimuth=270.0)
        sun = sky.fluxes(atmosphere, scene).direct / jnp.cos(scene.sun_zenith)
        source = skyfit.scattered_light(atmosphere, scene, lambda s: sky.radiance(atmosphere, s), sun)
        zenith = sky.radiance(atmosphere, scene)[1]
        for kilometres in (5.0, 20.0, 80.0):
            distance = jnp.full(2, 1e3 * kilometres)
            paths = (
                SOLVERS["normal"].path(atmosphere, scene, distance, source),
                skyfit.constant_ambient(atmosphere, scene, distance, zenith),
            )
            x, y, luminance = np.asarray(skyfit.xyY(jnp.stack([p.inscatter[0] for p in paths]), nm)).T
            row = {"view": name, "km": kilometres, "cd_m2": luminance, "x": x, "y": y}
            rows.append(
                {k: v if isinstance(v, (str, float)) else [float(f"{n:.3g}") for n in v] for k, v in row.items()}
            )
    return rows


def picture(path):
    """Error over view and distance, of the haze's integral at 550 nm: T = 2, the eye 1 km high."""
    size, edge = 160, 1e-6
    decades = np.linspace(-1.0, 1.0, 2 * size)
    # cosines from -1 over -1e-6 and 1e-6 to 1
    cosine = np.sign(decades) * edge ** (1.0 - np.abs(decades))
    distance = np.geomspace(10.0, 1.5e5, size)
    c, s = (v.ravel() for v in np.meshgrid(cosine, distance))
    rays = np.stack(
        [np.full_like(c, 2.0), np.full_like(c, 1000.0), c, np.minimum(s, np.where(c < 0.0, -1000.0 / c, s))]
    )
    expected = ours(skyfit.AerialPerspective(64), rays, True)[:, 1, 1]
    panels = {
        "the paper, float32": papers(rays, np.float32),
        "the paper, float64": papers(rays, np.float64),
        "9 pieces, float32": ours(SOLVERS["normal"], rays, False),
        "9 pieces, float64": ours(SOLVERS["normal"], rays, True),
    }
    figure, axes = plt.subplots(1, 4, figsize=(13.0, 3.4), dpi=100, sharey=True, layout="constrained")
    for axis, (title, found) in zip(axes, panels.items(), strict=True):
        error = np.abs(found[:, 1, 1] / expected - 1.0)
        error = np.where(np.isfinite(error), np.clip(error, 1e-7, 10.0), 10.0).reshape(size, -1)
        image = axis.pcolormesh(
            decades, distance / 1e3, np.log10(error), vmin=-7, vmax=1, cmap="magma", rasterized=True
        )
        axis.set(title=title, yscale="log", xlabel="cosine of the view's zenith angle")
        ticks = [-1.0, -1e-2, -1e-4, 1e-4, 1e-2, 1.0]
        places = [np.sign(t) * (1.0 - np.log(abs(t)) / np.log(edge)) for t in ticks]
        axis.set_xticks(places, [f"{t:g}" for t in ticks], fontsize=8)
    axes[0].set_ylabel("distance, km (down: to the ground)")
    figure.colorbar(image, ax=axes, label="log10 of the relative error")
    figure.savefig(path)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=int, default=2000)
    rays = draw_rays(parser.parse_args().rays)
    expected = exact(rays)
    # without haze there is no integral of it to speak of
    counted = np.broadcast_to((rays[0] > 1.0)[:, None, None] | (np.arange(2) == 0)[None, :, None], expected.shape)
    answers = {
        f"{name}, {'float64' if double else 'float32'}": ours(solver, rays, double)
        for name, solver in SOLVERS.items()
        for double in (False, True)
    }
    answers |= {f"the paper, {np.dtype(d).name}": papers(rays, d) for d in (np.float32, np.float64)}
    level = np.abs(rays[2]) < 1e-4
    steep = (np.abs(rays[2]) > 0.1) & (rays[3] > 5e3)
    kinds = {"all": np.ones_like(level), "level, cos < 1e-4": level, "steep, cos > 0.1, over 5 km": steep}
    table = {
        kind: {name: summary(found[rows], expected[rows], counted[rows]) for name, found in answers.items()}
        for kind, rows in kinds.items()
    }
    record = {
        "rays": int(rays.shape[1]),
        "rays_of_kind": {kind: int(np.sum(rows)) for kind, rows in kinds.items()},
        "what": "turbidity 1-10, eye 0-8 km, 10 m to 150 km or the ground, 400, 550, 700 nm; against scipy quad",
        "pieces": {name: solver.pieces for name, solver in SOLVERS.items()},
        "errors": table,
        "microseconds_per_ray_float32": {str(n): microseconds(n) for n in (3, 41)},
        "ward_larson": {"columns": "[ours, Ward-Larson]", "rows": ward_larson()},
        "versions": {m.__name__: m.__version__ for m in (jax, np, scipy)},
        "machine": f"{platform.machine()}, {jax.device_count()} {jax.default_backend()} device, shared with other work",
    }
    (RESULTS / "aerial_perspective.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    for kind, rows in table.items():
        for name, row in rows.items():
            print(kind, "|", name, row)
    print(record["microseconds_per_ray_float32"])
    picture(RESULTS / "aerial_perspective.png")


if __name__ == "__main__":
    main()
