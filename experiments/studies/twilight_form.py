"""Whether the extended form carries the sky down to a sun at 96 degrees: its error beside that of the best five.

    python -m experiments.studies.twilight_form

Skies of `Spherical` at five turbidities are fitted by `ExtendedPreetham` with its range of suns drawn out to 96
degrees, and each alone by Perez' five parameters; errors are told of suns between those of the fit too. Writes
experiments/results/twilight_form.json, medians and 95th percentiles over directions to 80 degrees by the sun's place.
"""

import dataclasses
import json
import math

import jax


jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import skyfit  # noqa: E402
from experiments.benchmarks.tiers import HERE, made_with  # noqa: E402
from skyfit.analytic import extended, Perez  # noqa: E402
from skyfit.analytic.joint import EXTENDED, fit_joint, UNIT  # noqa: E402
from skyfit.image.render import SPECTRUM, sunlight  # noqa: E402
from skyfit.light import xyY_from_xyz  # noqa: E402
from skyfit.scene import angle_between  # noqa: E402


RESULT = HERE / "results" / "twilight_form.json"
LOWEST = 96.0
TURBIDITIES = (1.5, 2.0, 3.0, 4.5, 7.0)
FITTED = (0.0, 25.0, 45.0, 60.0, 70.0, 77.0, 82.0, 85.0, 87.5, 89.0, 90.5, 91.5, 92.5, 93.5, 94.5, 95.25, 96.0)
BETWEEN = (52.0, 79.0, 86.0, 90.0, 92.0, 93.0, 94.0, 95.0, 95.75)
CLASSES = ((0.0, 85.0), (85.0, 90.0), (90.0, 92.0), (92.0, 94.0), (94.0, 96.0))
START = (-0.3, -0.2, 0.2, -1.1, 0.03)


def skies(view: skyfit.Directions) -> dict[float, np.ndarray]:
    """Luminance, x and y of every turbidity `[sun, direction, 3]`, suns of the fit and then those between."""
    suns, found = np.radians([*FITTED, *BETWEEN]), {}
    for turbidity in TURBIDITIES:
        air = skyfit.Atmosphere.from_turbidity(turbidity)
        field = skyfit.Spherical.normal().prepare(air, SPECTRUM, sun_zenith=suns, height=0.0)
        rows = [field.radiance(skyfit.Scene(sun, 0.0, view, SPECTRUM, sunlight())) for sun in suns]
        x, y, luminance = np.moveaxis(np.asarray(xyY_from_xyz(skyfit.xyz(jnp.stack(rows), SPECTRUM))), -1, 0)
        found[turbidity] = np.stack([luminance, x, y], axis=-1)
        print("turbidity", turbidity, flush=True)
    return found


def main() -> None:
    # the study's own range: that of the form as it is shipped ends at 92 degrees
    extended.SUN_ZENITH_RANGE_DEG = (0.0, LOWEST)
    dome = skyfit.hemisphere(200)
    view = skyfit.Directions(jnp.append(dome.zenith, 0.0), jnp.append(dome.azimuth, 0.0))
    every = skies(view)
    names = [(sun, haze) for haze in TURBIDITIES for sun in (*FITTED, *BETWEEN)]
    light = np.concatenate([every[haze] for haze in TURBIDITIES])
    sun, haze = np.radians([s for s, _ in names]), np.array([t for _, t in names])
    fitted = np.array([s in FITTED for s, _ in names])
    gamma = np.asarray(angle_between(view.zenith[None], jnp.asarray(sun)[:, None], view.azimuth[None]))
    weight = np.asarray(view.zenith <= np.radians(85.0), float)
    model = dataclasses.replace(
        skyfit.ExtendedPreetham.shipped(), fitted_turbidity=(min(TURBIDITIES), max(TURBIDITIES)),
        fitted_sun=(0.0, math.radians(LOWEST)),
    )  # fmt: skip
    asked, found = [jnp.asarray(v[fitted]) for v in (gamma, sun, haze)], {}
    for q, name in enumerate(("Y", "x", "y")):
        target = jnp.asarray(light[fitted][..., q])
        start = EXTENDED.start(q, target, sun[fitted], haze[fitted])
        ended = fit_joint(EXTENDED, q, start, (target, asked[0], view.zenith, *asked[1:], jnp.asarray(weight)))
        model = EXTENDED.put(model, q, ended.value)
        print(name, "fitted", flush=True)
    one = jax.vmap(lambda t, s, g: jnp.stack(model.luminance_chromaticity(t, s, view.zenith, g), axis=-1))
    found["extended"] = np.asarray(one(jnp.asarray(haze), jnp.asarray(sun), jnp.asarray(gamma)))
    parts = []
    for q in range(3):
        target = jnp.asarray(light[..., q])
        begin = {} if q == 0 else {"start": START}
        fits = skyfit.fit_perez(
            target, target[:, -1], view.zenith, jnp.asarray(gamma), jnp.asarray(sun), jnp.asarray(weight / UNIT[q]),
            **begin,
        )  # fmt: skip

        def alone(c, zenith, angle, place):
            return zenith * Perez.from_coefficients(c).ratio(view.zenith, angle, place)

        parts.append(jax.vmap(alone)(fits.coefficients, target[:, -1], jnp.asarray(gamma), jnp.asarray(sun)))
    found["best five"] = np.asarray(jnp.stack(parts, axis=-1))
    low = np.asarray(view.zenith) <= np.radians(80.0)
    rows = []
    for first, last in CLASSES:
        degrees = np.degrees(sun)
        for kind, of in (("fitted", fitted), ("between", ~fitted)):
            here = of & (degrees > first - 1e-9) & (degrees <= last + 1e-9)
            for name, answer in found.items():
                error = np.abs(answer[here][:, low, 0] / light[here][:, low, 0] - 1.0)
                colour = np.hypot(*(answer[here][:, low, k] - light[here][:, low, k] for k in (1, 2)))
                rows.append({
                    "suns": [first, last], "skies": kind, "model": name, "median": float(np.median(error)),
                    "p95": float(np.percentile(error, 95.0)), "xy": float(np.median(colour)),
                })  # fmt: skip
                print(rows[-1], flush=True)
    RESULT.write_text(json.dumps(made_with(0) | {"turbidities": TURBIDITIES, "errors": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
