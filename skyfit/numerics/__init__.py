from .guarded import (
    exp_mean as exp_mean,
    phi1 as phi1,
    phi_functions as phi_functions,
    polynomial as polynomial,
    safe_sqrt as safe_sqrt,
)
from .interpolation import (
    chebyshev_nodes as chebyshev_nodes,
    chebyshev_weights as chebyshev_weights,
    hat_weights as hat_weights,
)
from .legendre import (
    associated_legendre as associated_legendre,
    legendre_series as legendre_series,
    of_angle as of_angle,
    spin_legendre as spin_legendre,
)
from .quadrature import gauss_legendre as gauss_legendre
from .tables import data_path as data_path, read_arrays as read_arrays, read_table as read_table
