"""Which way each pixel of a picture looks, and how much of the sphere it sees."""

from dataclasses import dataclass
from typing import get_args, Literal

import numpy as np
from jaxtyping import Bool, Float, Real

from ..numerics import check_range


Projection = Literal["equirect", "fisheye", "cube", "perspective"]
# pixels on a side
_LARGEST = 32768.0
# right, up and ahead of each face of a cube, on the axes right, up and ahead of who looks at its fifth
_FACES = np.array([
    [[0, 0, -1], [0, 1, 0], [1, 0, 0]], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[1, 0, 0], [0, 0, 1], [0, -1, 0]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
], float)  # fmt: skip


@dataclass(frozen=True)
class Camera:
    """A picture of `width` by `height` pixels.

    - "equirect": the whole sphere, the zenith as its top row, the azimuth growing to the right.
    - "fisheye": looks up; the angle from the zenith grows linearly with the distance from the middle and is half of
      `field_of_view` at the nearer edges, beyond which nothing is seen. North is up; east is right as on a map, or left
      with `mirrored`, as who lies on his back sees it.
    - "cube": six square faces side by side, in the order and orientation of cube maps (x right, y up, z ahead): right,
      left, up, down, ahead and behind of who looks toward `azimuth`.
    - "perspective": a pinhole that spans `field_of_view` from left to right.

    `azimuth`, clockwise from north, of the middle column, or of a cube's face ahead; `elevation` of the middle of a
    perspective picture; `field_of_view`, by default pi of a fisheye and 70 degrees of a pinhole: radians, all of them.
    **Errors:** `ValueError` for what is out of range.

    **Example:**

        >>> skyfit.Camera("fisheye", 64, 64).views().shape
        (3, 64, 64)
    """

    projection: Projection = "equirect"
    width: int = 1024
    height: int = 512
    azimuth: float = np.pi
    elevation: float = 0.0
    field_of_view: float | None = None
    mirrored: bool = False

    def __post_init__(self):
        if self.projection not in get_args(Projection):
            raise ValueError(f"`projection` must be one of {', '.join(get_args(Projection))}, got {self.projection!r}")
        for name in ("width", "height"):
            check_range(name, getattr(self, name), 1.0, _LARGEST, "pixels")
        if self.projection == "cube" and self.width != 6 * self.height:
            raise ValueError(f"`width` of a cube must be 6 times `height`, got {self.width} and {self.height}")
        if self.mirrored and self.projection in ("equirect", "cube"):
            raise ValueError(f'`mirrored` must be left out with "{self.projection}": its pixels look as it is defined')
        check_range("azimuth", self.azimuth, -4.0 * np.pi, 4.0 * np.pi, "rad")
        check_range("elevation", self.elevation, -0.5 * np.pi, 0.5 * np.pi, "rad")
        pinhole = self.projection == "perspective"
        widest = np.radians(170.0) if pinhole else 2.0 * np.pi
        check_range("field_of_view", self.field_of_view, 1e-4, widest, "rad", self.projection)

    def views(self, first: int = 0, last: int | None = None) -> Float[np.ndarray, "3 row column"]:
        """Unit vectors east, north, up of the pixels of some rows, the top row first; float32."""
        row, column = np.mgrid[first : self.height if last is None else last, : self.width].astype(np.float32) + 0.5
        if self.projection == "equirect":
            zenith, azimuth = np.pi * row / self.height, self.azimuth + 2.0 * np.pi * (column / self.width - 0.5)
            sine = np.sin(zenith)
            return np.stack([sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(zenith)]).astype(np.float32)
        if self.projection == "cube":
            face = self._cube[(column // self.height).astype(int)]
            x, y = 2.0 * (column % self.height) / self.height - 1.0, 1.0 - 2.0 * row / self.height
            views = face[..., 2, :] + face[..., 0, :] * x[..., None] + face[..., 1, :] * y[..., None]
            return np.moveaxis(views / np.linalg.norm(views, axis=-1, keepdims=True), -1, 0).astype(np.float32)
        x, y = column - 0.5 * self.width, 0.5 * self.height - row
        if self.projection == "fisheye":
            angle = self._per_pixel * np.hypot(x, y)
            # numpy's sinc has pi in it
            sine = self._per_pixel * np.sinc(angle / np.pi)
            return np.stack([sine * x * self._east, sine * y, np.cos(angle)]).astype(np.float32)
        right, up, ahead = self._axes
        views = ahead[:, None, None] * self._focal + right[:, None, None] * x + up[:, None, None] * y
        return (views / np.linalg.norm(views, axis=0)).astype(np.float32)

    def solid_angle(self, row: Real[np.ndarray, "*pixel"], column: Real[np.ndarray, "*pixel"]):
        """Of pixels, by the indices of their rows and columns, sr; 0 where nothing is seen."""
        if self.projection == "equirect":
            edge = np.cos(np.pi * np.stack([row, row + 1.0]) / self.height)
            return 2.0 * np.pi / self.width * (edge[0] - edge[1])
        if self.projection == "cube":
            across, down = ((2.0 * (v % self.height) + 1.0) / self.height - 1.0 for v in (column, row))
            return (2.0 / self.height) ** 2 / (1.0 + across**2 + down**2) ** 1.5
        distance = np.hypot(column + 0.5 - 0.5 * self.width, row + 0.5 - 0.5 * self.height)
        if self.projection == "fisheye":
            size = self._per_pixel**2 * np.abs(np.sinc(self._per_pixel * distance / np.pi))
            return np.where(self._per_pixel * distance <= 0.5 * self.across, size, 0.0)
        return self._focal / (self._focal**2 + distance**2) ** 1.5

    def places(
        self, views: Float[np.ndarray, "3 view"]
    ) -> tuple[Float[np.ndarray, " view"], Float[np.ndarray, " view"], Bool[np.ndarray, " view"]]:
        """The rows and columns of the pixels that some views fall on, and whether they are in the picture."""
        east, north, up = views
        seen = np.ones(up.shape, bool)
        if self.projection == "equirect":
            turn = (np.arctan2(east, north) - self.azimuth) / (2.0 * np.pi) + 0.5
            row, column = np.arccos(np.clip(up, -1.0, 1.0)) / np.pi * self.height, (turn % 1.0) * self.width
        elif self.projection == "fisheye":
            flat = np.hypot(east, north)
            angle = np.arctan2(flat, up)
            seen = angle <= 0.5 * self.across
            length = angle / self._per_pixel / np.where(flat > 0.0, flat, 1.0)
            row, column = 0.5 * self.height - length * north, 0.5 * self.width + length * east * self._east
        elif self.projection == "cube":
            along = self._cube @ views
            face = np.argmax(along[:, 2], axis=0)
            x, y, depth = np.take_along_axis(along, face[None, None], axis=0)[0]
            # the edge of a face is its own
            last = self.height - 1e-6
            row = np.clip(0.5 * self.height * (1.0 - y / depth), 0.0, last)
            column = face * self.height + np.clip(0.5 * self.height * (1.0 + x / depth), 0.0, last)
        else:
            x, y, depth = (axis @ views for axis in self._axes)
            # what is behind falls outside
            depth = np.where(depth > 1e-9, depth, np.nan)
            row, column = 0.5 * self.height - self._focal * y / depth, 0.5 * self.width + self._focal * x / depth
        inside = seen & (row >= 0.0) & (row < self.height) & (column >= 0.0) & (column < self.width)
        return np.floor(row), np.floor(column), inside

    @property
    def across(self) -> float:
        """The field of view, rad."""
        usual = np.radians(70.0) if self.projection == "perspective" else np.pi
        return float(usual if self.field_of_view is None else self.field_of_view)

    @property
    def _per_pixel(self) -> float:
        """Radians from the zenith."""
        return self.across / min(self.width, self.height)

    @property
    def _east(self) -> float:
        return -1.0 if self.mirrored else 1.0

    @property
    def _focal(self) -> float:
        return 0.5 * self.width / np.tan(0.5 * self.across)

    @property
    def _cube(self) -> np.ndarray:
        """Right, up and ahead of each face, east, north, up `[face, axis, 3]`."""
        sine, cosine = np.sin(self.azimuth), np.cos(self.azimuth)
        return _FACES @ np.array([[cosine, -sine, 0.0], [0.0, 0.0, 1.0], [sine, cosine, 0.0]])

    @property
    def _axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Right, up and ahead."""
        sine, cosine = np.sin(self.azimuth), np.cos(self.azimuth)
        slope, level = np.sin(self.elevation), np.cos(self.elevation)
        right = np.array([cosine, -sine, 0.0]) * self._east
        ahead = np.array([level * sine, level * cosine, slope])
        return right, np.array([-slope * sine, -slope * cosine, level]), ahead
