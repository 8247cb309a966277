"""Planes that mitsuba lights with a map and a lamp of `skyfit.render`, against the irradiance that the solver states.

    python -m experiments.validation.lighting

The map is written as EXR and the lamp as JSON, as the command writes them, and mitsuba reads the files: a level plane,
and upright ones toward the sun, away from it, and to its right. What the level one gets is `fluxes` of the solver; what
upright ones get, the integral of its radiance over the half sphere before them, and the beam. Writes
experiments/results/lighting.json.
"""

import json
import tempfile
from pathlib import Path

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.image.render import SPECTRUM, sunlight
from skyfit.light import SRGB_LUMINANCE


RESULT = HERE / "results" / "lighting.json"
SUNS, AZIMUTH, TURBIDITY, EYE = (30.0, 60.0, 80.0), 250.0, 3.0, 2.0
SIZE, SAMPLES, SEED = (1024, 512), 4096, 3
# degrees between the azimuths of the sun and of what an upright plane faces; None: level
PLANES = {"level": None, "toward the sun": 0.0, "to its right": 90.0, "away": 180.0}


def by_mitsuba(folder: Path, normal: np.ndarray) -> float:
    """Illuminance (lx) of a plane under sky.exr and sky.lamp.json of a folder."""
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    lamp = json.loads((folder / "sky.lamp.json").read_text())
    # the picture's azimuth grows to the right, south in its middle: x east, y up, z south there
    turned = mitsuba.ScalarTransform4f([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    beam = {"type": "rgb", "value": [max(v, 0.0) for v in lamp["linear_srgb_lx"]]}
    toward = [-float(v) for v in lamp["toward_east_north_up"]]
    look = mitsuba.ScalarTransform4f().look_at
    aside = [0.0, 0.0, 1.0] if abs(normal[2]) < 0.5 else [0.0, 1.0, 0.0]
    place = [float(v) for v in normal]
    scene = mitsuba.load_dict({
        "type": "scene", "integrator": {"type": "direct"},
        "sky": {"type": "envmap", "filename": str(folder / "sky.exr"), "to_world": turned},
        "sun": {"type": "directional", "direction": toward, "irradiance": beam},
        "plane": {
            "type": "rectangle", "to_world": look([0, 0, 0], place, aside),
            "material": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
        },
        "camera": {
            "type": "perspective", "fov": 1.0, "to_world": look(place, [0, 0, 0], aside),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": SAMPLES},
        },
    })  # fmt: skip
    seen = np.asarray(mitsuba.render(scene, seed=SEED), float)[..., :3].mean(axis=(0, 1))
    return float(np.pi * seen @ SRGB_LUMINANCE)


def by_solver(air: skyfit.Atmosphere, sun: float) -> dict[str, float]:
    """Illuminance (lx) of the planes by the solver's radiance and beam."""
    node, weight = np.polynomial.legendre.leggauss(64)
    azimuths = 2.0 * np.pi * (np.arange(128) + 0.5) / 128
    # up and down alone: each panel between horizon and pole
    cosine = np.concatenate([0.5 * (node + 1.0), 0.5 * (node - 1.0)])
    zenith, azimuth = (v.ravel() for v in np.meshgrid(np.arccos(cosine), azimuths, indexing="ij"))
    size = np.repeat(np.tile(0.5 * weight, 2), 128) * 2.0 * np.pi / 128
    views = skyfit.Directions(zenith, azimuth)
    scene = skyfit.Scene(np.radians(sun), np.radians(AZIMUTH), views, SPECTRUM, sunlight(), EYE)
    field = skyfit.Spherical.normal().prepare(air, SPECTRUM, sun_zenith=np.radians(sun), height=EYE)
    light = np.asarray(skyfit.xyz(field.radiance(scene), SPECTRUM))[:, 1]
    fluxes = field.fluxes(scene)
    direct, diffuse = (float(skyfit.xyz(v, SPECTRUM)[1]) for v in (fluxes.direct, fluxes.diffuse_down))
    found = {"level": direct + diffuse}
    beam = direct / np.cos(np.radians(sun))
    for name, turn in PLANES.items():
        if turn is not None:
            across = np.sin(zenith) * np.cos(azimuth - np.radians(AZIMUTH + turn))
            lit = beam * np.sin(np.radians(sun)) * max(np.cos(np.radians(turn)), 0.0)
            found[name] = float(size * np.maximum(across, 0.0) @ light) + lit
    return found


def measured() -> list[dict]:
    """Illuminances of all suns and planes, and how far apart they are."""
    air, rows = skyfit.Atmosphere.from_turbidity(TURBIDITY), []
    for sun in SUNS:
        wanted = by_solver(air, sun)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            angles = {"sun_zenith": np.radians(sun), "sun_azimuth": np.radians(AZIMUTH)}
            image = skyfit.render(air, skyfit.Camera("equirect", *SIZE), **angles, sun="lamp", height=EYE)
            image.save(folder / "sky.exr")
            image.save_lamp(folder / "sky.lamp.json")
            for plane, turn in PLANES.items():
                facing = np.radians(AZIMUTH + (turn or 0.0))
                normal = np.array([0.0, 0.0, 1.0] if turn is None else [np.sin(facing), np.cos(facing), 0.0])
                found = by_mitsuba(folder, normal)
                error = found / wanted[plane] - 1.0
                rows.append(
                    {"sun_deg": sun, "plane": plane, "mitsuba_lx": found, "skyfit_lx": wanted[plane], "error": error}
                )
                print(rows[-1], flush=True)
    return rows


def main() -> None:
    jax.config.update("jax_enable_x64", False)
    rows = measured()
    about = made_with(SEED, ("mitsuba",)) | {"samples": SAMPLES * 64, "size": list(SIZE), "turbidity": TURBIDITY}
    worst = max(abs(row["error"]) for row in rows)
    RESULT.write_text(json.dumps(about | {"worst": worst, "planes": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
