from .coefficients import read_coefficients as read_coefficients, write_coefficients as write_coefficients
from .evaluator import evaluator as evaluator, write_evaluator as write_evaluator
from .fit import load as load, save as save, write_prediction as write_prediction
from .fits import fit_many as fit_many, read_fits as read_fits
from .perez import write_perez as write_perez
from .products import write_products as write_products
