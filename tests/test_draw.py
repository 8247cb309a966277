"""Pictures: that they are written whole, of a sensible size, and show what they should."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.image import imread
from skies import fit_of_made_sky, MADE_FREE as FREE, MADE_SHARED

from skyfit import hemisphere
from skyfit.draw import plot, plot_skies
from skyfit.draw.dome import cells, interpolated, pixels, place
from skyfit.draw.domes import _pictures
from skyfit.draw.fit_table import LINE, shared_height
from skyfit.measured import Response
from skyfit.retrieve import Fit


@pytest.fixture(scope="session")
def fit() -> Fit:
    """A fit to a sky of the solver's own, with noise, as if its times shared nothing."""
    return replace(fit_of_made_sky(), shared=())


def picture_of(path) -> np.ndarray:
    picture = imread(path)[..., :3]
    assert np.ptp(picture) == 1.0
    return picture


def coloured(picture) -> np.ndarray:
    """Pixels that are no grey."""
    return np.ptp(picture, axis=-1) > 0.05


def test_a_fit_is_drawn(fit, tmp_path):
    plot(fit, tmp_path / "fit.png")
    picture = picture_of(tmp_path / "fit.png")
    assert 900 < picture.shape[0] < 1300 and 1800 < picture.shape[1] < 2400
    assert coloured(picture).mean() > 0.05
    assert [path.name for path in tmp_path.iterdir()] == ["fit.png"]
    # the margins are empty: nothing runs over the edge
    for edge in (picture[:8], picture[-8:], picture[:, :8], picture[:, -8:]):
        assert np.all(edge == 1.0)


def residual_domes(path, times=2) -> np.ndarray:
    """The part of a picture in which the residual domes lie, without their scales."""
    picture = picture_of(path)
    tall, wide = picture.shape[:2]
    x = slice(int(wide * 4.5 / 14.2), int(wide * 6.55 / 14.2))
    row = (tall / 150 - 0.62 - 0.55) / times
    parts = [picture[int(150 * (0.62 + t * row + 0.6)) : int(150 * (0.62 + t * row + 2.5)), x] for t in range(times)]
    return np.stack([part[: min(len(p) for p in parts)] for part in parts])


def test_the_residual_of_a_perfect_fit_is_blank(fit, tmp_path):
    plot(fit, tmp_path / "noisy.png")
    assert coloured(residual_domes(tmp_path / "noisy.png")).mean() > 0.2
    perfect = replace(fit, sky=replace(fit.sky, radiance=fit.model))
    plot(perfect, tmp_path / "perfect.png")
    assert not coloured(residual_domes(tmp_path / "perfect.png")).any()


@pytest.mark.parametrize("count", [1, 11])
def test_a_page_holds_one_to_eight_times(fit, tmp_path, count):
    order = np.arange(count) % 2

    def repeat(values):
        return values[order] if isinstance(values, np.ndarray) else tuple(values[i] for i in order)

    names = ("radiance", "usable", "view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth", "time")
    sky = replace(fit.sky, **{name: repeat(getattr(fit.sky, name)) for name in names})
    names = (
        "values", "sigma", "covariance", "model_sigma", "at_bound", "determined", "model", "used", "rmse",
        "common", "scale", "beam_residual", "reduced_chi_square", "weight", "steps", "result", "undetermined",
    )  # fmt: skip
    plot(replace(fit, sky=sky, **{name: repeat(getattr(fit, name)) for name in names}), tmp_path / "fit.png")
    tall = picture_of(tmp_path / "fit.png").shape[0] / 150
    assert tall == pytest.approx(0.62 + 0.55 + 3.04 * min(count, 8), abs=0.02)


def test_a_poor_fit_is_drawn(fit, tmp_path):
    """No finite sigma, nothing determined, many words, a sky far into the ultraviolet, a sun below."""
    sky = replace(
        fit.sky,
        wavelength_nm=np.array([310.0, 320.0, 330.0, 340.0]),
        sun_zenith=np.radians([95.0, 40.0]),
        view_zenith=np.append(fit.sky.view_zenith[0, :-1], np.radians(95.0)),
        usable=fit.sky.usable & (np.arange(10) < 9)[:, None],
    )
    words = ("only a combination is determined of " + ", ".join(FREE * 4),) * 12
    poor = replace(
        fit, sky=sky, used=sky.usable & (np.arange(4) == 1), sigma=np.full((2, 4), np.nan),
        at_bound=np.ones((2, 4), bool), determined=np.zeros((2, 4), bool), undetermined=(words, ()),
        fwhm_nm=float("nan"), result=("failed", "stopped"),
    )  # fmt: skip
    plot(poor, tmp_path / "poor.png")
    picture = picture_of(tmp_path / "poor.png")
    assert picture.shape[0] > 1500
    assert np.all(picture[:, -8:] == 1.0)


def test_what_all_times_share_is_written_once(fit, tmp_path):
    """In letters of the page as SVG, where text stays text."""
    words = "only a combination is determined of turbidity, asymmetry"
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        for shared in ((), MADE_SHARED):
            told = replace(fit, shared=shared, undetermined=((words, "one thing"), (words,)))
            plot(told, tmp_path / "fit.svg")
            page = (tmp_path / "fit.svg").read_text()
            assert page.count(">asymmetry<") == page.count(f">{words}<") == (1 if shared else 2)
            assert page.count(">turbidity<") == 2 and page.count(">one thing<") == 1
            assert page.count(">all times<") == len(shared)
    assert shared_height(told) == pytest.approx(3 * LINE + 0.1) and shared_height(fit) == 0.0
    plot(told, tmp_path / "fit.png")
    tall = picture_of(tmp_path / "fit.png").shape[0] / 150
    assert tall == pytest.approx(0.62 + 0.55 + 2 * 3.04 + 3 * LINE + 0.1, abs=0.02)


def test_rejected_directions_are_crossed_out(fit, tmp_path):
    weight = fit.weight.copy()
    weight[0, [1, 5]] = 0.2
    perfect = replace(fit, sky=replace(fit.sky, radiance=fit.model))
    plot(replace(perfect, weight=weight), tmp_path / "fit.png")
    # nothing else of a perfect fit's residual has a colour
    magenta = [coloured(dome).sum() for dome in residual_domes(tmp_path / "fit.png")]
    assert magenta[0] > 40 and magenta[1] == 0


def test_channels_of_a_camera_are_drawn_in_their_unit(fit, tmp_path):
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        plot(replace(fit, response=Response.xyz()), tmp_path / "fit.svg")
    page = (tmp_path / "fit.svg").read_text()
    assert "mean radiance, in the channels' unit" in page and " mW" not in page and ">mW" not in page


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_other_formats(fit, tmp_path, suffix):
    plot(fit, tmp_path / f"fit{suffix}")
    assert (tmp_path / f"fit{suffix}").stat().st_size > 10_000


def skies(directions):
    """A blue sky with a glow, and the same with a tenth less light."""
    x, y = place(np.asarray(directions.zenith), np.asarray(directions.azimuth))
    glow = np.exp(-2.0 * np.hypot(x - 0.3, y - 0.2))
    first = 4000.0 * np.stack([0.9 + glow, 1.0 + glow, 1.6 + glow], axis=-1)
    return {"simulated": first, "refitted": 0.9 * first}


def test_skies_are_drawn(tmp_path):
    directions = hemisphere(120)
    rows = [("sun zenith 60, T 3", skies(directions)), ("sun zenith 30, T 2", skies(directions))]
    plot_skies(directions, rows, tmp_path / "skies.png", [(1.0, 2.0), (0.5, 0.0)])
    picture = picture_of(tmp_path / "skies.png")
    assert picture.shape[0] > 600 and picture.shape[1] > 900
    # the simulated domes are blue, the error of -10 % too
    blue = (picture[..., 2] - picture[..., 0]) > 0.05
    assert blue.mean() > 0.15
    assert [path.name for path in tmp_path.iterdir()] == ["skies.png"]


def test_a_bright_horizon_leaves_no_holes_beside_it(tmp_path):
    directions = hemisphere(343)
    bright = np.asarray(directions.zenith)[:, None] > 1.54
    grey = np.where(bright, 100.0, 1.0) * np.ones(3)
    plot_skies(directions, [("steep", {"simulated": grey})], tmp_path / "skies.png", [(2.0, 0.0)])
    dome = _pictures(np.asarray(directions.zenith), np.asarray(directions.azimuth), [[grey]])[0][0]
    assert np.nanmin(dome) > 0.3


def test_one_sky_alone_and_directions_that_are_given_twice(tmp_path):
    grid = np.radians(np.meshgrid([0.0, 20.0, 40.0, 60.0, 80.0], np.arange(0.0, 361.0, 30.0)))
    directions = replace(hemisphere(1), zenith=grid[0].ravel(), azimuth=grid[1].ravel(), weight=None)
    rows = [("alone", {"simulated": skies(directions)["simulated"]})]
    plot_skies(directions, rows, tmp_path / "skies.png", [(2.0, 0.0)])
    assert coloured(picture_of(tmp_path / "skies.png")).mean() > 0.15


def test_what_cannot_be_drawn_is_said(fit, tmp_path):
    directions = hemisphere(120)
    rows = [("a", skies(directions))]
    with pytest.raises(ValueError, match=r"fit\.txt: expected a suffix of \.png"):
        plot(fit, tmp_path / "fit.txt")
    with pytest.raises(ValueError, match="`rows` must hold one or more"):
        plot_skies(directions, [], tmp_path / "skies.png", [])
    with pytest.raises(ValueError, match="same names"):
        plot_skies(
            directions,
            [*rows, ("b", {"other": rows[0][1]["simulated"]})],
            tmp_path / "s.png",
            [(0.0, 0.0)] * 2,
        )
    with pytest.raises(ValueError, match="`sun` must have"):
        plot_skies(directions, rows, tmp_path / "skies.png", [])
    with pytest.raises(ValueError, match="shape"):
        plot_skies(hemisphere(100), rows, tmp_path / "skies.png", [(0.0, 0.0)])
    with pytest.raises(ValueError, match="ten or more"):
        plot_skies(hemisphere(5), [("a", skies(hemisphere(5)))], tmp_path / "skies.png", [(0.0, 0.0)])
    with pytest.raises(ValueError, match="existing folder"):
        plot(fit, tmp_path / "none" / "fit.png")
    assert not list(tmp_path.iterdir())


def test_nothing_is_left_half_written(fit, tmp_path, monkeypatch):
    def fail(self, path, **_):
        path.write_bytes(b"half")
        raise RuntimeError("the disk is full")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", fail)
    (tmp_path / "fit.png").write_text("old")
    with pytest.raises(RuntimeError, match="full"):
        plot(fit, tmp_path / "fit.png")
    assert (tmp_path / "fit.png").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["fit.png"]


def test_no_global_state(fit, tmp_path):
    before = dict(matplotlib.rcParams)
    plot(fit, tmp_path / "fit.png")
    assert dict(matplotlib.rcParams) == before
    assert not pyplot.get_fignums()


def test_north_is_up_and_east_is_right():
    x, y = place(np.radians([90.0, 90.0, 0.0]), np.radians([0.0, 90.0, 0.0]))
    np.testing.assert_allclose(x, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(y, [1.0, 0.0, 0.0], atol=1e-12)
    # of four directions, each is nearest in its own part of the page: rows run downward
    nearest = cells(np.radians([45.0] * 4), np.radians([0.0, 90.0, 180.0, 270.0]))
    middle, size = nearest.shape[0] // 2, nearest.shape[0]
    quarter = size // 4
    assert nearest[quarter, middle] == 0
    assert nearest[middle, size - quarter] == 1
    assert nearest[size - quarter, middle] == 2
    assert nearest[middle, quarter] == 3
    assert nearest[0, 0] == -1


def test_cells_end_where_nothing_was_measured():
    directions = hemisphere(200, np.radians(40.0))
    nearest = cells(np.asarray(directions.zenith, float), np.asarray(directions.azimuth, float))
    zenith, _, inside = pixels()
    assert np.all(nearest[zenith < np.radians(38.0)] >= 0)
    assert np.all(nearest[inside & (zenith > np.radians(55.0))] == -1)


def test_the_picture_goes_through_the_values():
    directions = hemisphere(343)
    zenith, azimuth = np.asarray(directions.zenith, float), np.asarray(directions.azimuth, float)
    values = np.stack([np.cos(zenith), np.sin(zenith) * np.sin(azimuth)], axis=-1)
    picture = interpolated(zenith, azimuth, values)
    pixel_zenith, pixel_azimuth, inside = pixels()
    expected = np.stack([np.cos(pixel_zenith), np.sin(pixel_zenith) * np.sin(pixel_azimuth)], axis=-1)
    off = np.max(np.abs(picture - expected), axis=-1)
    # the last two pixels are drawn as at 89 degrees
    assert np.max(off[pixel_zenith < np.radians(88.0)]) < 0.02 and np.max(off[inside]) < 0.03
    assert np.all(np.isnan(picture[~inside]))


def test_a_bright_horizon_has_no_beads():
    """The rim of a clear sky from 343 directions is within 3 % of the truth, rms in a ring."""
    directions = hemisphere(343)
    zenith, azimuth = np.asarray(directions.zenith, float), np.asarray(directions.azimuth, float)

    def truth(zenith):
        mass = 1.0 / (np.maximum(np.cos(zenith), 0.0) + 0.025)
        return np.log(-np.expm1(-0.25 * mass) * np.exp(-0.02 * mass))

    pixel_zenith, _, _ = pixels()
    off = interpolated(zenith, azimuth, truth(zenith)[:, None])[..., 0] - truth(pixel_zenith)
    for low, high, limit in ((0.0, 80.0, 0.01), (80.0, 86.0, 0.02), (86.0, 88.0, 0.03)):
        ring = (pixel_zenith >= np.radians(low)) & (pixel_zenith < np.radians(high))
        assert np.std(off[ring]) < limit
