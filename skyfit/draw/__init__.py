from .domes import plot as plot, plot_skies as plot_skies
