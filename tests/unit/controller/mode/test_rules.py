from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from services.controller.mode.rules import Facts, decide
from shared.messages.navigation import NavigationPhase
from shared.messages.operation import Mode
from tests.support.cases import each

P = NavigationPhase
HEALTHY = Facts(
    uptime_s=100.0, imu_age_s=0.0, gnss_age_s=0.5, fix_age_s=0.5, solution_age_s=0.1, fusion_age_s=0.5,
    phase=P.NAVIGATING, has_measured=True,
)  # fmt: skip
YOUNG = replace(HEALTHY, has_measured=False, solution_age_s=None, phase=P.LEVELLING)


@each(
    ("facts", "mode", "reason"),
    [
        (Facts(uptime_s=0.0), Mode.BOOT, "starting"),
        (Facts(uptime_s=5.0), Mode.DETECTING, "no data from the IMU and the GNSS receiver yet: check its cable"),
        (replace(YOUNG, imu_age_s=None), Mode.DETECTING, "no data from the IMU yet"),
        (replace(YOUNG, gnss_age_s=None), Mode.DETECTING, "no data from the GNSS receiver yet"),
        (replace(YOUNG, configuring="requesting a fix"), Mode.CONFIGURING, "requesting a fix"),
        (replace(YOUNG, configuring="requesting a fix", imu_age_s=9.0), Mode.DEGRADED, "no IMU samples for 9 s"),
        (YOUNG, Mode.ALIGNING, "stand still"),
        (replace(YOUNG, phase=P.WAITING_FOR_GNSS, fix_age_s=None), Mode.ALIGNING, "give the antenna a view of the sky"),
        (replace(YOUNG, phase=P.WAITING_FOR_HEADING), Mode.ALIGNING, "drive straight ahead"),
        (replace(YOUNG, phase=None, fusion_age_s=None, uptime_s=5.0), Mode.ALIGNING,
         "waiting for the navigation filter"),
        (HEALTHY, Mode.MEASURING, "navigating"),
        (replace(HEALTHY, configuring="requesting"), Mode.MEASURING, "navigating"),
        (replace(HEALTHY, configuration_fault="it does not send NAV-COV"), Mode.MEASURING,
         "navigating; receiver not configured: it does not send NAV-COV"),
        (replace(HEALTHY, phase=P.COASTING, fix_age_s=12.0), Mode.DEGRADED, "no GNSS fix for 12 s: coasting"),
        (replace(HEALTHY, phase=P.COASTING, fix_age_s=12.0, gnss_age_s=12.0), Mode.DEGRADED,
         "no data from the GNSS receiver for 12 s: coasting"),
        (replace(HEALTHY, phase=P.COASTING, phase_reason="its fixes are rejected"), Mode.DEGRADED,
         "coasting: its fixes are rejected"),
        (replace(HEALTHY, imu_age_s=4.0, solution_age_s=4.0, fusion_age_s=4.0), Mode.DEGRADED,
         "no IMU samples for 4 s"),
        (replace(HEALTHY, imu_age_s=9.0, phase=P.GNSS_ONLY), Mode.DEGRADED,
         "position of GNSS alone: no IMU samples for 9 s"),
        (replace(YOUNG, imu_age_s=None, phase=P.GNSS_ONLY, solution_age_s=1.0), Mode.DEGRADED,
         "position of GNSS alone: no IMU samples"),
        (replace(HEALTHY, phase=P.GNSS_ONLY), Mode.DEGRADED, "position of GNSS alone: IMU not aligned"),
        (replace(HEALTHY, solution_age_s=4.0), Mode.DEGRADED, "no navigation solution for 4 s"),
        (replace(HEALTHY, solution_age_s=40.0, fusion_age_s=40.0), Mode.DEGRADED,
         "no message from core.fusion for 40 s"),
        (replace(HEALTHY, phase=P.LEVELLING, solution_age_s=9.0), Mode.ALIGNING, "stand still"),  # after a reset
        (replace(YOUNG, phase=None, fusion_age_s=None, uptime_s=20.0), Mode.DEGRADED, "no message from core.fusion"),
        (replace(YOUNG, imu_age_s=30.0, fusion_age_s=30.0), Mode.DEGRADED, "no IMU samples for 30 s"),
    ],
)  # fmt: skip
def test_the_mode_and_its_reason_follow_from_the_facts(facts: Facts, mode: Mode, reason: str) -> None:
    decided, why = decide(facts)
    assert decided is mode
    assert why.startswith(reason) or reason in why


def test_the_reason_is_the_root_cause() -> None:
    """Without IMU and GNSS there is no position; with GNSS alone there is one."""
    everything_stopped = replace(
        HEALTHY, imu_age_s=60.0, solution_age_s=60.0, fusion_age_s=60.0, fix_age_s=60.0, gnss_age_s=60.0
    )
    both = "no IMU samples for 60 s, and no GNSS fix for 60 s: no position"
    assert decide(everything_stopped) == (Mode.DEGRADED, both)


AGES = st.none() | st.floats(0, 1e6)


@given(
    st.builds(
        Facts, uptime_s=st.floats(0, 1e6), imu_age_s=AGES, gnss_age_s=AGES, fix_age_s=AGES, solution_age_s=AGES,
        fusion_age_s=AGES, phase=st.none() | st.sampled_from(P), configuring=st.none() | st.just("requesting"),
        configuration_fault=st.none() | st.just("fault"), has_measured=st.booleans(),
    )
)  # fmt: skip
def test_all_facts_give_a_mode_and_a_reason(facts: Facts) -> None:
    mode, reason = decide(facts)
    assert mode is not Mode.SHUTTING_DOWN
    assert reason
    if mode is Mode.MEASURING:
        assert facts.phase is P.NAVIGATING
        assert facts.solution_age_s is not None
        assert facts.solution_age_s <= 2.0
