from .main import main as main
from .options import app as app
