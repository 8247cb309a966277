"""What straight rays cost: sunlight scattered once by sasktran2, with refraction and without.

    python -m experiments.validation.refraction

Air and haze of 0.1 in exponential profiles, 550 nm, the sun by its geometric zenith angle. Refraction bends the sun's
rays and the views, whose zenith angles are those at the eye. Straight rays are taken under the sun's true place, its
apparent one, and half way between, which `simulate` and `render` take of a time and a place. Views from the ground, and
limbs seen from 400 km by the height of their lowest point were they straight. Writes
experiments/results/refraction.json.
"""

import json

import numpy as np

from experiments.benchmarks.rivals import EARTH_RADIUS, SCALE_HEIGHTS
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.measured.solar_position import refraction


RESULT = HERE / "results" / "refraction.json"
SUNS = (60.0, 80.0, 85.0, 88.0, 90.0, 92.0, 94.0, 96.0, 98.0)
# zenith angle and azimuth from the sun's, degrees
VIEWS = {"zenith": (0.0, 0.0), "60 toward": (60.0, 0.0), "60 away": (60.0, 180.0), "85 toward": (85.0, 0.0)}
SPACE, LIMBS = 400e3, (5e3, 10e3, 20e3, 30e3)
# of the refraction at the ground
SHARES = {"true sun": 0.0, "half way": 0.5, "apparent sun": 1.0}
# optical depths at 550 nm; n - 1 at sea level, 550 nm, 15 C (Ciddor 1996)
DEPTHS, REFRACTIVITY = (0.097, 0.1), 2.78e-4


def light(sun: float, rays, bent: bool) -> np.ndarray:
    """Radiance per unit irradiance of the rays that `rays` makes of the sun's cosine."""
    import sasktran2 as sk

    config = sk.Config()
    config.single_scatter_source = sk.SingleScatterSource.Exact
    config.multiple_scatter_source = sk.MultipleScatterSource.NoSource
    config.num_singlescatter_moments = 64
    config.los_refraction = config.solar_refraction = bent
    config.los_refraction_max_tangent_altitude_m = 100e3
    height = np.linspace(0.0, 100e3, 401)
    cosine = float(np.cos(np.radians(sun)))
    model = sk.Geometry1D(cosine, 0.0, EARTH_RADIUS, height)
    model.refractive_index = 1.0 + REFRACTIVITY * np.exp(-height / SCALE_HEIGHTS[0])
    views = sk.ViewingGeometry()
    for ray in rays(cosine):
        views.add_ray(ray)
    air = sk.Atmosphere(model, config, numwavel=1, calculate_derivatives=False)
    degree = np.arange(64)
    phases = np.where(degree == 0, 1.0, np.where(degree == 2, 0.5, 0.0)), (2 * degree + 1) * 0.7**degree
    for name, scale, depth, phase in zip(("air", "haze"), SCALE_HEIGHTS, DEPTHS, phases, strict=True):
        extinction = (depth / scale * np.exp(-height / scale))[:, None]
        moments = np.tile(phase[:, None, None], (1, height.size, 1))
        air[name] = sk.constituent.Manual(extinction, np.ones_like(extinction), moments)
    air["ground"] = sk.constituent.LambertianSurface(np.zeros(1))
    return sk.Engine(config, model, views).calculate_radiance(air)["radiance"].to_numpy().ravel()


def from_the_ground(cosine: float):
    import sasktran2 as sk

    for zenith, azimuth in VIEWS.values():
        yield sk.SolarAnglesObserverLocation(cosine, np.radians(azimuth), np.cos(np.radians(zenith)), 0.0)


def limbs(cosine: float):
    import sasktran2 as sk

    for height in LIMBS:
        yield sk.TangentAltitudeSolar(height, np.radians(90.0), SPACE, cosine)


def main():
    record = {"made_with": made_with(0, ("sasktran2",)), "straight_over_refracted": {}}
    limb_names = [f"limb at {height / 1e3:g} km" for height in LIMBS]
    for sun in SUNS:
        rows = {}
        for names, rays, shares in ((list(VIEWS), from_the_ground, SHARES), (limb_names, limbs, {"true sun": 0.0})):
            bent = light(sun, rays, True)
            for sun_name, share in shares.items():
                lifted = share * float(refraction(np.array([90.0 - sun]), 101325.0)[0])
                off = light(sun - lifted, rays, False) / bent - 1.0
                rows.setdefault(sun_name, {}).update(dict(zip(names, off.tolist(), strict=True)))
        record["straight_over_refracted"][f"{sun:g}"] = rows
        for sun_name, row in rows.items():
            print(f"{sun:g}, {sun_name}:", ", ".join(f"{name} {off:+.1%}" for name, off in row.items()))
    RESULT.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
