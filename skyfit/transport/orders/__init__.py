from .solver import OrdersOfScattering as OrdersOfScattering
