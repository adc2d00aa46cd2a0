"""What `core.toll`, `monitoring.ledger` and `sensors.traffic` have in common: the plaza and its tariff."""
