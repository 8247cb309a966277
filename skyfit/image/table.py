"""A table of the light around an observer, interpolated between directions."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# Numbers of nodes: zenith angle above and below the horizon, and azimuth from the sun
_ABOVE, _BELOW, _AROUND = 128, 64, 96
# Share of the nodes concentrated at each of sun and horizon, and the distances, rad, within which the concentration
# stops growing: from eye height the last kilometres of the ground lie within a hundredth of a degree
_CROWD, _NEAR_SUN, _NEAR_HORIZON = 0.3, np.radians(0.2), np.radians(0.001)
# Distance of the nearest nodes from the horizon, rad; a view exactly at the horizon belongs to neither side
_EDGE = 1e-6
_DARK = 1e-20


class _Side(NamedTuple):
    """One side of the horizon: nodes of zenith angle and azimuth, and spline coefficients of the log light."""

    zenith: Float[np.ndarray, " zenith"]
    azimuth: Float[np.ndarray, " azimuth"]
    spline: Float[np.ndarray, "channel zenith azimuth"]


class LightTable:
    """X, Y, Z or a spectrum in all directions, by cubic splines of their logarithm through a grid of directions.

    The light is symmetric about the sun's meridian. Nodes are dense near the sun and near the horizon, which lies at
    the zenith angle `horizon` and where the light is discontinuous. The light is 0 above the zenith angle `air`, the
    edge of the air seen from space, and below the horizon if `below` is False.
    """

    def __init__(
        self,
        light: Callable[[np.ndarray, np.ndarray], Float[np.ndarray, "view channel"]],
        sun_zenith: float,
        air: float,
        horizon: float,
        below: bool,
    ):
        from scipy.ndimage import spline_filter

        azimuth = _nodes(0.0, np.pi, {0.0: _NEAR_SUN}, _AROUND)
        ends = [(air, horizon - _EDGE, _ABOVE), (horizon + _EDGE, np.pi, _BELOW)][: 2 if below else 1]
        crowds = {horizon: _NEAR_HORIZON, sun_zenith: _NEAR_SUN}
        zeniths = [_nodes(low, high, crowds, count) for low, high, count in ends]
        every = np.meshgrid(np.concatenate(zeniths), azimuth, indexing="ij")
        found = np.maximum(light(*(v.ravel() for v in every)), _DARK)
        self.channels = found.shape[-1]
        found = found.reshape(*every[0].shape, self.channels)
        parts = np.split(np.log(found), [zeniths[0].size])
        self.air, self.horizon = air, horizon
        self.sides = [
            _Side(zenith, azimuth, np.stack([spline_filter(part[..., k], mode="mirror") for k in range(self.channels)]))
            for zenith, part in zip(zeniths, parts, strict=False)
        ]

    def at(self, zenith: Float[np.ndarray, " view"], azimuth: Float[np.ndarray, " view"]) -> np.ndarray:
        """The light `[view, channel]`, 0 outside the table; `azimuth` from the sun, rad."""
        from scipy.ndimage import map_coordinates

        turn = np.abs((azimuth + np.pi) % (2.0 * np.pi) - np.pi)
        found = np.zeros((zenith.size, self.channels), np.float32)
        for side, here in zip(
            self.sides, ((zenith >= self.air) & (zenith < self.horizon), zenith >= self.horizon), strict=False
        ):
            place = [
                np.interp(v[here], nodes, np.arange(nodes.size))
                for v, nodes in ((zenith, side.zenith), (turn, side.azimuth))
            ]
            for k in range(self.channels):
                log = map_coordinates(side.spline[k], place, order=3, mode="mirror", prefilter=False)
                found[here, k] = np.exp(log)
        return found


def _nodes(low: float, high: float, crowds: dict[float, float], count: int) -> Float[np.ndarray, " node"]:
    """Nodes from `low` to `high`; near each place in `crowds` their density varies as 1 / (distance + given size)."""
    beside = [place + side * np.geomspace(1e-6, np.pi, 4001) for place in crowds for side in (-1.0, 1.0)]
    fine = np.unique(np.clip(np.concatenate([np.linspace(low, high, 8001), *beside]), low, high))
    density = np.full(fine.size, (1.0 - _CROWD * len(crowds)) / (high - low))
    for place, size in crowds.items():
        near = 1.0 / (np.abs(fine - place) + size)
        density += _CROWD * near / np.trapezoid(near, fine)
    grown = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    return np.interp(np.linspace(0.0, grown[-1], count), grown, fine)
