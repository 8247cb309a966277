from .read import load as load
from .write import save as save, write_prediction as write_prediction
