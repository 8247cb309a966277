"""Whether the light of `Spherical` runs on without steps through sunset and across the horizon.

    python -m experiments.validation.continuity

Air, haze of 0.2 and ozone, `normal`, one field. Suns from 80 to 108 degrees by a hundredth for some views, and view
zenith angles by a hundredth on each side of the horizon from 10 km: second differences over the radiance, of all light,
of sunlight scattered once, whose shadow edges are kinks, and of the rest. Toward a sun at 95 degrees, where light
changes within hundredths of a degree, `fine` beside `normal`. In the precision of the process. Writes
experiments/results/continuity.json.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with


RESULT = HERE / "results" / "continuity.json"
NM = np.array([450.0, 650.0])
ATMOSPHERE = skyfit.Atmosphere.from_optical_depth(0.2)
STEP, LIMIT = 0.01, 1e-3
SUNS = np.arange(80.0, 108.0, STEP)
# zenith angle and azimuth from the sun's, degrees
VIEWS = {"zenith": (0.0, 0.0), "60 toward": (60.0, 0.0), "60 away": (60.0, 180.0), "88 toward": (88.0, 0.0)}
# m, and degrees above and below its horizon at which views begin
ALOFT, NEAR, FAR = 10e3, 0.005, 8.0


def judged(total, once, at) -> dict:
    """Second differences of `[step, wavelength]`; `at` in degrees."""

    def largest(light):
        second = np.abs(np.diff(light, 2, axis=0)) / total[1:-1]
        place = np.unravel_index(np.argmax(second), second.shape)[0]
        over = np.any(second > LIMIT, axis=1)
        return {"largest": float(second.max()), "at_deg": float(at[1:-1][place]), "over_the_limit": int(over.sum())}

    return {
        "all": largest(total), "scattered once": largest(once), "the rest": largest(total - once),
        "negative": int(np.sum(total < 0.0)), "not_finite": int(np.sum(~np.isfinite(total))),
    }  # fmt: skip


def through_sunset(field) -> dict:
    once, rows = skyfit.SingleScattering.normal(), {}
    zenith, azimuth = np.array(list(VIEWS.values())).T
    view = skyfit.Directions.from_degrees(zenith, azimuth)

    def light(sun):
        scene = skyfit.Scene(sun, 0.0, view, NM, np.ones(2))
        return field.radiance(scene), once.radiance(field.atmosphere, scene)

    suns = jnp.asarray(np.radians(SUNS))
    total, single = (np.asarray(v, float) for v in jax.lax.map(light, suns, batch_size=64))
    for k, name in enumerate(VIEWS):
        rows[name] = judged(total[:, k], single[:, k], SUNS)
    return rows


def sides() -> dict[str, np.ndarray]:
    """View zenith angles from aloft on each side of the horizon, degrees."""
    horizon = 180.0 - np.degrees(np.arcsin(skyfit.transport.columns.EARTH_RADIUS / (6371e3 + ALOFT)))
    away = NEAR + np.arange(0.0, FAR, STEP)
    return {"above": horizon - away, "below": horizon + away}


def across_the_horizon(field) -> dict:
    """From aloft, toward the sun and across, on each side."""
    once, rows = skyfit.SingleScattering.normal(), {}
    for sun in (60.0, 88.0, 95.0):
        for azimuth in (0.0, 90.0):
            for side, zenith in sides().items():
                view = skyfit.Directions.from_degrees(zenith, np.full(zenith.shape, azimuth))
                scene = skyfit.Scene.from_degrees(sun, view, NM, irradiance="unit", height=ALOFT)
                total = np.asarray(field.radiance(scene), float)
                single = np.asarray(once.radiance(field.atmosphere, scene), float)
                rows[f"sun {sun:g}, azimuth {azimuth:g}, {side}"] = judged(total, single, zenith)
    return rows


def by_fine() -> dict:
    """Second differences toward a sun at 95 degrees of `normal` and of `fine`, and how far apart they are, at most."""
    rows = {}
    for side, zenith in sides().items():
        view = skyfit.Directions.from_degrees(zenith, np.zeros(zenith.shape))
        scene = skyfit.Scene.from_degrees(95.0, view, NM, irradiance="unit", height=ALOFT)
        found = {}
        for name in ("normal", "fine"):
            light = np.asarray(getattr(skyfit.Spherical, name)().radiance(ATMOSPHERE, scene), float)
            found[name] = np.diff(light, 2, axis=0) / light[1:-1]
        rows[side] = {name: float(np.abs(second).max()) for name, second in found.items()}
        rows[side]["apart"] = float(np.abs(found["normal"] - found["fine"]).max())
    return rows


def main():
    field = skyfit.Spherical.normal().prepare(ATMOSPHERE, NM)
    record = {"made_with": made_with(0), "step_deg": STEP, "limit": LIMIT}
    record |= {"through sunset": through_sunset(field), "across the horizon": across_the_horizon(field)}
    record["sun 95, azimuth 0, by fine too"] = by_fine()
    RESULT.write_text(json.dumps(record, indent=1) + "\n")
    print(json.dumps(record["sun 95, azimuth 0, by fine too"]))
    for part in ("through sunset", "across the horizon"):
        for name, row in record[part].items():
            figures = [f"{key} {row[key]['largest']:.1e} at {row[key]['at_deg']:.2f} ({row[key]['over_the_limit']})"
                       for key in ("all", "scattered once", "the rest")]  # fmt: skip
            print(f"{name}: {'; '.join(figures)}; {row['negative']} negative, {row['not_finite']} not finite")


if __name__ == "__main__":
    main()
