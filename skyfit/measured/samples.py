"""Measured sky: samples of spectral radiance over time, direction and wavelength, on the host."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from .possible import check_shapes, check_values, extremes, STATION_RANGES
from .response import LineShape, Response, Seen


# optional quantities of each time and wavelength
BEAM = "direct_irradiance", "direct_sigma", "aerosol_optical_depth", "aerosol_optical_depth_sigma"
# optional quantities of each sample
DEGREE = "degree_of_polarisation", "degree_of_polarisation_sigma"
_MOVING_VIEWS = "view_zenith_by_wavelength", "view_azimuth_by_wavelength"


@dataclass(frozen=True, eq=False)
class Sky:
    """Measured spectral radiance of the sky with the mask of the samples that can be used.

    **Arguments** (NumPy, float64; nothing here is traced by JAX)

    - `radiance`: W m^-2 sr^-1 nm^-1, [time, direction, wavelength], NaN where missing
    - `sigma`: standard deviation of `radiance`, same unit and shape, or None
    - `usable`: bool, same shape; False where missing, negative, saturated or suspect
    - `view_zenith`, `view_azimuth`: rad, azimuth clockwise from north; given as [direction], the same at all times, or
      as [time, direction]; held as the latter; both NaN past the end of a shorter scan
    - `view_zenith_by_wavelength`, `view_azimuth_by_wavelength`: the views of each wavelength, rad,
      [time, direction, wavelength], if the instrument follows the sun between them (a filter wheel); `view_zenith` and
      `view_azimuth` are then about their means. None if all wavelengths have the same views
    - `wavelength_nm`: nm, [wavelength], increasing; with a `response` the labels of its channels, in their order
    - `sun_zenith`, `sun_azimuth`: rad, in the frame of `view_azimuth`, [time], or [time, wavelength] if the sun has
      moved between the wavelengths (a filter wheel takes its time); `sun_at` gives the mean
    - `time`: datetime64, UTC, [time]; NaT where unknown
    - `latitude_deg`, `longitude_deg`, `altitude_m`, `pressure_pa`: the station, NaN if unknown
    - `ozone_du`: the column of ozone over the station; `sun_distance_au`: distance of the sun, used in preference to
      that by the date; NaN if unknown
    - `made_by`: what made a simulated sky, as names and numbers that JSON holds; empty for a measured sky
    - `fwhm_nm`: full width at half maximum of the instrument's Gaussian line shape, nm, or NaN
    - `response`: the channels that replace wavelengths, so that `radiance` holds their readings; or None
    - `direct_irradiance`, `direct_sigma`: irradiance of the sun's beam on a plane normal to it, W m^-2 nm^-1,
      [time, wavelength], NaN where missing; None if it was not measured
    - `aerosol_optical_depth`, `aerosol_optical_depth_sigma`: optical depth of the vertical column at each wavelength,
      as photometers derive it from that beam without air and gases, [time, wavelength], NaN where missing; or None
    - `degree_of_polarisation`, `degree_of_polarisation_sigma`: degree of linear polarisation of each sample's light, in
      [0, 1], [time, direction, wavelength], NaN where missing; or None
    - `instrument`: the instrument in words; may be empty
    - `follows_sun`: whether the instrument finds the sun by itself, and so knows where it looks; views that move
      between the wavelengths imply this
    - `calibration_sigma`: relative standard deviation of the scale of each wavelength, which all times share; NaN if
      unknown. If it is given, `sigma` is that of the noise alone
    - `masked`: reason -> count of samples that it makes unusable; `reason`: index of each sample's reason among these,
      -1 for none, with which each time can be counted by itself; None if not known
    - `notes`: what a user of the samples should know
    - `source`: file name

    **Returns** the sky, whose arrays agree in shape; otherwise `ValueError`.

    **Valid** zenith angles in [0, pi]; a direction that is NaN or below the horizon must not be usable.

    **Example:**

        >>> view = skyfit.hemisphere(3)
        >>> sky = skyfit.Sky(
        ...     radiance=np.full((1, 3, 2), 0.1),
        ...     sigma=None,
        ...     usable=np.full((1, 3, 2), True),
        ...     view_zenith=np.asarray(view.zenith),
        ...     view_azimuth=np.asarray(view.azimuth),
        ...     wavelength_nm=np.array([450.0, 550.0]),
        ...     sun_zenith=np.array([0.9]),
        ...     sun_azimuth=np.array([3.1]),
        ...     time=np.array(["2025-06-01T12:00"], "datetime64[ns]"),
        ... )
        >>> sky.counts()
        {'samples': 6, 'usable': 6}
    """

    # Shapes are checked below, in words that a reader of files can pass on.
    radiance: np.ndarray
    sigma: np.ndarray | None
    usable: np.ndarray
    view_zenith: np.ndarray
    view_azimuth: np.ndarray
    wavelength_nm: np.ndarray
    sun_zenith: np.ndarray
    sun_azimuth: np.ndarray
    time: np.ndarray
    latitude_deg: float = float("nan")
    longitude_deg: float = float("nan")
    altitude_m: float = float("nan")
    pressure_pa: float = float("nan")
    fwhm_nm: float = float("nan")
    ozone_du: float = float("nan")
    sun_distance_au: float = float("nan")
    calibration_sigma: float = float("nan")
    made_by: dict = field(default_factory=dict)
    response: Response | None = None
    direct_irradiance: np.ndarray | None = None
    direct_sigma: np.ndarray | None = None
    aerosol_optical_depth: np.ndarray | None = None
    aerosol_optical_depth_sigma: np.ndarray | None = None
    degree_of_polarisation: np.ndarray | None = None
    degree_of_polarisation_sigma: np.ndarray | None = None
    view_zenith_by_wavelength: np.ndarray | None = None
    view_azimuth_by_wavelength: np.ndarray | None = None
    masked: dict[str, int] = field(default_factory=dict)
    reason: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    instrument: str = ""
    follows_sun: bool = False
    source: str = ""

    def __post_init__(self):
        optional = ("sigma", *BEAM, *DEGREE, *_MOVING_VIEWS)
        angles = ("view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth")
        for name in ("radiance", "wavelength_nm", *angles, *optional):
            value = getattr(self, name)
            if value is None and name in optional:
                continue
            try:
                value = np.asarray(value, dtype=np.float64)
            except (TypeError, ValueError):
                raise ValueError(f"`{name}` must be an array of numbers") from None
            object.__setattr__(self, name, value)
        usable = np.asarray(self.usable)
        if usable.dtype != np.bool_:
            raise ValueError(f"`usable` must be bool, got {usable.dtype}")
        object.__setattr__(self, "usable", usable)
        try:
            time = np.asarray(self.time).astype("datetime64[ns]")
        except (TypeError, ValueError):
            raise ValueError("`time` must be an array of datetime64 (UTC)") from None
        object.__setattr__(self, "time", time)
        for name in (*STATION_RANGES, "calibration_sigma"):
            object.__setattr__(self, name, float(getattr(self, name)))
        object.__setattr__(self, "notes", tuple(self.notes))
        object.__setattr__(self, "follows_sun", self.follows_sun or self.view_zenith_by_wavelength is not None)
        for name in ("view_zenith", "view_azimuth"):
            value = getattr(self, name)
            if value.ndim == 1 and value.shape == self.radiance.shape[1:2]:
                # no copy: a long series of one pattern holds it once
                object.__setattr__(self, name, np.broadcast_to(value, self.radiance.shape[:2]))
        self._hold_sun()
        check_shapes(self)
        check_values(self)

    def _hold_sun(self):
        """Hold both of the sun's angles with an axis of wavelength if one of them varies along it, else without."""
        angles = self.sun_zenith, self.sun_azimuth
        grid = self.radiance.shape[::2]
        # `check_shapes` refuses any other shape
        if not any(angle.shape == grid for angle in angles) or any(angle.shape[:1] != grid[:1] for angle in angles):
            return
        angles = [angle[:, None] if angle.ndim == 1 else angle for angle in angles]
        still = all(np.array_equal(angle, np.broadcast_to(angle[:, :1], angle.shape)) for angle in angles)
        for name, angle in zip(("sun_zenith", "sun_azimuth"), angles, strict=True):
            held = angle[:, 0] if still else np.broadcast_to(angle, grid) if angle.shape[1] == 1 else angle
            object.__setattr__(self, name, held)

    @property
    def seen(self) -> Seen:
        """How the instrument sees a spectrum: through its response's channels, or a line shape at each wavelength."""
        return LineShape(self.fwhm_nm) if self.response is None else self.response

    def with_response(self, response: Response | None) -> "Sky":
        """The sky with its samples as readings of a response; `invert` and others take their `response` this way.

        **Arguments** `response`: None keeps the sky's own. If the sky has none, or only that of its unit (luminance),
        the channels are put in the order of the sky's wavelengths by their mean wavelengths.

        **Valid** a response other than the sky's own, another number of channels, or a line shape besides is a
        `ValueError`.
        """
        if response is None:
            return self
        if self.response is None or self.response.by_unit:
            if len(response.weight) == len(self.wavelength_nm):
                response = response.take(np.argsort(response.centre_nm, kind="stable"))
            return replace(self, response=response)
        if not response.same_as(self.response):
            raise ValueError(
                "`response` must be left out or the sky's own, whose channels are "
                f"{', '.join(self.response.names)}, got others: {', '.join(response.names)}"
            )
        return self

    @property
    def views(self) -> tuple[np.ndarray, np.ndarray]:
        """Zenith angles and azimuths of each sample's view: [time, direction], or [time, direction, wavelength]."""
        if self.view_zenith_by_wavelength is None or self.view_azimuth_by_wavelength is None:
            return self.view_zenith, self.view_azimuth
        return self.view_zenith_by_wavelength, self.view_azimuth_by_wavelength

    @property
    def one_pattern(self) -> bool:
        """Whether all times have the same views."""
        views = self.views
        return all(np.array_equal(view, np.broadcast_to(view[:1], view.shape), equal_nan=True) for view in views)

    def sun_at(self, time: int) -> tuple[float, float]:
        """Zenith angle and azimuth of the sun at a time, rad; the mean over wavelengths if these differ."""
        zenith, azimuth = self.sun_zenith[time], self.sun_azimuth[time]
        if zenith.ndim == 0:
            return float(zenith), float(azimuth)
        # azimuths may lie on both sides of north
        turned = np.mean(np.remainder(azimuth - azimuth[0] + np.pi, 2.0 * np.pi) - np.pi)
        return float(np.mean(zenith)), float(azimuth[0] + turned)

    def counts(self) -> dict[str, int]:
        """How many samples there are, how many are usable, and how many each reason masked.

        **Returns** `{"samples": n, "usable": n, reason: n, ...}`.
        """
        return {
            "samples": int(self.usable.size),
            "usable": int(np.count_nonzero(self.usable)),
            **self.masked,
        }

    def at(self, index: int) -> "Sky":
        """The sky at one time, still with a time axis of length 1.

        **Arguments** `index`: which time; negative counts from the end.

        **Returns** a `Sky`; `masked` is counted anew, as "suspect" where neither `reason` nor the samples show why.
        """
        times = len(self.time)
        if not -times <= index < times:
            raise ValueError(f"`index` must be in [{-times}, {times}), got {index}")
        return self.at_times([index % times])

    def at_times(self, indices: Sequence[int] | np.ndarray) -> "Sky":
        """Some of the times, in the order of `indices`; `masked` as `at` says."""
        part = np.asarray(indices, int)
        along = ("radiance", "sigma", "usable", "view_zenith", "view_azimuth", "sun_zenith", "sun_azimuth", "time")
        along += (*BEAM, *DEGREE, *_MOVING_VIEWS)
        held = {name: getattr(self, name) for name in along}
        parts = {name: None if value is None else value[part] for name, value in held.items()}
        usable = self.usable[part]
        if np.array_equal(part, np.arange(len(self.time))):
            return self
        if self.reason is None or self.reason.shape != self.usable.shape:
            masked = _recount(parts["radiance"], parts["usable"], parts["view_zenith"])
            return replace(self, **parts, masked=masked, reason=None)
        # indices among the reasons that are left; samples masked since have none
        own, counts, reason = self.reason[part], {}, np.full(usable.shape, -1)
        for place, name in enumerate(self.masked):
            where = ~usable & (own == place)
            if where.any():
                reason[where] = len(counts)
                counts[name] = int(where.sum())
        since = ~usable & (reason < 0)
        if since.any():
            counts["suspect"] = counts.get("suspect", 0) + int(since.sum())
            reason[since] = list(counts).index("suspect")
        return replace(self, **parts, masked=counts, reason=reason)

    def select(self, wavelength_nm: Float[np.ndarray, " wavelength"]) -> "Sky":
        """The sky at other wavelengths, linearly interpolated between the samples' own.

        L(w) = L_i + (w - w_i) / (w_{i+1} - w_i) (L_{i+1} - L_i), and sigma likewise

        **Arguments** `wavelength_nm`: nm, increasing, inside the range of the sky's own.

        **Returns** a `Sky`; a sample is usable only if both its neighbours are. sigma is that of
        fully correlated neighbours, the cautious choice. A sun that moves between wavelengths is
        interpolated too. `masked` is counted anew.

        **Valid** inside the range; outside it, `ValueError`. A sky with a `response` gives only its channels, in any
        order.
        """
        wanted = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
        own = self.wavelength_nm
        if self.response is not None:
            return self._channels(self.response, wanted)
        if wanted.ndim != 1 or not np.all((wanted >= own[0]) & (wanted <= own[-1])):
            raise ValueError(f"`wavelength_nm` must lie in [{own[0]:g}, {own[-1]:g}] nm, got {extremes(wanted)}")
        below = np.searchsorted(own, wanted, side="right") - 1
        above = np.minimum(below + 1, len(own) - 1)
        # A wavelength that is hit exactly has one neighbour: itself.
        above = np.where(own[below] == wanted, below, above)
        gap = np.where(above == below, 1.0, own[above] - own[below])
        weight = (wanted - own[below]) / gap

        def interpolate(values, turns=False):
            step = values[..., above] - values[..., below]
            # an azimuth goes the shorter way round
            step = np.remainder(step + np.pi, 2.0 * np.pi) - np.pi if turns else step
            return values[..., below] + weight * step

        moves = self.sun_zenith.ndim > 1

        radiance = interpolate(self.radiance)
        usable = self.usable[..., below] & self.usable[..., above]
        return replace(
            self,
            radiance=radiance,
            sigma=None if self.sigma is None else interpolate(self.sigma),
            usable=usable,
            wavelength_nm=wanted,
            sun_zenith=interpolate(self.sun_zenith) if moves else self.sun_zenith,
            sun_azimuth=interpolate(self.sun_azimuth, turns=True) if moves else self.sun_azimuth,
            masked=_recount(radiance, usable, self.view_zenith),
            reason=None,
            **{
                name: None if values is None else interpolate(values, turns="azimuth" in name)
                for name in (*BEAM, *DEGREE, *_MOVING_VIEWS)
                for values in (getattr(self, name),)
            },
        )

    def _channels(self, response: Response, wanted):
        own = self.wavelength_nm
        places = [int(np.argmin(np.abs(own - one))) for one in wanted.ravel()]
        if wanted.ndim != 1 or not np.array_equal(own[places], wanted) or len(set(places)) < len(places):
            raise ValueError(
                f"`wavelength_nm` must name channels once each, of {', '.join(f'{w:g}' for w in own)} nm, got "
                f"{extremes(wanted)}"
            )
        parts = {
            name: value if value is None else value[..., places]
            for name in ("radiance", "sigma", "usable", "wavelength_nm", *BEAM, *DEGREE)
            for value in (getattr(self, name),)
        }
        if self.sun_zenith.ndim > 1:
            parts |= {"sun_zenith": self.sun_zenith[:, places], "sun_azimuth": self.sun_azimuth[:, places]}
        masked = _recount(parts["radiance"], parts["usable"], self.view_zenith)
        return replace(self, **parts, response=response.take(places), masked=masked, reason=None)


def _recount(radiance, usable, view_zenith):
    left = ~usable
    reasons = {
        "missing": ~np.isfinite(radiance),
        "negative": radiance < 0.0,
        "below horizon": np.broadcast_to((view_zenith > 0.5 * np.pi)[..., None], usable.shape),
        "suspect": left,
    }
    counted = {}
    for reason, where in reasons.items():
        count = int(np.count_nonzero(left & where))
        if count:
            counted[reason] = count
        left = left & ~where
    return counted


def time_names(sky: Sky) -> tuple[str, ...]:
    """Each time of a sky as text, ISO in UTC, or its index where the time is not known."""
    return tuple(f"time {i}" if np.isnat(t) else str(t.astype("datetime64[s]")) + "Z" for i, t in enumerate(sky.time))
