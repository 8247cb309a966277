"""Where figures stand in pages, and how times are written."""

GEOMETRIES = ("flat", "spherical")
TABLES = "<!-- figures of experiments/results/accuracy.json -->", "<!-- end of figures -->"
SUMMARY = "<!-- summary of experiments/results -->", "<!-- end of summary -->"
VALIDATED = "<!-- validation of experiments/results -->", "<!-- end of validation -->"
PRINTED = "<!-- printed fit of experiments/results/accuracy.json -->", "<!-- end of printed fit -->"


def between(text: str, marks: tuple[str, str], content: str) -> str:
    """The text with other content between two marks."""
    before, rest = text.split(marks[0])
    _, after = rest.split(marks[1])
    return f"{before}{marks[0]}\n{content}\n{marks[1]}{after}"


def milliseconds(seconds: float) -> str:
    """A time in ms, of two digits."""
    value = 1e3 * seconds
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"
