"""What mkdocs does besides mkdocs.yml: runs notebooks, takes pages and pictures from outside docs/, draws formulas."""

import html
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

from skyfit import PARAMETERS


ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(Path(__file__).parent))
import names  # noqa: E402


MADE = ROOT / "build/docs/notebooks"
# pages that live at the top of the project
OUTSIDE = {"contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}
RESULTS = re.compile(r"(?:\.\./)+experiments/results/([\w.-]+\.png)")
PARTS = re.compile(r"\s<strong>((?:Arguments|Returns|Valid|Errors|Source)\b[^<]*)</strong>")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
# the names of functions, after which a thin space belongs
FUNCTION = re.compile(r"(?<!<msup>)(<mi>(?:sin|cos|tan|exp|log|ln)</mi>)")
# what a notebook compiles runs a few times: it is hardly worth optimising, and is kept for the next build
AT_ONCE, FLAGS = 2, ["--xla_backend_optimization_level=0"]
if version("jaxlib") == "0.10.2":
    # as the command line does
    FLAGS.append("--xla_cpu_use_fusion_emitters=false")
SURROUNDINGS = os.environ | {
    "XLA_FLAGS": " ".join([os.environ.get("XLA_FLAGS", ""), *FLAGS]).strip(),
    "JAX_COMPILATION_CACHE_DIR": str(ROOT / "build/docs/programs"),
}
# whether pages of notebooks that are newer than their notebooks stay: while somebody writes, not in a build
kept = False


def on_startup(command, dirty):
    global kept
    kept = command == "serve"


def executed(notebook: Path) -> None:
    """A notebook run from its first cell to its last, as Markdown with its pictures beside it."""
    page = MADE / f"{notebook.stem}.md"
    if kept and page.exists() and page.stat().st_mtime > notebook.stat().st_mtime:
        return
    to_notebook = sys.executable, "-m", "jupytext", "--quiet", "--to", "ipynb", "--output", "-", notebook
    to_page = sys.executable, "-m", "nbconvert", "--log-level", "ERROR", "--to", "markdown", "--execute", "--stdin"
    to_page += "--output-dir", MADE, "--output", notebook.stem
    made = subprocess.run(to_notebook, capture_output=True, cwd=ROOT)
    if made.returncode == 0:
        made = subprocess.run(to_page, input=made.stdout, capture_output=True, cwd=ROOT, env=SURROUNDINGS)
    if made.returncode != 0:
        raise PluginError(f"{notebook.name} raised:\n{made.stderr.decode()[-3000:]}")


def on_pre_build(config):
    """A public name without a docstring, or on no page of the API, ends the build before the notebooks run."""
    if missing := [*names.undocumented(), *names.without_a_page()]:
        raise PluginError(f"without a docstring, or on no page of docs/api: {', '.join(missing)}")


def on_files(files, config):
    if not kept:
        shutil.rmtree(MADE, ignore_errors=True)
    MADE.mkdir(parents=True, exist_ok=True)
    # the last takes longest and begins, so that nothing waits for it
    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(executed, sorted((ROOT / "docs/notebooks").glob("*.py"), reverse=True)))
    for path in sorted(MADE.rglob("*.*")):
        files.append(File.generated(config, f"notebooks/{path.relative_to(MADE)}", abs_src_path=str(path)))
    for page, path in OUTSIDE.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / path)))
    for path in sorted((ROOT / "experiments/results").glob("*.png")):
        files.append(File.generated(config, f"results/{path.name}", abs_src_path=str(path)))
    return files


def parameters() -> str:
    """The table of all parameters of a fit."""
    rows = ["| name | unit | from | to |", "|---|---|---|---|"]
    return "\n".join(rows + [f"| `{p.name}` | {p.unit} | {p.lower:g} | {p.upper:g} |" for p in PARAMETERS.values()])


def on_page_markdown(markdown, page, config, files):
    """Links out of docs/, as they are right in the checkout, into the site."""
    up = os.path.relpath(".", os.path.dirname(page.file.src_uri) or ".")
    markdown = markdown.replace("<!-- parameters -->", parameters())
    markdown = RESULTS.sub(rf"{up}/results/\1", markdown)
    if page.file.src_uri in OUTSIDE:
        markdown = markdown.replace("](docs/", "](")
    return re.sub(r"\]\((?:\.\./)+CONTRIBUTING\.md", f"]({up}/contributing.md", markdown)


def on_page_content(content, page, config, files):
    """Formulas as MathML, which browsers draw themselves; a paragraph for each part of a docstring."""
    if page.file.src_uri.startswith("api/"):
        content = PARTS.sub(r"</p>\n<p><strong>\1</strong>", content)

    def drawn(found):
        display = "block" if found[2] == "[" else "inline"
        return FUNCTION.sub(r"\1<mo>&#x2061;</mo>", convert(html.unescape(found[3]), display=display))

    return FORMULA.sub(drawn, content)
