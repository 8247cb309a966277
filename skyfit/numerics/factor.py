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
    # With columns of size 1 no square overflows, and a rest whose square vanishes is no more than rounding.
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(rows), axis=0))
    size = jnp.where(size > 0.0, size, 1.0)
    least = jnp.finfo(rows.dtype).tiny / jnp.finfo(rows.dtype).eps

    def reflect(k, columns):
        column = jnp.where(place >= k, columns[k], 0.0)
        product = jnp.matmul(columns, column, precision="highest")
        some, head = product[k] > least, columns[k, k]
        length = jnp.sqrt(jnp.where(some, product[k], 1.0))
        end = jnp.where(head < 0.0, length, -length)
        # divided in two steps: in the derivative of a quotient the square of a small product would vanish
        share = jnp.where(some, (product / end - columns[:, k]) / (end - head), 0.0)
        return columns - share[:, None] * jnp.where(place == k, head - end, column)[None]

    # The last row has nothing below it. With columns as rows, memory is read in its order.
    columns = jax.lax.fori_loop(0, min(rank, rows.shape[0] - 1), reflect, (rows / size[None]).T)
    return jnp.triu(columns[:, :rank].T) * size[None]


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
    """The solution of an upper triangular system without a zero on its diagonal, from its last row up."""
    count = matrix.shape[0]
    # One axis for the unknowns, then those of `right`
    place = jnp.arange(count).reshape(-1, *(1,) * (right.ndim - 1))

    def substitute(k, left):
        """Take the next unknown's part off the rows above it; its own row then holds its value."""
        row = count - 1 - k
        value = left[row] / matrix[row, row]
        above = jnp.where(place < row, matrix[:, row].reshape(place.shape), 0.0)
        return jnp.where(place == row, value[None], left - above * value[None])

    # Without unknowns the body, which is traced all the same, has no row.
    return jax.lax.fori_loop(0, count, substitute, right) if count else right


@jax.custom_batching.sequential_vmap
def tridiagonal_inverse(
    lower: Float[Array, " level"], diagonal: Float[Array, " level"], upper: Float[Array, " level"]
) -> Float[Array, "level level"]:
    """The inverse of a tridiagonal matrix, one matrix of a batch after the other, see `triangle`."""
    return jax.lax.linalg.tridiagonal_solve(lower, diagonal, upper, jnp.eye(diagonal.shape[0], dtype=diagonal.dtype))


def inverse(matrix: Float[Array, "... row column"]) -> Float[Array, "... row column"]:
    """The inverse of positive definite matrices of a few rows by Gauss-Jordan elimination, without LAPACK."""
    size = matrix.shape[-1]
    place = jnp.arange(size).reshape(*(1,) * (matrix.ndim - 2), size)

    def eliminate(k, whole):
        pivot = whole[..., k, :] / whole[..., k, k, None]
        factor = whole[..., :, k] - (place == k)
        return whole - factor[..., None] * pivot[..., None, :]

    whole = jnp.concatenate([matrix, jnp.broadcast_to(jnp.eye(size, dtype=matrix.dtype), matrix.shape)], axis=-1)
    return jax.lax.fori_loop(0, size, eliminate, whole)[..., size:]
