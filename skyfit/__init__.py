"""A differentiable daylight sky: simulate it, fit it, refit Preetham's model."""

import lazy_loader


# __init__.pyi lists the names; each is imported when it is first asked for, so that a help text loads no jax
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
