"""Roll, pitch and yaw of whole tracks as rotations of SciPy, and back."""

from scipy.spatial.transform import Rotation

from shared.maths.earth import FloatArray


def rotations(angles: FloatArray) -> Rotation:
    """Rotations NED from body of roll, pitch and yaw [rad], shape (n, 3)."""
    return Rotation.from_euler("ZYX", angles[..., ::-1])


def angles_of(rotation: Rotation) -> FloatArray:
    """Roll, pitch and yaw [rad], shape (n, 3), or (3,) of a single rotation."""
    angles: FloatArray = rotation.as_euler("ZYX")[..., ::-1]
    return angles
