"""Small factors: LAPACK's numbers, without its threads, and no program that waits for XLA's for ever."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyfit.numerics import singular, solve_upper, triangle, tridiagonal_inverse


# two programs at once, each with batches after work that XLA shares out, so that they run on all of its threads
TWO_PROGRAMS = """
import threading
import jax, jax.numpy as jnp
from skyfit.numerics import singular, solve_upper, triangle, tridiagonal_inverse
rows = jax.random.normal(jax.random.key(0), (64, 400, 6))
def step(_, total):
    light = jnp.exp(jnp.sin(rows * (1.0 + total)))
    upper = jax.vmap(triangle)(light)
    sizes, _ = jax.vmap(singular)(upper)
    solved = jax.vmap(solve_upper)(upper, upper[:, 0])
    band = jnp.exp(light[:, :6, 0])
    inverse = jax.vmap(tridiagonal_inverse)(0.0 * band, band, 0.0 * band)
    return total + 1e-9 * (jnp.sum(sizes) + jnp.sum(solved) + jnp.sum(inverse))
program = jax.jit(lambda total: jax.lax.fori_loop(0, 20, step, total))
program(0.0).block_until_ready()
both = [threading.Thread(target=lambda: program(0.0).block_until_ready()) for _ in range(2)]
[one.start() for one in both]
[one.join() for one in both]
"""


@pytest.mark.parametrize("shape", [(300, 7), (7, 7), (3, 7), (1, 4), (7, 1)])
def test_triangle_is_lapacks(shape, x64):
    rows = np.random.default_rng(3).normal(size=shape) * np.logspace(0.0, -8.0, shape[1])
    expected = np.linalg.qr(rows, mode="r")
    np.testing.assert_allclose(triangle(jnp.asarray(rows)), expected, atol=1e-14 * np.linalg.norm(rows))
    both = jax.vmap(triangle)(jnp.asarray([rows, 2.0 * rows]))
    np.testing.assert_allclose(both, [expected, 2.0 * expected], atol=3e-14 * np.linalg.norm(rows))


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_triangle_of_any_size(scale):
    rows = np.random.default_rng(4).normal(size=(40, 5)).astype(np.float32)
    rows[:, 2] = 0.0
    found = np.asarray(triangle(jnp.asarray(rows * np.float32(scale)))) / np.float32(scale)
    np.testing.assert_allclose(found.T @ found, rows.T @ rows, atol=1e-4)


def test_batches_are_single_ones():
    random = np.random.default_rng(5)
    upper = np.triu(random.normal(size=(3, 4, 4)).astype(np.float32)) + 3.0 * np.eye(4, dtype=np.float32)
    right, band = random.normal(size=(3, 4)).astype(np.float32), 3.0 + random.uniform(size=(3, 5)).astype(np.float32)
    np.testing.assert_allclose(jax.vmap(singular)(upper)[0], np.linalg.svd(upper)[1], rtol=1e-5)
    np.testing.assert_allclose(
        jax.vmap(solve_upper)(upper, right), np.linalg.solve(upper, right[..., None])[..., 0], atol=1e-5
    )
    full = band[:, :, None] * np.eye(5, dtype=np.float32) + np.eye(5, k=1) + np.eye(5, k=-1)
    inverse = jax.vmap(tridiagonal_inverse)(np.ones_like(band), band, np.ones_like(band))
    np.testing.assert_allclose(inverse, np.linalg.inv(full), atol=1e-5)


def test_factors_have_derivatives(x64):
    rows = jnp.asarray(np.random.default_rng(6).normal(size=(6, 3)))

    def size(rows):
        upper = triangle(rows)
        return jnp.sum(singular(upper)[0] ** 2) + jnp.sum(solve_upper(upper, upper[:, 0]))

    # the squares of the singular values sum to those of the rows; the solution is the first unit vector
    np.testing.assert_allclose(jax.grad(size)(rows), 2.0 * rows, atol=1e-12)


@pytest.mark.parametrize("rest", [1e-6, 1e-10, 1e-12, 0.0])
def test_derivatives_of_nearly_dependent_columns_are_finite(rest):
    rows = jnp.asarray([[1.0, 1.0], [0.0, rest], [0.0, 0.1 * rest]], jnp.float32)
    for slope in (jax.grad, jax.jacfwd, lambda f: lambda rows: jax.vmap(jax.grad(f))(rows[None])):
        assert np.all(np.isfinite(slope(lambda rows: jnp.sum(triangle(rows)))(rows)))


def test_two_programs_end():
    threads = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    subprocess.run([sys.executable, "-c", TWO_PROGRAMS], env=threads, check=True, timeout=120)
