"""Height in the standard atmosphere."""

from math import exp, log

from shared.maths.earth import STANDARD_GRAVITY

STANDARD_PA, STANDARD_K, LAPSE_K_M = 101_325.0, 288.15, -0.0065
EXPONENT = 8.31432 * 0.0065 / (STANDARD_GRAVITY * 0.0289644)


def pressure_height(pressure_pa: float) -> float:
    """Height in the standard atmosphere.

    Parameters
    ----------
    pressure_pa : float
        [Pa] Static pressure.

    Returns
    -------
    float
        [m] Geopotential height above the level of 101325 Pa.

    Notes
    -----
    ::

        h = T_b/L_b [(P/P_b)^(-R L_b/(g M)) - 1],  L_b = -0.0065 K/m

    References
    ----------
    U.S. Standard Atmosphere, 1976, eq. 33a, solved for the height.
    """
    return STANDARD_K / LAPSE_K_M * (exp(EXPONENT * log(pressure_pa / STANDARD_PA)) - 1.0)
