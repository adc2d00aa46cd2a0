"""Aid: the non-holonomic constraint (NHC), with the mounting of the IMU in the vehicle as states."""
