"""Fit every time of a sky by itself, many in one call: long series and pixels."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from ..measured import Sky
from ..measured.quality.oddities import examine
from ..measured.quality.plausibility import beyond_sigma, POOR
from ..numerics.chain import Point
from ..transport import low_sun
from .prepared import first_points, flaws, Prepared
from .report import described_time
from .result import FEW
from .retrieve import retrieve


# possible results of a time; all but the first three have NaN for values
RESULTS = (
    "successful", "poor_fit", "max_steps_reached", "failed", "no_samples", "too_few_samples", "sun_below_horizon",
    "sun_too_low", "not_a_sky",
)  # fmt: skip
_VALUED = 3


@dataclass(frozen=True, eq=False)
class Fits:
    """Parameters of many skies, each fitted by itself; host-side arrays.

    - `values`, `sigma`, `model_sigma`, `at_bound`, `determined` `[time, parameter]` and `covariance` `[time, parameter,
      parameter]` as in `Fit`, in the order of `free`, units as in `PARAMETERS`; NaN (false) where a time has none
    - `reduced_chi_square`, `scale`, `widening`, `degrees_of_freedom` `[time]` and `common` `[time, kind]` as in `Fit`;
      `rmse` `[time]`, W m^-2 sr^-1 nm^-1, over the usable samples at the fitted wavelengths; `samples` `[time]`, the
      number of these
    - `calibration`, `calibration_sigma` `[time, fitted wavelength]`: the instrument's scale, 1 where it is not fitted
    - `steps` `[time]`, `cost` `[time]`: half the sum of squares after the loss
    - `result` `[time]`, one of `RESULTS`. "successful". "poor_fit" (residuals beyond a quarter of the mean radiance,
      without outliers) and "max_steps_reached" have numbers that are not reliable. The others have no numbers: "failed"
      (not finite), "no_samples", "too_few_samples" (fewer than parameters), "sun_below_horizon", "sun_too_low" (for the
      solver), "not_a_sky" (sunlight cannot make such radiance)
    - `notes` `[time]`: sentences on oddities of a time's samples, sun or residuals; `sky_notes`: sentences that hold
      for all times, about the sky and about assumptions where it states nothing, as in `Fit.notes`; `fixed`: the
      parameters that were not fitted
    - `settings`: the request and its sky, as text; `time` `[time]`, UTC, NaT where unknown
    """

    time: np.ndarray
    free: tuple[str, ...]
    fitted_nm: np.ndarray
    values: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    model_sigma: np.ndarray
    at_bound: np.ndarray
    determined: np.ndarray
    rmse: np.ndarray
    samples: np.ndarray
    reduced_chi_square: np.ndarray
    scale: np.ndarray
    common: np.ndarray
    widening: np.ndarray
    degrees_of_freedom: np.ndarray
    calibration: np.ndarray
    calibration_sigma: np.ndarray
    steps: np.ndarray
    cost: np.ndarray
    result: np.ndarray
    notes: tuple[tuple[str, ...], ...]
    sky_notes: tuple[str, ...]
    fixed: dict[str, float]
    settings: dict[str, str]

    def __str__(self) -> str:
        counts = [(name, int(np.sum(self.result == name))) for name in RESULTS]
        told = ", ".join(f"{count} {name}" for name, count in counts if count)
        lines = f"{len(self.time)} skies, {', '.join(self.free)}: {told}", *(f"note: {n}" for n in self.sky_notes)
        return "\n".join(lines)


class Outcome(NamedTuple):
    """The estimate of one time, as arrays only. `ended` is an index into `RESULTS`."""

    values: Float[Array, "... parameter"]
    noise: Float[Array, "... parameter parameter"]
    model: Float[Array, "... parameter parameter"]
    freedom: Float[Array, "..."]
    scale: Float[Array, "..."]
    common: Float[Array, "... kind"]
    widening: Float[Array, "..."]
    chi_square: Float[Array, "..."]
    calibration: Float[Array, "... channel"]
    calibration_sigma: Float[Array, "... channel"]
    rmse: Float[Array, "..."]
    cost: Float[Array, "..."]
    steps: Int[Array, "..."]
    ended: Int[Array, "..."]


def fit_chunks(
    asked: Prepared, times: np.ndarray, chunk: int, batch_size: int, guess: bool, starts: int
) -> Iterator[dict[str, np.ndarray]]:
    """Fit some times of `asked` in chunks, and yield each chunk when it ends.

    **Arguments:** `times`, indices; `chunk`, the number of times in one call; `batch_size`, how many of them run in
    lock-step.
    **Returns** (yields) arrays by their names in `Fits`, and `index`, the indices of their times. All chunks have one
    shape, so that one compilation suffices. Each chunk is split over all devices. On one CPU as many chunks run at once
    as it has cores.
    """
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices), ("time",))
    # a thread for each core: the small matrices of one fit do not keep all cores busy
    workers = (os.cpu_count() or 1) if len(devices) == 1 and devices[0].platform == "cpu" else 1
    width = -(-chunk // len(devices)) * len(devices)
    wrong, priors = flaws(asked), asked.rows._replace(step=asked.rows.step[:0])
    waiting = (times[i : i + width] for i in range(0, len(times), width))
    running: dict[Future, tuple[np.ndarray, list[str], list[str]]] = {}
    pool = ThreadPoolExecutor(workers)
    try:
        while True:
            # one chunk more than there are workers, so that no worker waits for its arrays
            for index in islice(waiting, workers + 1 - len(running)):
                ends, notes = _examined(asked, index, wrong)
                every = np.pad(index, (0, width - len(index)), mode="edge")
                active = np.pad([not end for end in ends], (0, width - len(index)))
                points = first_points(asked, every, guess, starts)
                split = jax.device_put(
                    (jnp.asarray(active), asked.problem.at(every), jnp.moveaxis(points.own, 1, 0)),
                    NamedSharding(mesh, PartitionSpec("time")),
                )
                question = mesh, batch_size, asked.start, asked.names, asked.options(), priors, *split
                # compile in this thread: a worker thread would not see its settings of JAX
                running[pool.submit(_fetch, _outcomes.lower(*question).compile(), question)] = index, ends, notes
            if not running:
                return
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield _columns(asked, *running.pop(future), future.result())
    finally:
        pool.shutdown(cancel_futures=True)


def _fetch(compiled: Callable, question: tuple) -> Any:
    return jax.device_get(compiled(*question))


def _examined(asked: Prepared, index: np.ndarray, flaws: list[str]) -> tuple[list[str], list[str]]:
    """Return why each time is not to be fitted, or "", and its oddities, one sentence a line."""
    ends = [flaws[t] for t in index]
    suns = (None if end else low_sun(asked.solver, asked.sky.sun_zenith[t]) for end, t in zip(ends, index, strict=True))
    notes = [said or "" for said in suns]
    if asked.sampling.response is not None:
        return ends, notes
    for i, t in enumerate(index):
        try:
            odd = examine(asked.sky.at(int(t)), asked.sampling.used[t : t + 1])
            notes[i] = "\n".join([*notes[i].splitlines(), *odd])
        except ValueError as error:
            notes[i] = str(error).removeprefix("`sky` ")
            ends[i] = ends[i] or "not_a_sky"
    return ends, notes


@eqx.filter_jit
def _outcomes(mesh, batch_size, model, names, options, priors, active, problem, own) -> Outcome:
    """The outcomes of a chunk, NaN for inactive times; these cost nothing where `batch_size` is 1."""
    numbers, choices = eqx.partition(options, eqx.is_array)

    def each_device(model, numbers, priors, active, problem, own):
        # `jit`, so that the shapes and the fit itself need only one trace
        given = eqx.combine(numbers, choices)
        fit = jax.jit(lambda one, own: _outcome(model, names, given, priors, one, own))
        shapes = jax.eval_shape(fit, *jax.tree.map(lambda v: v[0], (problem, own)))

        def nothing(_, __):
            return jax.tree.map(lambda s: jnp.full(s.shape, jnp.nan if s.dtype.kind == "f" else 0, s.dtype), shapes)

        def one(item):
            active, one, own = item
            return jax.lax.cond(active, fit, nothing, one, own)

        return jax.lax.map(one, (active, problem, own), batch_size=batch_size if batch_size > 1 else None)

    along, whole = PartitionSpec("time"), PartitionSpec()
    split = jax.shard_map(
        each_device, mesh=mesh, in_specs=(whole, whole, whole, along, along, along), out_specs=along, check_vma=False
    )
    return split(model, numbers, priors, active, problem, own)


def _outcome(model, names, options, priors, one, own) -> Outcome:
    """The outcome of one time, without a time axis."""
    problem = jax.tree.map(lambda v: v[None], one)
    starts = Point(own[:, None], jnp.zeros((own.shape[0], 0), own.dtype))
    found = retrieve(problem, model, names, priors=priors, start=starts, **options)
    used = one.weight > 0.0
    count = jnp.maximum(jnp.sum(used), 1)
    rmse = jnp.sqrt(jnp.sum(jnp.where(used, found.radiance[0] - one.measured, 0.0) ** 2) / count)
    kept = used & ~_outliers(found.weight[0], used)[:, None]
    kept_count = jnp.maximum(jnp.sum(kept), 1)
    kept_rmse = jnp.sqrt(jnp.sum(jnp.where(kept, found.radiance[0] - one.measured, 0.0) ** 2) / kept_count)
    poor = ~(kept_rmse <= POOR * jnp.sum(jnp.where(kept, one.measured, 0.0)) / kept_count)
    return Outcome(
        found.values[0], found.noise[0], found.model[0], found.freedom[0], found.scale[0], found.common[0],
        found.widening[0], found.chi_square[0], found.calibration, found.calibration_sigma, rmse, found.cost,
        found.steps, ended(found.result, found.finite, poor),
    )  # fmt: skip


def _outliers(weight, used):
    """The same as `result.outliers`, for one time and traced arrays."""
    held = jnp.any(used, axis=1)
    mean = jnp.sum(jnp.where(used, weight, 0.0), axis=1) / jnp.maximum(jnp.sum(used, axis=1), 1)
    out = held & (mean < 0.5)
    return out & (jnp.sum(out) <= FEW * jnp.sum(held))


def ended(result, finite, poor) -> Int[Array, ""]:
    """How a search ended, as an index into `RESULTS`.

    **Arguments:** `result` of optimistix; `finite`, whether its outcome is finite; `poor`, whether the fit is poor.
    """
    well, late = result == optx.RESULTS.successful, result == optx.RESULTS.nonlinear_max_steps_reached
    return jnp.where(finite & well, jnp.where(poor, 1, 0), jnp.where(finite & late, 2, 3))


def _columns(asked: Prepared, index: np.ndarray, ends: list[str], notes: list[str], outcome: Outcome) -> dict:
    """The rows of a chunk by their names in `Fits`, without the padding."""
    count = len(index)
    result = np.array([end or RESULTS[code] for end, code in zip(ends, outcome.ended[:count], strict=True)])
    valued = np.isin(result, RESULTS[:_VALUED])
    # a failed fit can hold any numbers
    told = {
        key: np.where(valued.reshape(-1, *[1] * (value.ndim - 1)), value[:count], np.nan).astype(float)
        for key, value in outcome._asdict().items()
    }
    rows = [
        described_time(asked.free, (), asked.order, *row)[0]
        for row in zip(told["values"], told["noise"], told["model"], strict=True)
    ]
    doubts = [
        beyond_sigma(asked.sky, chi) if name == "successful" else ()
        for name, chi in zip(result, told["chi_square"], strict=True)
    ]
    stacked = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return stacked | {
        "index": np.asarray(index),
        "rmse": told["rmse"],
        "samples": asked.sampling.used[index][:, :, asked.chosen].sum(axis=(1, 2)),
        "reduced_chi_square": told["chi_square"],
        "scale": told["scale"],
        "common": told["common"],
        "widening": told["widening"],
        "degrees_of_freedom": told["freedom"],
        "calibration": told["calibration"],
        "calibration_sigma": told["calibration_sigma"],
        "steps": np.asarray(outcome.steps[:count]),
        "cost": told["cost"],
        "result": result,
        "notes": np.array(["\n".join((*said.splitlines(), *more)) for said, more in zip(notes, doubts, strict=True)]),
    }


def fits_of_parts(
    sky: Sky,
    free: tuple[str, ...],
    fitted_nm: np.ndarray,
    chunks: list[dict],
    sky_notes: tuple[str, ...],
    fixed: dict[str, float],
    settings: dict[str, str],
) -> Fits:
    """Join the rows of all chunks in the order of the times."""
    order = np.argsort(np.concatenate([part["index"] for part in chunks]))
    rows = {key: np.concatenate([part[key] for part in chunks])[order] for key in chunks[0] if key != "index"}
    notes = tuple(tuple(text.splitlines()) for text in rows.pop("notes").tolist())
    return Fits(
        time=sky.time, free=free, fitted_nm=fitted_nm, notes=notes, sky_notes=sky_notes, fixed=fixed,
        settings=settings, **rows,
    )  # fmt: skip
