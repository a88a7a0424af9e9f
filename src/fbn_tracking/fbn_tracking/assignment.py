"""Joint one-to-one assignment of a scan's echoes to the objects that may have caused them."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbn_common.types import Array

_NEVER = 1e9


def assign(costs: Array, new_cost: float) -> dict[int, int]:
    """Echo -> candidate, at least total cost; an echo that no candidate takes for less than ``new_cost`` is absent.

    ``costs`` (candidates, echoes) are twice minus log likelihoods; infinite where gated.
    """
    m, n = costs.shape
    if m == 0 or n == 0:
        return {}
    table = np.full((n, m + n), _NEVER)
    table[:, :m] = np.where(np.isfinite(costs.T), costs.T, _NEVER)
    table[np.arange(n), m + np.arange(n)] = new_cost
    rows, columns = linear_sum_assignment(table)
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if j < m and table[i, j] < _NEVER}
