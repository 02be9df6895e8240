"""Sums of weighted normal equations, inlined into the kernels that fill them."""

from numba import njit

_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid


@_inlined
def fill_sums(J, w, r, rows, H, b) -> None:  # type: ignore[no-untyped-def]
    """Fills H[0] = sum w J J^T and b[0] = -sum w r J from the columns J (6, N), w (N,), r (N,).

    With moments H[1] and b[1] are the same times `rows` (N,), and H[2] times their squares. Each sum is a loop over columns that lie one
    after another, which the compiler vectorises.
    """
    for i in range(6):
        weighted = w * J[i]
        for j in range(i, 6):
            total, first, second = 0.0, 0.0, 0.0
            if len(H) > 1:
                for k in range(len(w)):
                    product = weighted[k] * J[j, k]
                    total += product
                    first += product * rows[k]
                    second += product * rows[k] * rows[k]
                H[1, i, j], H[1, j, i], H[2, i, j], H[2, j, i] = first, first, second, second
            else:
                for k in range(len(w)):
                    total += weighted[k] * J[j, k]
            H[0, i, j], H[0, j, i] = total, total
        total, first = 0.0, 0.0
        for k in range(len(w)):
            total -= weighted[k] * r[k]
            first -= weighted[k] * r[k] * rows[k]
        b[0, i] = total
        if len(b) > 1:
            b[1, i] = first
