"""Aid: zero velocity and zero angular rate at standstill (ZUPT, ZARU)."""
