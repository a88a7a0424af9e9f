"""Array geometry: the frame's convention, and what bad values are answered."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbn_common.parameters import ParameterError
from fbn_common.sonar import SonarArray, cartesian, polar


def test_a_level_array_looks_forward_with_its_axis_to_the_left_and_theta_down() -> None:
    rotation = SonarArray().rotation_base_array
    np.testing.assert_allclose(rotation @ cartesian(10.0, np.pi / 2, 0.0), [10, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rotation @ cartesian(10.0, 0.0, 0.0), [0, 10, 0], atol=1e-12)
    assert (rotation @ cartesian(10.0, np.pi / 2, 0.1))[2] < 0


def test_positive_mount_pitch_looks_down_and_positive_yaw_left() -> None:
    down = SonarArray(mount_rpy=(0.0, 0.1, 0.0)).rotation_base_array @ cartesian(1.0, np.pi / 2, 0.0)
    left = SonarArray(mount_rpy=(0.0, 0.0, 0.1)).rotation_base_array @ cartesian(1.0, np.pi / 2, 0.0)
    np.testing.assert_allclose(down, [np.cos(0.1), 0, -np.sin(0.1)], atol=1e-12)
    np.testing.assert_allclose(left, [np.cos(0.1), np.sin(0.1), 0], atol=1e-12)


@given(st.floats(0.5, 100.0), st.floats(0.05, 3.0), st.floats(-1.5, 1.5))
def test_polar_undoes_cartesian(r: float, phi: float, theta: float) -> None:
    np.testing.assert_allclose(polar(cartesian(r, phi, theta)), (r, phi, theta), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "values",
    [
        {"bearing_min": 2.0, "bearing_max": 1.0},
        {"range_min": 5.0, "range_max": 4.0},
        {"lobe_width": 0.0},
        {"detection_probability": 1.0},
    ],
)
def test_an_impossible_array_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        SonarArray(**values)  # type: ignore[arg-type]
