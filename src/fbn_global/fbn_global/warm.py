"""Compiles every kernel at construction, so that no first measurement is late."""

from __future__ import annotations

import numpy as np

from fbn_common.lie import matrix_from_quaternion, matrix_from_rpy, quaternion_from_matrix, rpy_from_matrix, skew
from fbn_common.records import SweptArea
from fbn_global.jcbb import jcbb
from fbn_global.matching import Problem
from fbn_global.negative import gather, log_missed, scan_counts


def warm_up() -> None:
    """Call each kernel once with the types it will see."""
    x, p = np.array([0.0, 0, 0, 0.1, 0, 0]), np.eye(6)
    pair = np.ones((1, 1), dtype=np.bool_)
    problem = Problem(x, p, 1, pair, pair, np.zeros(1), np.ones(1), np.eye(3), 16.0)
    problem.anchors(2.0, 10)
    problem.grow()
    jcbb(x, p, 1, pair, np.eye(3), 3, 100)
    sweeps = gather((SweptArea(1.0, 2, 2, np.zeros(2), np.ones(4)),))
    counts = scan_counts(np.zeros((1, 1, 2)), np.ones((1, 1, 1, 1)) * np.eye(2), sweeps)
    log_missed(counts, pair, np.array([0.5]), np.array([0.5]), 7, 0.05)
    rotation = matrix_from_rpy(np.zeros(3))
    rpy_from_matrix(matrix_from_quaternion(quaternion_from_matrix(rotation)))
    skew(np.zeros(3))
