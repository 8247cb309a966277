"""How a class is made, above its docstring: Equinox makes that from its fields, which griffe does not see."""

import importlib
import inspect

import griffe


class Signatures(griffe.Extension):
    """Puts names and defaults of what a class takes before its docstring."""

    def on_class(self, *, cls: griffe.Class, **kwargs) -> None:
        made = getattr(importlib.import_module(cls.module.path), cls.name, None)
        if cls.docstring is None or made is None or inspect.isabstract(made) or issubclass(made, Warning):
            return
        parts = []
        for name, part in inspect.signature(made).parameters.items():
            if part.kind is part.VAR_KEYWORD or part.kind is part.VAR_POSITIONAL:
                parts.append(f"{'**' if part.kind is part.VAR_KEYWORD else '*'}{name}")
            elif part.default is part.empty:
                parts.append(name)
            else:
                # what is made anew for each, or has no short name, is told by the docstring
                plain = part.default is None or isinstance(part.default, bool | int | float | str | tuple)
                parts.append(f"{name}={part.default!r}" if plain else f"{name}=...")
        call = f"{cls.name}({', '.join(parts)})"
        if len(call) > 100:
            call = f"{cls.name}(\n    " + ",\n    ".join(parts) + ",\n)"
        cls.docstring.value = f"```python\n{call}\n```\n\n{cls.docstring.value}"
