"""The solvers by their short names: the one list that the command line, files and experiments use."""

from .contract import AbstractSolver
from .double import DoubleScattering
from .orders.solver import OrdersOfScattering
from .shells import Shells
from .single import SingleScattering
from .spherical import Spherical
from .uniform import Uniform


SOLVERS: dict[str, type[AbstractSolver]] = {
    "orders": OrdersOfScattering,
    "spherical": Spherical,
    "double": DoubleScattering,
    "single": SingleScattering,
    "shells": Shells,
    "uniform": Uniform,
}
