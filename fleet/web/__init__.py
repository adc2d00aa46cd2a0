"""The operator's pages of a centre: map, vehicles, alarms, enrolment, audit."""
