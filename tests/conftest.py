"""Settings and fixtures of all tests; skyfit itself is imported only after pytest has hooked jaxtyping in."""

import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import hypothesis
import jax
import jaxtyping
import pytest


# all processes of a run share what one of them has compiled
CACHE = "JAX_COMPILATION_CACHE_DIR"
# above two minutes, the longest first
LONGEST = (
    "test_hard_cases", "test_polarisation", "test_recovery", "test_gradients", "test_cli", "test_heights",
    "test_spherical", "test_image", "test_readme", "test_inversion", "test_spectrum", "test_error_bars",
    "test_upsample", "test_aloft", "test_single", "test_broken_inputs", "test_joint_fit", "test_bruneton",
    "test_moving_skies", "test_instrument",
)  # fmt: skip
# memory maps of a process, of which Linux allows 65530: each program holds some fifty
MOST_MAPS = 40_000
MAPS = Path("/proc/self/maps")
# files and names of the tests whose types have been checked
CHECKED: set[tuple[Path, str]] = set()


# programs run a few times, so that compilation is most of the time of a test; these run for longer
LONG_RUNS = ("test_recovery", "test_error_bars", "test_image")
FLAGS = ["--xla_backend_optimization_level=1"]
if version("jaxlib") == "0.10.2":
    # as the command line does
    FLAGS.append("--xla_cpu_use_fusion_emitters=false")
os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *FLAGS]).strip()


def pytest_configure(config: pytest.Config) -> None:
    if CACHE not in os.environ:
        os.environ[CACHE] = config.skyfit_cache = tempfile.mkdtemp(prefix="skyfit-programs-")
    jax.config.update("jax_compilation_cache_dir", os.environ[CACHE])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files that take longest begin, so that no process waits for the last of them."""
    place = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


def pytest_unconfigure(config: pytest.Config) -> None:
    # the process that made the folder removes it
    shutil.rmtree(getattr(config, "skyfit_cache", ""), ignore_errors=True)


# the tests' dtype is the library's default, float32; the fixture `x64` and `jax.enable_x64` change it
jax.config.update("jax_numpy_rank_promotion", "raise")
# the same examples each time, and no time limit on one: the first compiles
hypothesis.settings.register_profile("skyfit", derandomize=True, deadline=None)
hypothesis.settings.load_profile("skyfit")


@pytest.fixture(scope="session")
def checkout() -> Path:
    """Root of the checkout."""
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared(checkout: Path) -> Path:
    """The folder of oracles and measured skies beside the checkout; a test that asks for it skips without."""
    path = checkout.parent / "shared"
    if not path.is_dir():
        pytest.skip("../shared is absent: it holds the oracles and measured skies, which are not shipped")
    return path


@pytest.fixture(scope="session")
def environment(checkout: Path) -> dict[str, str]:
    """Of the programs that tests start: a narrow window; all of a run share what one has compiled."""
    place = {
        "COLUMNS": "80",
        "XDG_CACHE_HOME": os.path.join(os.environ[CACHE], "commands"),
        "PYTHONPATH": str(checkout),
    }
    place["XLA_FLAGS"] = "--xla_backend_optimization_level=0"
    return {k: v for k, v in os.environ.items() if not k.startswith("JAX_")} | place


@pytest.fixture(scope="session")
def python(environment: dict[str, str]) -> Callable:
    """A program in a process of its own."""

    def call(program, *arguments, cwd):
        command = [sys.executable, "-W", "error", "-c", program, *map(str, arguments)]
        return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=500)

    return call


# calls of the program `skyfit`, one a line, each answered by a line; what a call prints is caught as of a process
CALLS = """
import json, os, sys, tempfile, traceback
from skyfit.cli import main
answers = os.fdopen(os.dup(1), "w")
for line in sys.stdin:
    folder, *sys.argv[1:] = json.loads(line)
    os.chdir(folder)
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as error:
        os.dup2(out.fileno(), 1), os.dup2(error.fileno(), 2)
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush(), sys.stderr.flush()
        out.seek(0), error.seek(0)
        print(json.dumps([code, out.read(), error.read()]), file=answers, flush=True)
"""


@pytest.fixture(scope="session")
def command_line(environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable]:
    """The program `skyfit`, all calls in one process, which saves the imports and keeps what it has compiled."""
    command, folder = [sys.executable, "-W", "error", "-c", CALLS], tmp_path_factory.mktemp("calls")
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:

        def call(*arguments, cwd):
            print(json.dumps([str(cwd), *map(str, arguments)]), file=process.stdin, flush=True)
            late = threading.Timer(500.0, process.kill)
            late.start()
            answer = process.stdout.readline()
            late.cancel()
            assert answer, f"`skyfit` ended by itself or took longer than 500 s: {arguments}"
            return subprocess.CompletedProcess(arguments, *json.loads(answer))

        yield call
        process.stdin.close()


@pytest.fixture(scope="session")
def skyfit_command(python: Callable, command_line: Callable) -> Callable:
    """The program `skyfit`, in a process of its own where it runs `alone`."""

    def call(*arguments, cwd, check=True, alone=False):
        if alone:
            done = python("from skyfit.cli import main; main()", *arguments, cwd=cwd)
        else:
            done = command_line(*arguments, cwd=cwd)
        assert "Traceback" not in done.stderr, done.stderr
        if check:
            assert done.returncode == 0, done.stderr
            assert done.stderr.strip() == ""
        return done

    return call


@pytest.fixture(autouse=True)
def checked_once(request: pytest.FixtureRequest) -> Iterator[None]:
    """Types and shapes, a sixth of a test's time, are checked in the first case of each test that is not slow.

    Its other cases, and slow tests, call what these call.
    """
    test = request.node.path, getattr(request.node, "originalname", request.node.name)
    unchecked = request.node.get_closest_marker("slow") is not None or test in CHECKED
    if not unchecked:
        CHECKED.add(test)
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", before or unchecked)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture
def x64() -> Iterator[None]:
    """float64 for one test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module", autouse=True)
def few_programs() -> Iterator[None]:
    """Programs are dropped after a file once the process runs short of memory maps."""
    yield
    if not MAPS.exists() or MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(scope="module", autouse=True)
def hasty(request: pytest.FixtureRequest) -> Iterator[None]:
    """Programs are compiled without optimising, but for the files of long runs."""
    jax.config.update("jax_disable_most_optimizations", request.path.stem not in LONG_RUNS)
    yield
