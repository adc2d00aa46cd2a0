"""Settings of earlier versions: where each one is now."""

from collections.abc import Iterator, Mapping

MOUNTING = "vehicle.imu.body_from_sensor"
PARSER_MOUNTING = "parsers.imu.body_from_sensor"  # from sensor axes to published axes
FUSION_MOUNTING = "core.fusion.imu.body_from_imu"  # from published axes to those of the vehicle

ARM, REAR_AXLE = "vehicle.gnss.lever_arm_body_m", "vehicle.rear_axle_body_m"
# What [core.spoofing] stated once more. Its value is not taken over: the position was made without it.
STATED_AGAIN = {"core.spoofing.gnss.lever_arm_body_m": ARM, "core.spoofing.long.rear_axle_distance_m": REAR_AXLE}
# Facts of the vehicle that were settings of [core.fusion].
_FACTS = {
    "core.fusion.gnss.lever_arm_body_m": ARM,
    "core.fusion.gnss.lever_arm_sd_m": "vehicle.gnss.lever_arm_sd_m",
    "core.fusion.dual_antenna.baseline_yaw_body_rad": "vehicle.gnss.baseline_yaw_body_rad",
    "core.fusion.non_holonomic.rear_axle_body_m": REAR_AXLE,
    "core.fusion.integrity.alert_limit_horizontal_m": "vehicle.alert_limit_horizontal_m",
    "core.fusion.integrity.alert_limit_vertical_m": "vehicle.alert_limit_vertical_m",
}
# Keys of [core.fusion] that moved into a section of it under their own name.
_MOVED = {
    "gnss": ("lever_arm_body_m", "position_only"),
    "imu": (
        "angle_random_walk_rad_sqrt_s", "velocity_random_walk_m_s_sqrt_s", "vibration_factor",
        "gyroscope_bias_sd_rad_s", "gyroscope_scale_sd", "accelerometer_scale_sd",
    ),
    "non_holonomic": ("rear_axle_body_m", "mounting_sd_rad"),
    "dual_antenna": ("baseline_yaw_body_rad",),
    "alignment": ("levelling_s", "course_speed_m_s", "course_yaw_sd_rad"),
    "gating": ("robust_limit", "fault_after_s", "reset_after_rejections", "reset_after_s"),
    "integrity": ("alert_limit_horizontal_m", "alert_limit_vertical_m"),
}  # fmt: skip
_RENAMED = {
    "gnss_delay_s": "gnss.delay_s",
    "gnss_velocity_delay_s": "gnss.velocity_delay_s",
    "gnss_time_sd_s": "gnss.time_sd_s",
    "gnss_position_sd_m": "gnss.position_sd_ned_m",
    "gnss_velocity_sd_m_s": "gnss.velocity_sd_ned_m_s",
    "gnss_position_sd_floor_m": "gnss.position_sd_floor_m",
    "gnss_velocity_sd_floor_m_s": "gnss.velocity_sd_floor_m_s",
    "gnss_sd_factor": "gnss.position_sd_factor",
    "gnss_lasting_errors": "gnss.time_correlated_errors",
    "gnss_error_correlation_s": "gnss.correlation_time_s",
    "gnss_error_white_share": "gnss.white_noise_share",
    "gnss_error_from_zero": "gnss.zero_error_at_start",
    "odometer": "odometer.enabled",
    "odometer_sd_m_s": "odometer.speed_sd_m_s",
    "odometer_scale_sd": "odometer.scale_sd",
    "non_holonomic": "non_holonomic.enabled",
    "non_holonomic_sd_m_s": "non_holonomic.lateral_sd_m_s",
    "non_holonomic_vertical_sd_m_s": "non_holonomic.vertical_sd_m_s",
    "zero_velocity": "standstill.enabled",
    "barometer": "barometer.enabled",
    "barometer_sd_m": "barometer.height_sd_m",
    "barometer_walk_m_sqrt_s": "barometer.offset_random_walk_m_sqrt_s",
    "compass": "magnetometer.enabled",
    "magnetic_declination_rad": "magnetometer.declination_rad",
    "gate_false_alarm": "gating.false_alarm_probability",
    "healthy_s": "gating.readmission_s",
    "healthy_max_s": "gating.readmission_max_s",
    "integrity_risk": "integrity.risk",
}
_WITHIN_FUSION = {
    **{f"core.fusion.{key}": f"core.fusion.{section}.{key}" for section, keys in _MOVED.items() for key in keys},
    **{f"core.fusion.{old}": f"core.fusion.{new}" for old, new in _RENAMED.items()},
}
# Old and present dotted keys of the whole file.
PRESENT_KEYS: Mapping[str, str] = {
    **_FACTS,
    **{old: _FACTS.get(new, new) for old, new in _WITHIN_FUSION.items()},
    **STATED_AGAIN,
    PARSER_MOUNTING: MOUNTING,
    FUSION_MOUNTING: MOUNTING,
}
# Old dotted keys without a successor, and what does their work.
REMOVED: Mapping[str, str] = {
    "core.fusion.estimate_delays": "a delay of GNSS that the check of the set-up finds is corrected without a setting",
    "controller.mode.gnss_messages": "[controller.mode] gnss_outputs says what the receiver is asked to tell",
    "controller.mode.optional_gnss_messages": "[controller.mode] gnss_outputs says what the receiver is asked to tell",
}
EMPTIED = "core.fusion.dual_antenna"  # section whose only key has moved


def value_at(document: Mapping[str, object], key: str) -> object | None:
    """Value of a dotted key; None where there is none."""
    found: object = document
    for part in key.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def old_keys(document: Mapping[str, object]) -> Iterator[str]:
    """Name the old keys that a vehicle's file holds; a table of such a name is a section of the present version."""
    for key in (*PRESENT_KEYS, *REMOVED):
        value = value_at(document, key)
        if value is not None and not isinstance(value, Mapping):
            yield key


def successor(key: str) -> str | None:
    """What became of an old dotted key, as a clause; None if the key is not old."""
    if key in REMOVED:
        return f"it is no more: {REMOVED[key]}"
    return f"it is {in_section(PRESENT_KEYS[key])} now" if key in PRESENT_KEYS else None


def in_section(key: str) -> str:
    """Write a dotted key as its section and name."""
    section, _, name = key.rpartition(".")
    return f"[{section}] {name}"
