"""Factorisations of small matrices that neither use LAPACK's threads nor wait for XLA's."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def triangle(rows: Float[Array, "row column"]) -> Float[Array, "rank column"]:
    r"""R of a QR by Householder reflections, with the signs of LAPACK; for $[A, b]$ the last column is $Q^T b$.

    `jnp.linalg.qr` is not used. OpenBLAS distributes more than some 9000 numbers over its threads, which wait by
    yielding, 300 times as long as the work takes. jaxlib 0.10 distributes a batch over XLA's threads and hangs if all
    of them wait so.

    **Arguments:** `rows`, with few columns: the work for each is a pass over all of them.
    **Returns:** the upper triangle, with as many rows as the smaller side.
    **Source:** Golub & Van Loan, Matrix Computations, sec. 5.1 and 5.2.
    """
    place, rank = jnp.arange(rows.shape[0]), min(rows.shape)

    def reflect(k, columns):
        column = jnp.where(place >= k, columns[k], 0.0)
        largest = jnp.max(jnp.abs(column))
        column = column / jnp.where(largest > 0.0, largest, 1.0)
        length, head = jnp.sqrt(jnp.sum(column**2)), column[k]
        end = jnp.where(head < 0.0, length, -length)
        mirror = jnp.where(place == k, head - end, column)
        square = end * (end - head)
        share = columns @ mirror / jnp.where(square > 0.0, square, 1.0)
        return columns - share[:, None] * mirror[None]

    # The last row has nothing below it. With columns as rows, memory is read in its order.
    columns = jax.lax.fori_loop(0, min(rank, rows.shape[0] - 1), reflect, rows.T)
    return jnp.triu(columns[:, :rank].T)


@jax.custom_batching.sequential_vmap
def _singular(matrix: Float[Array, "row column"]):
    return _with_lapack(matrix)


def _with_lapack(matrix):
    return jnp.linalg.svd(matrix)[1:]


@jax.custom_jvp
def singular(matrix: Float[Array, "row column"]):
    """Singular values and right vectors of a small matrix, one matrix of a batch after the other, see `triangle`."""
    return _singular(matrix)


@singular.defjvp
def _singular_tangent(primals, tangents):
    return jax.jvp(_with_lapack, primals, tangents)


def solve_upper(
    matrix: Float[Array, "parameter parameter"], right: Float[Array, "parameter ..."]
) -> Float[Array, "parameter ..."]:
    """The solution of an upper triangular system, from its last row up."""
    count = matrix.shape[0]

    def substitute(k, solution):
        row = count - 1 - k
        return solution.at[row].set((right[row] - matrix[row] @ solution) / matrix[row, row])

    # Without unknowns the body, which is traced all the same, has no row.
    return jax.lax.fori_loop(0, count, substitute, jnp.zeros_like(right)) if count else right


@jax.custom_batching.sequential_vmap
def tridiagonal_inverse(
    lower: Float[Array, " level"], diagonal: Float[Array, " level"], upper: Float[Array, " level"]
) -> Float[Array, "level level"]:
    """The inverse of a tridiagonal matrix, one matrix of a batch after the other, see `triangle`."""
    return jax.lax.linalg.tridiagonal_solve(lower, diagonal, upper, jnp.eye(diagonal.shape[0], dtype=diagonal.dtype))


def inverse(matrix: Float[Array, "... row column"]) -> Float[Array, "... row column"]:
    """The inverse of positive definite matrices of a few rows by Gauss-Jordan elimination, without LAPACK."""
    size = matrix.shape[-1]
    whole = jnp.concatenate([matrix, jnp.broadcast_to(jnp.eye(size, dtype=matrix.dtype), matrix.shape)], axis=-1)
    for k in range(size):
        pivot = whole[..., k, :] / whole[..., k, k, None]
        factor = whole[..., :, k].at[..., k].add(-1.0)
        whole = whole - factor[..., None] * pivot[..., None, :]
    return whole[..., size:]
