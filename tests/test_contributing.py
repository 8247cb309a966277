"""The worked examples of CONTRIBUTING.md run."""

import re
import subprocess
import sys
from pathlib import Path


def test_the_worked_examples(tmp_path: Path, checkout: Path):
    text = (checkout / "CONTRIBUTING.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 4
    script = tmp_path / "examples.py"
    script.write_text("\n".join(blocks))
    # a process of its own: the examples stay out of this one's registries
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
