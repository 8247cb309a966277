from .contact_sheet import plot_contact_sheet as plot_contact_sheet
from .domes import plot as plot, plot_skies as plot_skies
from .panorama import plot_panorama as plot_panorama
from .refit_errors import plot_refit as plot_refit
from .sensitivity_maps import plot_sensitivity as plot_sensitivity
