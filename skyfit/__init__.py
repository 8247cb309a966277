"""A differentiable daylight sky: simulate it, fit it, refit Preetham's model."""

import os
from importlib.metadata import version

import lazy_loader


# These versions of jaxlib silently compute some sums of products wrongly, and crash over seven axes:
# github.com/jax-ml/jax/issues/39103 and 39257. XLA reads the flag at its start, and aborts if it does not know it
_FAULTY_JAXLIB, _WITHOUT_FAULT = ("0.10.2", "0.11.0"), "--xla_cpu_experimental_ynn_fusion_type=-reduce"
_given = os.environ.get("XLA_FLAGS", "")
if version("jaxlib") in _FAULTY_JAXLIB and _WITHOUT_FAULT.partition("=")[0] not in _given:
    os.environ["XLA_FLAGS"] = f"{_given} {_WITHOUT_FAULT}".strip()

# __init__.pyi lists the names; each is imported on first use, so that a help text does not load jax
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
