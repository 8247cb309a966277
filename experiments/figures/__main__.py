"""`python -m experiments.figures`."""

from . import updated


for path, text in updated().items():
    path.write_text(text)
