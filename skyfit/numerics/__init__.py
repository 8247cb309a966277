from .dtype import as_float as as_float
from .factor import (
    singular as singular,
    solve_upper as solve_upper,
    triangle as triangle,
    tridiagonal_inverse as tridiagonal_inverse,
)
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
    cubic as cubic,
    cubic_weights as cubic_weights,
    hat_weights as hat_weights,
    library_of as library_of,
    linear as linear,
)
from .legendre import (
    associated_legendre as associated_legendre,
    legendre_series as legendre_series,
    of_angle as of_angle,
    spin_legendre as spin_legendre,
)
from .quadrature import gauss_legendre as gauss_legendre
from .ranges import (
    ALL_WAVELENGTHS as ALL_WAVELENGTHS,
    as_float_or_none as as_float_or_none,
    check_increasing as check_increasing,
    check_radians as check_radians,
    check_range as check_range,
    check_unit_vectors as check_unit_vectors,
    check_wavelength as check_wavelength,
    concrete as concrete,
    IN_MICROMETRES as IN_MICROMETRES,
    radians_within as radians_within,
    Ranged as Ranged,
    table_range as table_range,
    within as within,
)
