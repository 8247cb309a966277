"""The direction and the solid angle of each pixel of a picture."""

from dataclasses import dataclass
from typing import get_args, Literal

import numpy as np
from jaxtyping import Bool, Float, Real

from ..numerics import check_range


Projection = Literal["equirect", "fisheye", "cube", "perspective"]
Mapping = Literal["equidistant", "equisolid", "stereographic"]
# Largest width and height, pixels
_LARGEST = 32768.0
# Marks a width or height for which the default of the projection is used
_USUAL = -1
_SIZES = {"equirect": (1024, 512), "fisheye": (1024, 1024), "cube": (1536, 256), "perspective": (1024, 576)}
# Right, up and ahead of each face of a cube, on the axes right, up and ahead of an observer who faces the fifth face
_FACES = np.array([
    [[0, 0, -1], [0, 1, 0], [1, 0, 0]], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[1, 0, 0], [0, 0, 1], [0, -1, 0]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
], float)  # fmt: skip
# Largest image distance of a fisheye from its centre, in focal lengths
_FARTHEST = 100.0


def _length(mapping: Mapping, angle):
    """Image distance from the centre, in focal lengths."""
    half = 0.5 * angle
    return {"equidistant": angle, "equisolid": 2.0 * np.sin(half), "stereographic": 2.0 * np.tan(half)}[mapping]


def _slope(mapping: Mapping, angle):
    """Derivative of `_length` by the angle."""
    if mapping == "equidistant":
        return np.ones_like(angle)
    return np.cos(0.5 * angle) if mapping == "equisolid" else np.cos(0.5 * angle) ** -2


def _angle_of(mapping: Mapping, length):
    """The inverse of `_length`."""
    if mapping == "equidistant":
        return length
    return 2.0 * (np.arcsin(np.minimum(0.5 * length, 1.0)) if mapping == "equisolid" else np.arctan(0.5 * length))


@dataclass(frozen=True)
class Camera:
    """A picture of `width` by `height` pixels, by default of a size that depends on the projection.

    - "equirect": the whole sphere, the zenith in the top row, azimuth increasing to the right.
    - "fisheye": looks up. At the nearer edges the angle t from the zenith is half of `field_of_view`; nothing is seen
      beyond. With d = t (1 + `k1` t^2 + `k2` t^4), which is t for a perfect lens, the distance from the centre is
      proportional to d, 2 sin(d / 2) or 2 tan(d / 2), according to `mapping`. North is up; east is right as on a map,
      or left with `mirrored`, as seen by an observer lying on the back.
    - "cube": six square faces side by side, in the order and orientation of cube maps (x right, y up, z ahead): right,
      left, up, down, ahead and behind of an observer who looks toward `azimuth`.
    - "perspective": a pinhole that spans `field_of_view` from left to right.

    `azimuth`, clockwise from north, of the middle column, or of a cube's face ahead; `elevation` of the middle of a
    perspective picture; `field_of_view`, by default pi for a fisheye and 70 degrees for a pinhole. All are in radians.
    **Errors:** `ValueError` for values out of range, and for a lens whose image distance does not grow with the angle.
    **Source:** Kannala & Brandt 2006, IEEE TPAMI 28, 1335, eq. 1-6, for mappings and the polynomial.

    **Example:**

        >>> skyfit.Camera("fisheye", 64, 64).views().shape
        (3, 64, 64)
    """

    projection: Projection = "equirect"
    width: int = _USUAL
    height: int = _USUAL
    azimuth: float = np.pi
    elevation: float = 0.0
    field_of_view: float | None = None
    mirrored: bool = False
    mapping: Mapping = "equidistant"
    k1: float = 0.0
    k2: float = 0.0

    def __post_init__(self):
        if self.projection not in get_args(Projection):
            raise ValueError(f"`projection` must be one of {', '.join(get_args(Projection))}, got {self.projection!r}")
        if self.width == self.height == _USUAL:
            for name, usual in zip(("width", "height"), _SIZES[self.projection], strict=True):
                object.__setattr__(self, name, usual)
        elif _USUAL in (self.width, self.height):
            raise ValueError("`width` and `height` must be given together, or left out")
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
        self._check_lens()

    def _check_lens(self):
        if self.mapping not in get_args(Mapping):
            raise ValueError(f"`mapping` must be one of {', '.join(get_args(Mapping))}, got {self.mapping!r}")
        for name in ("k1", "k2"):
            check_range(name, getattr(self, name), -0.5, 0.5)
        if self.projection != "fisheye" and (self.mapping != "equidistant" or self.k1 or self.k2):
            raise ValueError(
                f'`mapping`, `k1` and `k2` must be left out with "{self.projection}": they are of a fisheye'
            )
        angle = np.linspace(0.0, 0.5 * self.across, 1000)
        distance = _length(self.mapping, self._bent(angle))
        steep = _slope(self.mapping, self._bent(angle)) * self._bending(angle)
        if self.projection == "fisheye" and not (np.all(steep > 1e-3) and distance[-1] < _FARTHEST):
            raise ValueError(
                f"`field_of_view` must be one that the lens spreads out, got {np.degrees(self.across):g} degrees with "
                f"{self.mapping}, k1 {self.k1:g} and k2 {self.k2:g}"
            )

    def views(self, first: int = 0, last: int | None = None) -> Float[np.ndarray, "3 row column"]:
        """Unit vectors east, north, up of the pixels in rows `first` to `last`, top row first; float32."""
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
            length = np.hypot(x, y)
            angle = self._angle(length)
            sine = np.sin(angle) / np.where(length > 0.0, length, 1.0)
            return np.stack([sine * x * self._east, sine * y, np.cos(angle)]).astype(np.float32)
        right, up, ahead = self.axes
        views = ahead[:, None, None] * self._focal + right[:, None, None] * x + up[:, None, None] * y
        return (views / np.linalg.norm(views, axis=0)).astype(np.float32)

    def solid_angle(self, row: Real[np.ndarray, "*pixel"], column: Real[np.ndarray, "*pixel"]):
        """Solid angle of the pixels at given row and column indices, sr; 0 where nothing is seen."""
        if self.projection == "equirect":
            edge = np.cos(np.pi * np.stack([row, row + 1.0]) / self.height)
            return 2.0 * np.pi / self.width * (edge[0] - edge[1])
        if self.projection == "cube":
            across, down = ((2.0 * (v % self.height) + 1.0) / self.height - 1.0 for v in (column, row))
            return (2.0 / self.height) ** 2 / (1.0 + across**2 + down**2) ** 1.5
        distance = np.hypot(column + 0.5 - 0.5 * self.width, row + 0.5 - 0.5 * self.height)
        if self.projection == "fisheye":
            angle = self._angle(distance)
            # sin t / r times dt / dr; both are 1 / scale at the centre
            steep = _slope(self.mapping, self._bent(angle)) * self._bending(angle)
            across = np.where(
                distance > 0.0, np.sin(angle) / np.where(distance > 0.0, distance, 1.0), 1.0 / self._scale
            )
            seen = (angle <= 0.5 * self.across) & (distance <= 0.5 * min(self.width, self.height))
            return np.where(seen, np.abs(across) / (self._scale * np.where(seen, steep, 1.0)), 0.0)
        return self._focal / (self._focal**2 + distance**2) ** 1.5

    def places(
        self, views: Float[np.ndarray, "3 view"]
    ) -> tuple[Float[np.ndarray, " view"], Float[np.ndarray, " view"], Bool[np.ndarray, " view"]]:
        """The rows and columns of the pixels that views fall on, and whether they are in the picture."""
        east, north, up = views
        seen = np.ones(up.shape, bool)
        if self.projection == "equirect":
            turn = (np.arctan2(east, north) - self.azimuth) / (2.0 * np.pi) + 0.5
            row, column = np.arccos(np.clip(up, -1.0, 1.0)) / np.pi * self.height, (turn % 1.0) * self.width
        elif self.projection == "fisheye":
            flat = np.hypot(east, north)
            angle = np.arctan2(flat, up)
            seen = angle <= 0.5 * self.across
            reach = self._scale * _length(self.mapping, self._bent(np.minimum(angle, 0.5 * self.across)))
            length = reach / np.where(flat > 0.0, flat, 1.0)
            row, column = 0.5 * self.height - length * north, 0.5 * self.width + length * east * self._east
        elif self.projection == "cube":
            along = self._cube @ views
            face = np.argmax(along[:, 2], axis=0)
            x, y, depth = np.take_along_axis(along, face[None, None], axis=0)[0]
            # The edge of a face belongs to that face
            last = self.height - 1e-6
            row = np.clip(0.5 * self.height * (1.0 - y / depth), 0.0, last)
            column = face * self.height + np.clip(0.5 * self.height * (1.0 + x / depth), 0.0, last)
        else:
            x, y, depth = (axis @ views for axis in self.axes)
            # Views behind the camera become NaN and so lie outside
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
    def _scale(self) -> float:
        """Focal length of a fisheye, pixels."""
        return 0.5 * min(self.width, self.height) / float(_length(self.mapping, self._bent(0.5 * self.across)))

    def _bent(self, angle):
        """The angle at which a perfect lens would image an object at `angle` from the zenith."""
        return angle * (1.0 + self.k1 * angle**2 + self.k2 * angle**4)

    def _bending(self, angle):
        """The derivative of `_bent` by the angle."""
        return 1.0 + 3.0 * self.k1 * angle**2 + 5.0 * self.k2 * angle**4

    def _angle(self, length):
        """Angle from the zenith of an object imaged `length` pixels from the centre; pi at most for unseen ones."""
        bent = _angle_of(self.mapping, length / self._scale)
        angle = bent
        if self.k1 or self.k2:
            # Newton's method from the perfect lens, kept within the range in which the lens was checked
            for _ in range(8):
                angle = np.clip(angle - (self._bent(angle) - bent) / self._bending(angle), 0.0, 0.5 * self.across)
        return angle

    @property
    def _east(self) -> float:
        return -1.0 if self.mirrored else 1.0

    @property
    def _focal(self) -> float:
        return 0.5 * self.width / np.tan(0.5 * self.across)

    @property
    def _cube(self) -> np.ndarray:
        """Right, up and ahead of each face as unit vectors east, north, up, `[face, axis, 3]`."""
        sine, cosine = np.sin(self.azimuth), np.cos(self.azimuth)
        return _FACES @ np.array([[cosine, -sine, 0.0], [0.0, 0.0, 1.0], [sine, cosine, 0.0]])

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Right, up and ahead of a perspective picture: unit vectors east, north, up."""
        sine, cosine = np.sin(self.azimuth), np.cos(self.azimuth)
        slope, level = np.sin(self.elevation), np.cos(self.elevation)
        right = np.array([cosine, -sine, 0.0]) * self._east
        ahead = np.array([level * sine, level * cosine, slope])
        return right, np.array([-slope * sine, -slope * cosine, level]), ahead
