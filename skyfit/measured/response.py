"""How an instrument sees a spectrum: its wavelengths, the sun's light at them, and each channel's reading."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..light import extraterrestrial_irradiance, observer_weights, SRGB_FROM_XYZ
from ..numerics import check_range, check_wavelength


@dataclass(frozen=True)
class LineShape:
    """Wavelengths that are each seen through a Gaussian line, or without one if the width is NaN or 0 nm.

    Sunlight is convolved with the line. The model, which is smooth where the sun's lines are not, is taken at the
    line's centre.
    """

    fwhm_nm: float
    weight: None = None

    def spectrum(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """The wavelengths at which the model is solved: the sky's own."""
        return wavelength_nm

    def sunlight(self, spectrum_nm: np.ndarray) -> np.ndarray:
        """The sun's irradiance through the line, W m^-2 nm^-1."""
        width = self.fwhm_nm if np.isfinite(self.fwhm_nm) and self.fwhm_nm > 0.0 else None
        return np.asarray(extraterrestrial_irradiance(spectrum_nm, width), float)


@dataclass(frozen=True, eq=False)
class Response:
    """The spectral response of the channels of a camera or photometer.

    `wavelength_nm` `[spectrum]`, increasing and fine enough for a sum over them; `weight` `[channel, spectrum]`:
    a channel's value is the sum of weight times spectral radiance (the weight includes the width of a band);
    `names` of the channels, by default their mean wavelengths. A sky that has this as its `response` has an axis of
    these channels in this order in place of wavelengths. `by_unit`: the response follows from the unit of the readings
    alone, so that one that says more about the instrument may replace it (`Sky.with_response`).

    **Example:**

        >>> eye = skyfit.Response.xyz()
        >>> eye.names, eye.weight.shape[0]
        (('X', 'Y', 'Z'), 3)
    """

    wavelength_nm: np.ndarray
    weight: np.ndarray
    names: tuple[str, ...] = ()
    by_unit: bool = False

    def __post_init__(self):
        wavelength = np.atleast_1d(np.asarray(self.wavelength_nm, float))
        weight = np.atleast_2d(np.asarray(self.weight, float))
        if weight.shape[1:] != wavelength.shape or not np.all(np.diff(wavelength) > 0.0):
            raise ValueError(
                "`weight` must be [channel, wavelength] and `wavelength_nm` increase, got shapes "
                f"{weight.shape} and {wavelength.shape}"
            )
        check_wavelength(wavelength, 300.0, 1100.0, "of the sun's spectrum")
        check_range("weight", weight, -1e30, 1e30)
        if not np.all(np.any(weight != 0.0, axis=1)):
            raise ValueError("`weight` must not be 0 everywhere in a channel")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "weight", weight)
        names = tuple(map(str, self.names)) or tuple(f"{centre:.4g} nm" for centre in self.centre_nm)
        if len(names) != len(weight):
            raise ValueError(f"`names` must hold one for each of {len(weight)} channels, got {', '.join(names)}")
        object.__setattr__(self, "names", names)

    @property
    def centre_nm(self) -> np.ndarray:
        """The mean wavelength of each channel, nm: the `wavelength_nm` to give a sky, in this order."""
        size = np.abs(self.weight)
        return size @ self.wavelength_nm / np.sum(size, axis=1)

    def spectrum(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """The wavelengths at which the model is solved: the response's own, not those that label the channels."""
        return self.wavelength_nm

    def sunlight(self, spectrum_nm: np.ndarray) -> np.ndarray:
        """The sun's irradiance without a line shape, W m^-2 nm^-1."""
        return np.asarray(extraterrestrial_irradiance(spectrum_nm), float)

    def take(self, channels: Sequence[int] | np.ndarray) -> "Response":
        """Some of the channels, in the given order."""
        names = tuple(self.names[channel] for channel in channels)
        return Response(self.wavelength_nm, self.weight[np.asarray(channels, int)], names, self.by_unit)

    def same_as(self, other: "Response | None") -> bool:
        """Whether another response has the same wavelengths and weights; names may differ."""
        pairs = () if other is None else ((self.wavelength_nm, other.wavelength_nm), (self.weight, other.weight))
        # equal within the rounding of files
        return other is not None and all(a.shape == b.shape and np.allclose(a, b, rtol=1e-9) for a, b in pairs)

    @classmethod
    def xyz(cls) -> "Response":
        """CIE 1931 X, Y, Z in cd m^-2; x, y, Y give X = x Y / y, Z = (1 - x - y) Y / y."""
        wavelength = np.arange(380.0, 781.0, 10.0)
        return cls(wavelength, np.asarray(observer_weights(wavelength), float).T, ("X", "Y", "Z"))

    @classmethod
    def eye(cls) -> "Response":
        """Luminance Y in cd m^-2: 683 lm/W times the CIE 1931 observer's y, which follows from the unit alone."""
        eye = cls.xyz().take([1])
        return cls(eye.wavelength_nm, eye.weight, eye.names, by_unit=True)

    @classmethod
    def linear_srgb(cls) -> "Response":
        """Linear sRGB of a calibrated camera in cd m^-2: red, green, blue."""
        wavelength = np.arange(380.0, 781.0, 10.0)
        weights = np.asarray(observer_weights(wavelength), float)
        return cls(wavelength, np.asarray(SRGB_FROM_XYZ, float) @ weights.T, ("R", "G", "B"))


# How an instrument sees a spectrum. Both kinds have `spectrum(wavelength_nm)`, the wavelengths at which the model is
# solved for a sky of these wavelengths; `sunlight(spectrum_nm)`, the sun's irradiance there as the instrument sees it;
# `weight`, with which a channel's reading is a sum over radiances there, None where each wavelength is a channel
Seen = LineShape | Response
