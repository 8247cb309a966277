"""Convert a measured sky to the arrays that a fit takes, and read a model at each sample."""

import numpy as np

from ..light.solar import SPECTRUM_NM
from ..measured import LineShape, NoiseModel, Response, Seen, Sky, sun_factor
from ..measured.quality.line_shape import estimate_fwhm
from ..numerics import as_float
from ..programs import kept
from ..transport import AbstractSolver
from .forward import observe, Problem
from .model import SkyModel


# bands in nm of absorption by oxygen and water that the model leaves out (Bird & Riordan 1986, table 1)
GAS_BANDS_NM = ((684.0, 700.0), (714.0, 742.0), (756.0, 774.0), (785.0, 850.0), (890.0, 1000.0))
_MOST_WAVELENGTHS = 40
# how many lengths the list of directions can have
_SIZES = 4
# default relative sigma of a direct beam, and default sigma of the haze's optical depth: AERONET's field instruments
# have 0.01 to 0.02 under an overhead sun (Giles et al. 2019, Atmos. Meas. Tech. 12, 169)
_DIRECT_NOISE, _DEPTH_NOISE = 0.02, 0.01
# default sigma of a degree of polarisation (Li et al. 2018, J. Quant. Spectrosc. Radiat. Transf. 218, 74:
# better than 0.01 for CE318-DP photometers)
_DEGREE_NOISE = 0.01


class Sampling:
    """The samples of a sky that are fitted, and the scenes at any of its wavelengths, on the host."""

    def __init__(self, sky: Sky, fwhm_nm: float | None, field_of_view: float = 0.0):
        self.sky, self.field_of_view = sky, field_of_view
        self.notes = list(sky.notes)
        self.seen = _seen(sky, fwhm_nm, self.notes)
        spectrum = self.seen.spectrum(sky.wavelength_nm)
        inside = (spectrum >= SPECTRUM_NM[0]) & (spectrum <= SPECTRUM_NM[1])
        self.inside = np.flatnonzero(inside)
        self.spectrum = spectrum
        self.irradiance = np.full(spectrum.shape, np.nan)
        self.irradiance[inside] = self.seen.sunlight(spectrum[inside])
        self.used = self._usable()
        self.sun_factor = sun_factor(sky)[0]
        if sky.aerosol_optical_depth is not None and sky.direct_irradiance is not None:
            self.notes.append("direct irradiance not used beside the optical depths of the same beam")

    @property
    def response(self) -> Response | None:
        """The measured channels, None if the samples are at wavelengths."""
        return self.sky.response

    @property
    def fwhm_nm(self) -> float:
        """Full width at half maximum of the line shape in use, NaN for none."""
        return self.seen.fwhm_nm if isinstance(self.seen, LineShape) else float("nan")

    def _usable(self) -> np.ndarray:
        """The sky's mask without samples that the model cannot explain, which the notes count."""
        sky = self.sky
        if self.response is not None:
            return sky.usable
        wavelength = sky.wavelength_nm
        outside = (wavelength < SPECTRUM_NM[0]) | (wavelength > SPECTRUM_NM[1])
        bands = np.zeros_like(outside)
        for low, high in GAS_BANDS_NM:
            bands |= (wavelength >= low) & (wavelength <= high)
        for where, reason in ((outside, "beyond 300-1100 nm"), (bands & ~outside, "in gas bands")):
            count = int(sky.usable[..., where].sum())
            if count:
                self.notes.append(f"{count} samples {reason} left out")
        return sky.usable & ~(outside | bands)

    def chosen(self) -> np.ndarray:
        """Indices of the sky's wavelengths that are fitted: all that hold samples, or evenly chosen ones if many."""
        candidates = np.flatnonzero(self.used.any(axis=(0, 1)))
        if candidates.size <= _MOST_WAVELENGTHS:
            return candidates
        return candidates[np.linspace(0, candidates.size - 1, _MOST_WAVELENGTHS).round().astype(int)]

    def problem(self, chosen: np.ndarray, measurement: NoiseModel) -> tuple[Problem, np.ndarray]:
        """The samples at the chosen wavelengths, and the directions of each time that have any, `[time, direction]`.

        Unused directions are left out in steps of a quarter of all directions, so that skies with other masks rarely
        have another shape to compile for. Shorter lists are filled up by repeating their directions, without weight.
        """
        sky, used = self.sky, self.used
        sigma = measurement.sigma(sky, used)
        held = np.asarray(np.any(used[:, :, chosen], axis=2))
        quarter = -(-held.shape[1] // _SIZES)
        most = min(held.shape[1], quarter * max(1, -(-int(held.sum(axis=1).max()) // quarter)))
        places = np.stack([np.resize(np.flatnonzero(h) if h.any() else [0], most) for h in held])
        first = np.arange(most)[None] < held.sum(axis=1)[:, None]
        rows = np.arange(len(sky.time))[:, None]
        mask = used[rows, places][..., chosen] & first[..., None]
        measured = np.where(mask, sky.radiance[rows, places][..., chosen], 0.0)
        weight = np.where(mask, 1.0 / sigma[rows, places][..., chosen], 0.0)
        beam, degree = self._direct(chosen), self._degree(rows, places, chosen, mask)
        parts = [part for part in (beam, degree) if part is not None]
        values, weights = (
            (as_float(np.concatenate(p, axis=1)) for p in zip(*parts, strict=True)) if parts else (None,) * 2
        )
        arrays = self._arrays(slice(None), chosen)
        problem = Problem(
            **arrays,
            **self._views(rows, places, chosen),
            measured=as_float(measured),
            weight=as_float(weight),
            beside=values,
            beside_weight=weights,
            has_beam=beam is not None,
            has_degree=degree is not None,
            field_of_view=self.field_of_view,
            direct_is_depth=sky.aerosol_optical_depth is not None,
        )
        return problem, places

    def _views(self, times, directions, channels) -> dict:
        """Views of some times, at some of the sky's wavelengths where the instrument moves between them."""
        views = self.sky.views
        views = views if views[0].ndim == 2 else tuple(view[..., channels] for view in views)
        return {
            name: as_float(np.nan_to_num(view[times, directions]))
            for name, view in zip(("view_zenith", "view_azimuth"), views, strict=True)
        }

    def _direct(self, chosen):
        """The direct beam at the chosen wavelengths and one over its sigma, None where there is none."""
        sky = self.sky
        if self.response is not None:
            return None
        values, sigma = sky.aerosol_optical_depth, sky.aerosol_optical_depth_sigma
        # the optical depth depends neither on the instrument's scale nor on the air mass
        if values is not None:
            sigma = np.full(values.shape, _DEPTH_NOISE) if sigma is None else sigma
            good = np.isfinite(values)
        elif sky.direct_irradiance is not None:
            values, sigma = sky.direct_irradiance, sky.direct_sigma
            sigma = _DIRECT_NOISE * np.abs(values) if sigma is None else sigma
            good = np.isfinite(values) & (values > 0.0)
        else:
            return None
        values, sigma, good = values[:, chosen], sigma[:, chosen], good[:, chosen]
        good &= np.isfinite(sigma) & (sigma > 0.0)
        if not good.any():
            return None
        return _weighed(good, values, sigma)

    def _degree(self, times, directions, chosen, mask):
        """Degrees of polarisation in one row for each time, and one over their sigma; None where there are none."""
        degree, sigma = self.sky.degree_of_polarisation, self.sky.degree_of_polarisation_sigma
        if degree is None:
            return None
        sigma = np.full(degree.shape, _DEGREE_NOISE) if sigma is None else sigma
        degree, sigma = (values[times, directions][..., chosen] for values in (degree, sigma))
        good = mask & np.isfinite(degree) & np.isfinite(sigma) & (sigma > 0.0)
        rows = (values.reshape(len(values), -1) for values in (good, degree, sigma))
        return _weighed(*rows) if good.any() else None

    def _arrays(self, times, channels) -> dict:
        """Suns and spectra of some times, at some of the sky's wavelengths, or for some channels of its response."""
        sky = self.sky
        wavelengths = channels if self.response is None else self.inside
        suns = sky.sun_zenith, sky.sun_azimuth
        if sky.view_zenith_by_wavelength is not None and suns[0].ndim == 1:
            # each wavelength's view has its own sun
            suns = (np.repeat(v[:, None], len(sky.wavelength_nm), axis=1) for v in suns)
        suns = [as_float(v[times] if v.ndim == 1 else v[times][:, channels]) for v in suns]
        count = len(sky.time[times])
        factor = self.sun_factor[times]
        weight = self.seen.weight
        weight = None if weight is None else weight[np.ix_(channels, wavelengths)]
        return {
            "sun_zenith": suns[0],
            "sun_azimuth": suns[1],
            "irradiance": as_float(factor[:, None] * self.irradiance[wavelengths][None]),
            "wavelength_nm": as_float(np.broadcast_to(self.spectrum[wavelengths], (count, len(wavelengths)))),
            "response": None if weight is None else as_float(np.broadcast_to(weight, (count, *weight.shape))),
        }

    def readings(self, solver: AbstractSolver, model: SkyModel, time: int) -> np.ndarray:
        """Read the model in every direction at each wavelength or channel, `[direction, wavelength]`; NaN beyond it."""
        sky = self.sky
        # all channels of a response, or the wavelengths that the solar spectrum covers
        places = self.inside if self.response is None else np.arange(sky.radiance.shape[2])
        nothing = np.zeros((1, sky.radiance.shape[1], places.size))
        problem = Problem(
            **self._arrays(slice(time, time + 1), places),
            # for directions that this time lacks, any view will do
            **self._views(slice(time, time + 1), slice(None), places),
            measured=as_float(nothing),
            weight=as_float(nothing),
            field_of_view=self.field_of_view,
        )
        result = np.full(sky.radiance.shape[1:], np.nan)
        result[:, places] = np.asarray(_read(solver, model, problem.at(0)))
        result[np.isnan(sky.view_zenith[time])] = np.nan
        return result


def _weighed(good, values, sigma) -> tuple[np.ndarray, np.ndarray]:
    """Values and one over their sigma, 0 where they are not good."""
    return np.where(good, values, 0.0), np.where(good, 1.0 / np.where(good, sigma, 1.0), 0.0)


def _reading(solver, model, one: Problem):
    return observe(solver, model, one).radiance


# runs once or twice: XLA's further passes take more time than they save
_read = kept(_reading, lambda *_: 0, compiler_options={"xla_backend_optimization_level": 1})


def scale_at(wavelength_nm: np.ndarray, fitted_nm: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """Interpolate the instrument's scale from the fitted wavelengths to others; channels go by their nominal ones."""
    order = np.argsort(fitted_nm)
    return np.interp(wavelength_nm, fitted_nm[order], calibration[order])


def _seen(sky: Sky, fwhm_nm: float | None, notes: list[str]) -> Seen:
    """How the instrument sees: the sky's response; else the line shape given, the sky's, or that of the solar lines."""
    if sky.response is not None:
        if fwhm_nm is not None and np.isfinite(fwhm_nm):
            raise ValueError(
                f"`fwhm_nm` must be left out with a `response`, which says how the instrument sees, got {fwhm_nm:g}"
            )
        return sky.seen
    if fwhm_nm is not None:
        return LineShape(float(fwhm_nm))
    if np.isfinite(sky.fwhm_nm):
        return sky.seen
    width = estimate_fwhm(sky)
    if np.isfinite(width):
        notes.append(f"line shape estimated from the solar lines: {width:g} nm FWHM")
    else:
        notes.append("no line shape in the file and too few wavelengths to estimate it: none applied")
    return LineShape(width)
