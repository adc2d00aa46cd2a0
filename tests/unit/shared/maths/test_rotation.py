from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from shared.maths import rotation

COMPONENT = st.floats(-3.0, 3.0)
VECTORS = st.tuples(COMPONENT, COMPONENT, COMPONENT)
SMALL = st.tuples(*[st.floats(-2e-4, 2e-4)] * 3)
ANGLES = st.tuples(st.floats(-pi, pi), st.floats(-1.5, 1.5), st.floats(-pi, pi))


@given(VECTORS, VECTORS)
def test_the_skew_matrix_is_the_vector_product(a: tuple[float, float, float], b: tuple[float, float, float]) -> None:
    assert rotation.skew(a) @ np.array(b) == pytest.approx(np.cross(a, b), abs=1e-12)


@given(st.one_of(VECTORS, SMALL))
def test_the_quaternion_of_a_rotation_vector_agrees_with_scipy(vector: tuple[float, float, float]) -> None:
    expected = Rotation.from_rotvec(vector).as_matrix()
    quaternion = rotation.quaternion_from_rotation_vector(vector)
    assert rotation.matrix_from_quaternion(quaternion) == pytest.approx(expected, abs=1e-14)


@given(ANGLES)
def test_roll_pitch_yaw_agree_with_scipy(angles: tuple[float, float, float]) -> None:
    matrix = rotation.ned_from_body(*angles)
    expected = Rotation.from_euler("ZYX", angles[::-1]).as_matrix()
    assert matrix == pytest.approx(expected, abs=1e-14)
    found = rotation.roll_pitch_yaw_of_quaternion(rotation.quaternion_from_matrix(matrix))
    assert rotation.ned_from_body(*found) == pytest.approx(matrix, abs=1e-12)


@pytest.mark.parametrize("pitch", [-pi / 2, pi / 2])
def test_at_a_pitch_of_90_degrees_roll_is_zero(pitch: float) -> None:
    matrix = rotation.ned_from_body(0.0, pitch, 0.7)
    found = rotation.roll_pitch_yaw_of_quaternion(rotation.quaternion_from_matrix(matrix))
    assert found == pytest.approx((0.0, pitch, 0.7), abs=1e-7)


@given(VECTORS)
def test_a_quaternion_and_its_matrix_are_the_same_rotation(vector: tuple[float, float, float]) -> None:
    matrix = Rotation.from_rotvec(vector).as_matrix()
    quaternion = rotation.quaternion_from_matrix(matrix)
    assert quaternion[0] >= 0.0
    assert rotation.matrix_from_quaternion(quaternion) == pytest.approx(matrix, abs=1e-14)


@given(VECTORS, VECTORS)
def test_the_product_of_quaternions_is_the_product_of_matrices(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    left, right = rotation.quaternion_from_rotation_vector(a), rotation.quaternion_from_rotation_vector(b)
    product = rotation.matrix_from_quaternion(rotation.quaternion_product(left, right))
    expected = rotation.matrix_from_quaternion(left) @ rotation.matrix_from_quaternion(right)
    assert product == pytest.approx(expected, abs=1e-13)
