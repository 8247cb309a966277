"""Curves that bring light of any brightness into the range of a screen."""

import numpy as np
from jaxtyping import Float


# Middle grey, and the stops below and above it that the curve spans: it maps grey to 1/2, and the ends to 0 and 1
_GREY, _BELOW, _ABOVE = 0.18, 10.0, 6.5
# Slope at middle grey, and powers of the curve toward black and toward white
_SLOPE, _TOE, _SHOULDER = 2.0, 3.0, 3.25
# Share by which each channel moves to a mean of all three, with the weights of this mean
_MIXED, _MEAN = 0.2, np.array([0.21200536, 0.39218251, 0.39581214])


def agx(linear: Float[np.ndarray, "row column 3"]) -> Float[np.ndarray, "row column 3"]:
    r"""Encoded sRGB from 0 to 1 by AgX: the channels are mixed, follow a curve in their logarithm, and are unmixed.

    The curve is $\frac12 + s\, d\, (1 + a |d|^p)^{-1/p}$ in the distance d from middle grey, as a share of 16.5 stops;
    a is such that the ends are 0 and 1. As the channels are mixed, light far brighter than white turns white.

    **Arguments:** `linear` sRGB, 0.18 is middle grey; what is negative even in the mixture counts as 0.
    **Source:** Sobotka 2022, AgX (github.com/sobotka/AgX); its closed form: github.com/bWFuanVzYWth/AgX.
    """
    mixed = (1.0 - _MIXED) * linear + _MIXED * (linear @ _MEAN)[..., None]
    stops = np.log2(np.maximum(mixed, 1e-10) / _GREY)
    grey = _BELOW / (_BELOW + _ABOVE)
    away = np.clip((stops + _BELOW) / (_BELOW + _ABOVE), 0.0, 1.0) - grey
    power = np.where(away > 0.0, _SHOULDER, _TOE)
    end = np.where(away > 0.0, 1.0 - grey, grey)
    bend = (2.0 * _SLOPE) ** power - end**-power
    curve = 0.5 + _SLOPE * away * (1.0 + bend * np.abs(away) ** power) ** (-1.0 / power)
    apart = (curve - _MIXED * (curve @ _MEAN)[..., None]) / (1.0 - _MIXED)
    return np.clip(apart, 0.0, 1.0)
