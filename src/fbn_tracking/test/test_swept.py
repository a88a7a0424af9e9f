"""The swept area against a cell by cell count."""

from __future__ import annotations

import numpy as np

from fbn_common.lie import matrix_from_rpy
from fbn_common.sonar import FRAME_BASE_LEVEL
from fbn_tracking.swept import swept_area

LIMITS = np.array([4.0, 15.0, np.pi / 2 - 0.4, np.pi / 2 + 0.4, 0.0, 0.0])


def _looks():
    for k in range(5):
        R = matrix_from_rpy(np.array([0.0, 0.0, 0.3 * k])) @ FRAME_BASE_LEVEL
        yield np.ascontiguousarray(R), np.array([10.0 + k, -3.0, -2.0]), LIMITS


def test_counts_are_those_of_asking_each_cell():
    base = np.array([9.3, -2.1])
    area = swept_area(list(_looks()), base, 1.0)
    scans = area.scans.reshape(area.height, area.width)
    expected = np.zeros_like(scans)
    for k in range(5):
        for j in range(area.height):
            for i in range(area.width):
                at = base + area.origin + np.array([i + 0.5, j + 0.5])
                d = at - np.array([10.0 + k, -3.0])
                bearing = (np.arctan2(d[1], d[0]) - 0.3 * k + np.pi) % (2 * np.pi) - np.pi
                expected[j, i] += 4.0 <= np.hypot(*d) <= 15.0 and abs(bearing) <= 0.4
    np.testing.assert_array_equal(scans, expected)
    assert scans.sum() > 200


def test_the_grid_is_large_enough_for_every_look():
    area = swept_area(list(_looks()), np.zeros(2), 1.0)
    # a sector of 0.8 rad between 4 and 15 m has 83.6 square metres; cells on the edge add or take few
    assert abs(area.scans.sum() - 5 * 0.4 * (15**2 - 4**2)) < 0.05 * 5 * 83.6


def test_no_look_gives_no_cells():
    area = swept_area([], np.zeros(2), 1.0)
    assert (area.width, area.height, area.scans.size) == (0, 0, 0)
