"""Files that devices write: bytes of receivers and inertial sensors, logs of CAN buses."""
