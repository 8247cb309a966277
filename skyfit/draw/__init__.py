from .domes import plot as plot, plot_skies as plot_skies
from .refit import plot_refit as plot_refit
from .sensitivity import plot_sensitivity as plot_sensitivity
