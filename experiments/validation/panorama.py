"""Pictures of skies that others rendered, read and inverted: the sun, the haze, wrong guesses, masks and clouds.

    python -m experiments.validation.panorama

Skies of Hosek & Wilkie as mitsuba's `sunsky` has them (without the sun), of Preetham as published and of skyfit's own
`Spherical`, written as pictures of unknown level. Writes experiments/results/panorama.json, and which optical depth has
the pattern of which turbidity of Hosek & Wilkie into data/hosek_turbidity.csv, by which `skyfit invert` translates.
"""

import json
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

import skyfit
from experiments.benchmarks.tiers import HERE, made_with
from skyfit.image.files import write_picture
from skyfit.measured.quality.placed_sun import cosine_from_sun


RESULT = HERE / "results" / "panorama.json"
TABLE = HERE.parent / "data" / "hosek_turbidity.csv"
WIDE, HIGH = 360, 180
AZIMUTH, SEED = 200.0, 7
TURBIDITIES, SUNS = (2.0, 3.0, 5.0, 8.0), (30.0, 60.0, 75.0)
OF_PREETHAM = (2.0, 3.0)
# the coarse solver is within some per cent, the models are tens apart
SOLVER = skyfit.OrdersOfScattering.draft()
# degrees that a first guess is off: in zenith angle and in azimuth
GUESSES = ((20.0, 0.0), (-20.0, 0.0), (0.0, 20.0), (14.0, -14.0))
# encoded 8 bits, where the picture's white is so many times the median green
WHITE = 6.0


def of_mitsuba(turbidity: float, sun_deg: float) -> np.ndarray:
    """The emitter's radiance on a whole sphere, `[row, column, 3]`, linear sRGB."""
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    sun = [float(v) for v in np.asarray(skyfit.unit_vectors(np.radians(sun_deg), np.radians(AZIMUTH)))]
    emitter = mitsuba.load_dict({"type": "sunsky", "turbidity": turbidity, "sun_direction": sun, "sun_scale": 0.0})
    where = mitsuba.SurfaceInteraction3f()
    views = skyfit.Camera("equirect", WIDE, HIGH).views(0, HIGH // 2).reshape(3, -1).T.astype(float)
    found = np.zeros((HIGH, WIDE, 3))
    for pixel, view in enumerate(views):
        where.wi = -mitsuba.Vector3f(*map(float, view))
        found[divmod(pixel, WIDE)] = np.array(emitter.eval(where))
    return found


def of_skyfit(sky, turbidity: float | None, sun_deg: float) -> np.ndarray:
    camera, asked = skyfit.Camera("equirect", WIDE, HIGH), {} if turbidity is None else {"turbidity": turbidity}
    sun = {"sun_zenith": float(np.radians(sun_deg)), "sun_azimuth": float(np.radians(AZIMUTH))}
    return np.asarray(skyfit.render(sky, camera, sun="none", **sun, **asked).rgb())


def clouded(picture: np.ndarray) -> np.ndarray:
    """With white clouds over a sixth of the sky."""
    random, views = np.random.default_rng(SEED), skyfit.Camera("equirect", WIDE, HIGH).views()
    found, level = picture.copy(), 2.5 * np.median(picture[: HIGH // 2], axis=(0, 1)).mean()
    middles = np.asarray(skyfit.unit_vectors(np.arccos(random.uniform(0.2, 0.95, 12)), random.uniform(0.0, 6.28, 12)))
    for middle, radius in zip(middles.T, random.uniform(7.0, 14.0, 12), strict=True):
        found[np.einsum("c,crx->rx", middle, views) > np.cos(np.radians(radius))] = level
    return found


def written(folder: Path, picture: np.ndarray, name: str = "sky.exr") -> Path:
    path = folder / name
    if path.suffix == ".png":
        white = WHITE * np.median(picture[: HIGH // 2, :, 1])
        encoded = np.asarray(skyfit.srgb_from_linear(np.clip(picture / white, 0.0, 1.0)))
        write_picture(path, np.round(255.0 * encoded).astype(np.uint8), "uint8", {})
    else:
        write_picture(path, picture.astype(np.float32), "float", {})
    return path


def apart(found, sun_deg: float) -> float:
    cosine = cosine_from_sun(found.zenith, found.azimuth, np.radians(sun_deg), np.radians(AZIMUTH))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def inverted(path: Path, sun_deg: float, **told) -> dict:
    """The sun and the haze of a picture."""
    start = time.perf_counter()
    panorama = skyfit.read_panorama(path, **told)
    read = time.perf_counter() - start
    fit = skyfit.invert(panorama.sky, panorama.free, SOLVER)
    place = {name: k for k, name in enumerate(fit.free)}
    row = {
        "sun": {"how": panorama.sun.how, "off_deg": apart(panorama.sun, sun_deg),
                "sigma_deg": float(np.degrees(panorama.sun.sigma))},
        "result": fit.result[0], "chi_square": float(fit.reduced_chi_square[0]),
        "rmse_by_mean": float(fit.rmse[0] / np.mean(panorama.sky.radiance[panorama.sky.usable])),
        "seconds": {"read": read, "all": time.perf_counter() - start},
    }  # fmt: skip
    for name in fit.free:
        k = place[name]
        row[name] = {"value": float(fit.values[0, k]), "sigma": float(fit.sigma[0, k])}
    row["aerosol_optical_depth"] = float(skyfit.turbidity_to_optical_depth(row["turbidity"]["value"]))
    return row


def guessed(path: Path, sun_deg: float) -> list[dict]:
    """The sun from guesses that are 20 degrees off."""
    rows = []
    for zenith, azimuth in GUESSES:
        first = min(max(sun_deg + zenith, 0.0), 90.0), AZIMUTH + azimuth / np.sin(np.radians(sun_deg))
        found = skyfit.read_panorama(path, sun=(float(np.radians(first[0])), float(np.radians(first[1])))).sun
        rows.append({"guess_deg": first, "how": found.how, "off_deg": apart(found, sun_deg)})
    return rows


def main():
    jax.config.update("jax_enable_x64", True)
    rows, guesses, special = [], [], {}

    def put(model, turbidity, sun, row):
        rows.append({"model": model, "turbidity_of_model": turbidity, "sun_deg": sun} | row)
        print(json.dumps(rows[-1]), flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for turbidity in TURBIDITIES:
            for sun in (*SUNS, 85.0):
                path = written(folder, of_mitsuba(turbidity, sun))
                if turbidity == 3.0:
                    guesses.append({"turbidity": turbidity, "sun_deg": sun, "found": guessed(path, sun)})
                if sun in SUNS:
                    put("hosek_wilkie", turbidity, sun, inverted(path, sun))
        published = skyfit.Preetham.published()
        for turbidity in OF_PREETHAM:
            for sun in SUNS[:2]:
                put("preetham", turbidity, sun, inverted(written(folder, of_skyfit(published, turbidity, sun)), sun))
        for sun in SUNS:
            with jax.enable_x64(False):
                picture = of_skyfit(skyfit.Atmosphere.from_turbidity(3.0), None, sun)
            put("skyfit", 3.0, sun, inverted(written(folder, picture), sun))
        own = of_skyfit(skyfit.ExtendedPreetham.shipped(), 3.0, 50.0)
        mask = np.full((HIGH, WIDE, 3), 255, np.uint8)
        mask[:, : WIDE // 3] = 0
        write_picture(folder / "mask.png", mask, "uint8", {})
        cases = {
            "whole": (own, "sky.exr", {}), "a third masked": (own, "sky.exr", {"mask": folder / "mask.png"}),
            "8 bits, saturated": (own, "sky.png", {}), "clouds": (clouded(own), "sky.exr", {}),
        }  # fmt: skip
        for case, (picture, file, told) in cases.items():
            special[case] = inverted(written(folder, picture, file), 50.0, **told)
            print(case, json.dumps(special[case]), flush=True)
    alike = {
        turbidity: [row["aerosol_optical_depth"] for row in rows
                    if (row["model"], row["turbidity_of_model"]) == ("hosek_wilkie", turbidity)]
        for turbidity in TURBIDITIES
    }  # fmt: skip
    record = {
        "made_with": made_with(SEED, ("mitsuba",)), "solver": "OrdersOfScattering.draft", "pixels": [WIDE, HIGH],
        "suns_deg": SUNS, "skies": rows, "guesses": guesses, "special": special,
        "aerosol_optical_depth_of_hosek": {f"{turbidity:g}": depths for turbidity, depths in alike.items()},
    }  # fmt: skip
    RESULT.write_text(json.dumps(record, indent=1) + "\n")
    lines = [
        "# Aerosol optical depth at 550 nm whose sky has the pattern of Hosek & Wilkie's, level free: median",
        "# over suns of 30, 60 and 75 degrees. Made by experiments/validation/panorama.py from mitsuba's sunsky.",
        "hosek_turbidity,aerosol_optical_depth",
        *(f"{turbidity:g},{np.median(depths):.4f}" for turbidity, depths in alike.items()),
    ]
    TABLE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
