"""Spectral responses: what each channel of an instrument makes of a spectrum."""

from dataclasses import dataclass

import numpy as np

from ..light import observer_weights, SRGB_FROM_XYZ


@dataclass(frozen=True, eq=False)
class Response:
    """Channels of a camera or photometer: what each makes of a spectrum.

    `wavelength_nm` `[wavelength]`, increasing and fine enough for a sum over them; `weight` `[channel, wavelength]`:
    a channel's value is the sum of weight times spectral radiance (so that a width of band is in the weight).
    Channels stand in the order of the sky's `wavelength_nm`, which gives each a place and a label.
    """

    wavelength_nm: np.ndarray
    weight: np.ndarray

    def __post_init__(self):
        wavelength = np.atleast_1d(np.asarray(self.wavelength_nm, float))
        weight = np.atleast_2d(np.asarray(self.weight, float))
        if weight.shape[1:] != wavelength.shape or not np.all(np.diff(wavelength) > 0.0):
            raise ValueError(
                "`weight` must be [channel, wavelength] and `wavelength_nm` increase, got shapes "
                f"{weight.shape} and {wavelength.shape}"
            )
        if not (np.all(np.isfinite(weight)) and np.all((wavelength >= 300.0) & (wavelength <= 1100.0))):
            raise ValueError("`weight` must be finite and `wavelength_nm` within 300-1100 nm")
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "weight", weight)

    @property
    def centre_nm(self) -> np.ndarray:
        """The mean wavelength of each channel, nm: what to give a sky as its `wavelength_nm`, in this order."""
        size = np.abs(self.weight)
        return size @ self.wavelength_nm / np.sum(size, axis=1)

    @classmethod
    def xyz(cls) -> "Response":
        """CIE 1931 Z, Y, X in cd m^-2, by increasing wavelength; x, y, Y give X = x Y / y, Z = (1 - x - y) Y / y."""
        wavelength = np.arange(380.0, 781.0, 10.0)
        return cls(wavelength, np.asarray(observer_weights(wavelength), float).T[::-1])

    @classmethod
    def linear_srgb(cls) -> "Response":
        """Linear sRGB of a calibrated camera in cd m^-2, blue, green, red by increasing wavelength."""
        wavelength = np.arange(380.0, 781.0, 10.0)
        weights = np.asarray(observer_weights(wavelength), float)
        return cls(wavelength, (np.asarray(SRGB_FROM_XYZ, float) @ weights.T)[::-1])
